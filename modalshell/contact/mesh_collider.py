"""A rigid body whose surface is a closed triangle mesh."""

from __future__ import annotations

from typing import final

import numpy as np

from modalshell.contact.base import Collider, Gap
from modalshell.contact.nearest import first_crossing, nearest_points, windings
from modalshell.contact.surfaces import Surface
from modalshell.core.checks import checked_kind
from modalshell.core.errors import OptionError
from modalshell.core.typing import Array, Index
from modalshell.mesh import TriangleMesh

_FLAT = 1e-12
"""Part of the squares of normals about an edge or a corner, along a direction, that is none: of angles below 2e-6."""
_ON = 1e-9
"""Distance, as a share of the mesh's size, at which a point lies on the edge or corner nearest to it."""
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


@final
class MeshCollider(Collider, key="mesh"):
    """A rigid body whose surface is a closed triangle mesh, its normals outward.

    The distance is exact; its sign is that of the nearest feature's normal [baerentzen2005]. Facets meet in edges, at
    which a shell's vertices find no smooth surface: a fine mesh, or a simpler body, converges better. Every gap looks
    at all triangles.

    Parameters
    ----------
    mesh : TriangleMesh
        The surface.

    Raises
    ------
    OptionError
        For a mesh with a boundary or a junction, whose normals point inward, which crosses itself, or whose bodies
        overlap.
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        self.mesh = checked_kind("mesh", mesh, TriangleMesh)
        corners, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
        pairs = np.sort(np.concatenate([faces[:, [1, 2]], faces[:, [2, 0]], faces[:, [0, 1]]]), axis=1)
        _, group, counts = np.unique(pairs, axis=0, return_inverse=True, return_counts=True)
        if (counts != 2).any():
            end = pairs[np.flatnonzero(counts[group.ravel()] != 2)[0]]
            raise OptionError(f"mesh must be closed: the edge of vertices {end[0]} and {end[1]} has not two triangles")
        a, b, c = (corners[faces[:, k]] for k in range(3))
        turned = np.cross(b - a, c - a)
        self._centres = (a + b + c) / 3.0
        self._radii = np.max([np.linalg.norm(one - self._centres, axis=1) for one in (a, b, c)], axis=0)
        refuse_bodies(mesh, turned, (self._centres, self._radii))
        normals = turned / np.linalg.norm(turned, axis=1, keepdims=True)
        by_edge = np.zeros((len(counts), 3))
        np.add.at(by_edge, group.ravel(), np.tile(normals, (3, 1)))
        by_corner = np.zeros_like(corners)
        for k in range(3):
            first, second = corners[faces[:, (k + 1) % 3]] - corners[faces[:, k]], corners[faces[:, k - 1]]
            second = second - corners[faces[:, k]]
            angle = np.arctan2(np.linalg.norm(np.cross(first, second), axis=1), np.sum(first * second, axis=1))
            np.add.at(by_corner, faces[:, k], angle[:, None] * normals)
        count = len(faces)
        edges = by_edge[group.ravel()].reshape(3, count, 3)
        self._normals = np.stack([normals, *edges, *(by_corner[faces[:, k]] for k in range(3))])
        self._normals /= np.linalg.norm(self._normals, axis=2, keepdims=True)
        self._spans = _spans(normals, faces, group.reshape(3, count), len(corners))

    def _nearest(self, x: Array) -> tuple[Array, Index, Index]:
        found, triangles = np.empty(x.shape), np.empty(len(x), np.int64)
        features = np.empty(len(x), np.int64)
        mesh = np.asarray(self.mesh.vertices), np.asarray(self.mesh.faces)
        nearest_points(np.ascontiguousarray(x), *mesh, self._centres, self._radii, found, triangles, features)
        return found, triangles, features

    def gap(self, x: Array, t: float = 0.0) -> Gap:  # noqa: ARG002 (it rests)
        """See :meth:`Collider.gap`."""
        nearest, triangles, features = self._nearest(x)
        offset, outward = x - nearest, self._normals[features, triangles]
        distance = np.linalg.norm(offset, axis=1)
        sign = np.where(np.sum(offset * outward, axis=1) < 0.0, -1.0, 1.0)
        on = (distance <= _ON * self.mesh.size) | (features == 0)  # a short offset's direction is rounding
        size = np.where(on, 1.0, distance)
        normal = np.where(on[:, None], outward, (sign / size)[:, None] * offset)
        free = self._spans[np.maximum(features - 1, 0), triangles]
        curvature = (sign / size)[:, None, None] * (free - normal[:, :, None] * normal[:, None, :])
        curvature[on] = 0.0
        return sign * distance, normal, curvature

    def surface(self, corners: Array) -> Surface:  # noqa: ARG002 (it is drawn whole)
        """See :meth:`Collider.surface`."""
        return np.array(self.mesh.vertices), np.array(self.mesh.faces)

    @property
    def smallest_radius(self) -> float:
        """Half the smallest extent of its box [m]; of bodies with thin parts it must move slower than this allows."""
        return 0.5 * float(np.ptp(self.mesh.vertices, axis=0).min())


def _spans(normals: Array, faces: Index, edges: Index, count: int) -> Array:
    """Projections (6, T, 3, 3) on the normals about the edges (3, T) and the ``count`` corners of triangles.

    Along these the nearest point of an edge or corner does not follow; on a flat face it follows along the face.
    """
    squares = normals[:, :, None] * normals[:, None, :]
    sums = [np.zeros((int(edges.max()) + 1, 3, 3)), np.zeros((count, 3, 3))]
    for k in range(3):
        np.add.at(sums[0], edges[k], squares)
        np.add.at(sums[1], faces[:, k], squares)
    found = []
    for one in sums:
        sizes, axes = np.linalg.eigh(one)
        kept = axes * (sizes > _FLAT * sizes[:, -1:])[:, None, :]
        found.append(kept @ np.swapaxes(kept, 1, 2))
    return np.stack([*found[0][edges], *(found[1][faces[:, k]] for k in range(3))])
