"""The modal rotation matrix: rotation vectors of vertices, linear in small displacements [choi2007, eq. 9-15]."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sps

from modalshell.core.errors import REPAIR, SolverError
from modalshell.core.typing import Array
from modalshell.mesh import TriangleMesh


def cross_matrices(vectors: Array) -> Array:
    """Skew matrices [v] (..., 3, 3) with ``[v] a = v x a`` of vectors (..., 3)."""
    skew = np.zeros((*vectors.shape, 3))
    skew[..., 0, 1], skew[..., 0, 2], skew[..., 1, 2] = -vectors[..., 2], vectors[..., 1], -vectors[..., 0]
    return skew - np.swapaxes(skew, -1, -2)


def triangle_rotations(mesh: TriangleMesh) -> Array:
    """Matrices B (T, 3, 3, 3): the rotation vector that fits the corner displacements best is ``sum_k B[t, k] u_k``.

    Least squares over ``|w x P_k - (u_k - mean u)|^2`` with P_k the corner from the centroid: ``B_k = A^-1 [P_k]``,
    ``A = sum_k [P_k]^T [P_k]`` (theory 2, eq. 2).
    """
    corners = mesh.vertices[mesh.faces]
    skew = cross_matrices(corners - corners.mean(axis=1, keepdims=True))
    normal = np.einsum("tkji,tkjl->til", skew, skew)
    try:
        return np.linalg.solve(normal[:, None], skew)
    except np.linalg.LinAlgError as error:
        raise SolverError(
            "some triangle is so thin that the rotation about its length is lost in rounding; take it away, as "
            f"{REPAIR} does"
        ) from error


def rotation_matrix(mesh: TriangleMesh) -> sps.csr_array:
    """Sparse W (3n, 3n): vertex rotation vectors [rad] from displacements [m], the mean over the triangles at each."""
    count = len(mesh.vertices)
    per_triangle = triangle_rotations(mesh)
    degree = np.bincount(mesh.faces.ravel(), minlength=count)
    shape = (len(mesh.faces), 3, 3, 3, 3)  # triangle, receiving corner, giving corner, row, column
    share = (1.0 / degree)[mesh.faces]
    values = np.broadcast_to(per_triangle[:, None], shape) * share[:, :, None, None, None]
    rows = np.broadcast_to(3 * mesh.faces[:, :, None, None, None] + np.arange(3)[:, None], shape)
    columns = np.broadcast_to(3 * mesh.faces[:, None, :, None, None] + np.arange(3), shape)
    triplets = (values.ravel(), (rows.ravel(), columns.ravel()))
    return sps.csr_array(sps.coo_array(triplets, shape=(3 * count, 3 * count)))
