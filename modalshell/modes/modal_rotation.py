"""The modal rotation matrix: rotation vectors of vertices, linear in small displacements [choi2007, eq. 9-15]."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sps
import scipy.sparse.linalg as spla

from modalshell.core.errors import REPAIR, SolverError
from modalshell.core.in_parts import fill_in_parts
from modalshell.core.typing import Array, Index
from modalshell.mesh import TriangleMesh


def largest_at_vertices(columns: Array) -> Array:
    """Largest length (m,) that columns (3n, m) have at a vertex."""
    return np.asarray(np.linalg.norm(columns.reshape(-1, 3, columns.shape[1]), axis=1).max(axis=0))


def cross_matrices(vectors: Array) -> Array:
    """Skew matrices [v] (..., 3, 3) with ``[v] a = v x a`` of vectors (..., 3)."""
    skew = np.zeros((*vectors.shape, 3))
    skew[..., 0, 1], skew[..., 0, 2], skew[..., 1, 2] = -vectors[..., 2], vectors[..., 1], -vectors[..., 0]
    return skew - np.swapaxes(skew, -1, -2)


def triangle_rotations(mesh: TriangleMesh, displacements: Array) -> Array:
    """Rotation vectors (T, 3, k) [rad] that fit the corner displacements (n, 3, k) [m] of every triangle best.

    Least squares over ``|w x P_k - (u_k - mean u)|^2`` with P_k the corner from the centroid: ``w = A^-1 sum_k P_k x
    u_k``, ``A = sum_k [P_k]^T [P_k]`` (theory 2, eq. 2).
    """
    rotations = np.empty((len(mesh.faces), *displacements.shape[1:]))

    def fitted(faces: Index) -> Array:
        corners = mesh.vertices[faces]
        skew = cross_matrices(corners - corners.mean(axis=1, keepdims=True))
        normal = np.einsum("tkji,tkjl->til", skew, skew)
        moment = np.swapaxes(skew, 1, 2).reshape(-1, 3, 9) @ displacements[faces].reshape(len(faces), 9, -1)
        return np.asarray(np.linalg.solve(normal, moment))

    try:
        fill_in_parts(rotations, fitted, mesh.faces)
    except np.linalg.LinAlgError as error:
        raise SolverError(
            "some triangle is so thin that the rotation about its length is lost in rounding; take it away, as "
            f"{REPAIR} does"
        ) from error
    return rotations


def rotation_matrix(mesh: TriangleMesh) -> spla.LinearOperator:
    """W (3n, 3n): vertex rotation vectors [rad] from displacements [m], the mean over the triangles at each.

    It is applied triangle by triangle, and never assembled.
    """
    count, at = len(mesh.vertices), mesh.faces.ravel().astype(np.int32)
    of = np.repeat(np.arange(len(mesh.faces), dtype=np.int32), 3)
    meeting = sps.csr_array((np.ones(at.size), (at, of)), shape=(count, len(mesh.faces)))

    def product(displacements: Array) -> Array:
        rotations = triangle_rotations(mesh, displacements.reshape(count, 3, -1)).reshape(len(mesh.faces), -1)
        return np.asarray((meeting @ rotations / np.diff(meeting.indptr)[:, None]).reshape(displacements.shape))

    return spla.LinearOperator((3 * count, 3 * count), matvec=product, matmat=product, dtype=np.float64)
