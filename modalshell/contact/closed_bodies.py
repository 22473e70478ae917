"""Checks of closed triangle meshes whose signed distance is asked for."""

from __future__ import annotations

import numpy as np

from modalshell.contact.nearest import first_crossing, windings
from modalshell.core.errors import OptionError
from modalshell.core.typing import Array, Index
from modalshell.mesh import TriangleMesh

_LOOKS = 64
"""Vertices of a body, at most, that are asked in which others they lie."""
_WHOLE = 0.01
"""Distance of a number of turns about a point from a whole one, below which it is this."""


def refuse_bodies(mesh: TriangleMesh, turned: Array, balls: tuple[Array, Array]) -> None:
    """OptionError where the nearest triangle of a closed mesh does not tell inside from outside.

    Its surface crosses itself, a body's normals point inward though it is no hollow of another, or bodies overlap.
    ``turned`` (T, 3) are normals of its triangles, of twice their areas [m^2], and ``balls`` (T, 3) and (T,) the
    centres and radii [m] of balls about the triangles.
    """
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    inner = vertices - vertices.mean(axis=0)
    volumes = np.sum(turned * inner[faces[:, 0]], axis=1)
    body = mesh.components[faces[:, 0]]
    signs = np.sign(np.bincount(body, volumes))
    if (signs < 0.0).all():
        raise OptionError("the normals of mesh must point outward: reverse its triangles, faces[:, ::-1]")
    order = np.argsort(balls[0][:, 0] - balls[1])
    first, second = first_crossing(vertices, faces, *balls, order)
    if first >= 0:
        raise OptionError(
            f"mesh must not cross itself (got triangles {first} and {second}, which do): unite its bodies into one "
            "surface, or give each a contact of its own"
        )
    for index in range(signs.size if signs.size > 1 else 0):
        own = np.unique(faces[body == index])
        face = int(np.flatnonzero(body == index)[0])
        _refuse_place(vertices[own[:: -(-own.size // _LOOKS)]], vertices, faces[body != index], signs[index], face)


def _refuse_place(looks: Array, vertices: Array, others: Index, sign: float, face: int) -> None:
    """OptionError where a body, some of whose vertices are ``looks`` (k, 3), lies in or about others wrongly."""
    numbers = np.empty(len(looks))
    windings(np.ascontiguousarray(looks), vertices, np.ascontiguousarray(others), numbers)
    turns = np.unique(np.rint(numbers[np.abs(numbers - np.rint(numbers)) < _WHOLE]))  # not of those on a surface
    if sign < 0.0 and (turns == 0.0).any():
        raise OptionError(
            f"the normals of mesh must point outward: those of the body of triangle {face} point inward, and it is no "
            "hollow of another: reverse its triangles"
        )
    if sign > 0.0 and (turns != 0.0).any():
        raise OptionError(
            f"bodies of mesh must not overlap (got one, of triangle {face}, that lies in another): unite them into one "
            "surface, give each a contact of its own, or reverse the triangles of a hollow"
        )
