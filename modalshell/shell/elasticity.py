"""Elasticity of sheets that are not the same in all directions: matrices in material axes, turned into any others."""

from __future__ import annotations

import warnings
from typing import Any, NamedTuple, final

import numpy as np

from modalshell.core.errors import MaterialError, ModalShellWarning
from modalshell.core.typing import Array, Index
from modalshell.mesh import TriangleMesh

_NORMAL = 1e-6
"""Least length of a unit vector's projection into a triangle that still tells a direction."""


@final
class Elasticity(NamedTuple):
    """Stiffness of every triangle against strains (E11, E22, 2 E12), or curvatures, in axes of its material."""

    matrices: Any
    """C [N/m] of the membrane, or [N m] of bending; complex ones serve derivatives. Shape (T, 3, 3)."""
    directions: Any
    """Unit vectors of axis 1, in the triangles' planes at rest; axis 2 is to its left. Shape (T, 3)."""

    def in_axes(self, mesh: TriangleMesh, faces: Index, along: Array, across: Array) -> Any:
        """C (k, 3, 3) of ``faces`` (k,) in the unit axes ``along`` and ``across`` (k, 3) in their planes."""
        first = self.directions[faces]
        second = np.cross(mesh.face_normals[faces], first)
        (a, b), (c, d) = ([np.sum(own * axis, axis=1) for axis in (along, across)] for own in (first, second))
        # Strains in material axes of those in these: e.g. E11' = a a E11 + b b E22 + a b (2 E12).
        turn = np.stack(
            [
                np.stack([a * a, b * b, a * b], axis=1),
                np.stack([c * c, d * d, c * d], axis=1),
                np.stack([2 * a * c, 2 * b * d, a * d + b * c], axis=1),
            ],
            axis=1,
        )
        return np.swapaxes(turn, 1, 2) @ self.matrices[faces] @ turn

    def in_triangles(self, mesh: TriangleMesh) -> Any:
        """C (T, 3, 3) in the triangles' axes: axis 1 along the first edge, axis 2 to its left."""
        faces = np.arange(len(mesh.faces))
        along = mesh.vertices[mesh.faces[:, 1]] - mesh.vertices[mesh.faces[:, 0]]
        along = along / np.linalg.norm(along, axis=1)[:, None]
        return self.in_axes(mesh, faces, along, np.cross(mesh.face_normals, along))

    def mean(self) -> tuple[Array, Array]:
        """Stiffness (T,) and Poisson's ratio (T,) of the isotropic sheet that is the mean over all directions."""
        c = self.matrices
        stiffness = 0.375 * (c[:, 0, 0] + c[:, 1, 1]) + 0.25 * c[:, 0, 1] + 0.5 * c[:, 2, 2]
        cross = 0.125 * (c[:, 0, 0] + c[:, 1, 1]) + 0.75 * c[:, 0, 1] - 0.5 * c[:, 2, 2]
        return stiffness, cross / stiffness

    def alike(self, mesh: TriangleMesh, limit: float) -> Any:
        """Whether both triangles of each edge (E,), laid flat, differ by less than ``limit`` of their stiffness."""
        pairs = mesh.edge_faces
        inner = np.flatnonzero(pairs[:, 1] >= 0)
        along = np.diff(mesh.vertices[mesh.edges[inner]], axis=1)[:, 0] / mesh.edge_lengths[inner, None]
        second = np.where(np.isin(inner, mesh.seams), -1.0, 1.0)[:, None]  # the normals at a seam are opposite
        sides = [
            self.in_axes(mesh, faces, along, sign * np.cross(mesh.face_normals[faces], along))
            for faces, sign in zip(pairs[inner].T, (1.0, second), strict=True)
        ]
        apart, size = (np.linalg.norm(c, axis=(1, 2)) for c in (sides[1] - sides[0], 0.5 * (sides[0] + sides[1])))
        same = np.zeros(len(mesh.edges), dtype=bool)
        same[inner] = apart <= limit * size
        return same


def plane_elasticity(first: Any, second: Any, poisson: Any, shear: Any) -> Any:
    """Q (T, 3, 3) [Pa] of plane stress for moduli along both axes, Poisson's ratio nu12 and the shear modulus (T,)."""
    ratio = 1.0 - poisson**2 * second / first
    matrix = np.zeros((np.size(first), 3, 3), dtype=np.result_type(first, second, poisson, shear))
    matrix[:, 0, 0], matrix[:, 1, 1] = first / ratio, second / ratio
    matrix[:, 0, 1] = matrix[:, 1, 0] = poisson * second / ratio
    matrix[:, 2, 2] = shear
    return matrix


def strain_turn(degrees: float | Array) -> Array:
    """Matrices (..., 3, 3) of strains (11, 22, 2 12) in axes turned by angles (...), of those in the others."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn = np.array([[c * c, s * s, c * s], [s * s, c * c, -c * s], [-2.0 * c * s, 2.0 * c * s, c * c - s * s]])
    return np.moveaxis(turn, (0, 1), (-2, -1))


def turned(matrix: Array, degrees: float | Array) -> Array:
    """Stiffness (..., 3, 3) of a sheet whose own axes, in which it is ``matrix`` (3, 3), are turned by angles (...)."""
    turn = strain_turn(degrees)
    return np.asarray(np.swapaxes(turn, -2, -1) @ matrix @ turn)


def directions_on(mesh: TriangleMesh, direction: Array) -> Array:
    """Unit vectors (T, 3) in the triangles: of an angle or angles (T,) from the x axis [deg], or a vector or (T, 3).

    MaterialError where a vector stands on its triangle.
    """
    given = np.asarray(direction, dtype=np.float64)
    if given.shape == (3,) == (len(mesh.faces),) and not np.isclose(np.linalg.norm(given), 1.0):  # no unit vector
        numbers = ", ".join(f"{number:g}" for number in given)
        told = f"direction ({numbers}) is taken as a vector, not as an angle for each of the mesh's three triangles"
        warnings.warn(f"{told}: for angles, give one vector per triangle (3, 3)", ModalShellWarning, stacklevel=2)
    angles = given if given.shape != (3,) and given.ndim < 2 else np.zeros(())
    vectors = np.array([1.0, 0.0, 0.0]) if angles is given else given
    vectors = np.broadcast_to(vectors, (len(mesh.faces), 3))
    vectors = vectors / np.linalg.norm(vectors, axis=1)[:, None]
    normals = mesh.face_normals
    inside = vectors - np.sum(vectors * normals, axis=1)[:, None] * normals
    lengths = np.linalg.norm(inside, axis=1)
    if (lengths < _NORMAL).any():
        first = int(np.argmax(lengths < _NORMAL))
        what = "the x axis, from which an angle counts," if angles is given else "direction"
        raise MaterialError(
            f"direction: {what} is normal to triangle {first} (counted from 0; got {vectors[first].tolist()}); give a "
            "vector that lies in every triangle, or one for each triangle (T, 3)"
        )
    inside = inside / lengths[:, None]
    radians = np.radians(np.broadcast_to(angles, (len(mesh.faces),)))[:, None]
    return np.asarray(np.cos(radians) * inside + np.sin(radians) * np.cross(normals, inside))
