"""Bending energy of flat meshes by the equations of theory 4: one moment for each triangle, and shares of the folds."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sps

from modalshell.core.typing import Array
from modalshell.mesh import TriangleMesh
from modalshell.shell.triangle_pairs import fold_moments


def single_moments(mesh: TriangleMesh, poisson: float, free: bool = True) -> Array:
    """K_T (T, 3, 3) of theory 4, eq. 6, with D = 1, by the edges opposite the corners; free edges condensed out."""
    count = len(mesh.faces)
    alone = np.column_stack([np.arange(count), np.full(count, -1)])
    rim = free & (mesh.edge_faces[mesh.face_edges[:, [1, 2, 0]], 1] < 0)
    condensed = np.hstack([rim, np.zeros((count, 2), dtype=bool)])
    moments = fold_moments(mesh, alone, 0 * alone, np.ones(count), np.full(count, poisson), condensed)
    return np.asarray(moments[:, :3, :3])


def shared_folds(mesh: TriangleMesh, poisson: float) -> tuple[sps.csr_array, sps.csr_array, sps.csr_array]:
    """K_dd, K_fd and K_ff (H, H) of theory 4, eq. 10, for gamma = delta / 2 + f and delta / 2 - f."""
    hinges = len(mesh.hinges)
    number = np.full(len(mesh.edges), -1)
    number[mesh.hinge_edges] = np.arange(hinges)
    edges = mesh.face_edges[:, [1, 2, 0]]
    left = mesh.edge_faces[edges, 0] == np.arange(len(mesh.faces))[:, None]
    inner = np.flatnonzero(number[edges].ravel() >= 0)
    place = (inner, number[edges].ravel()[inner])
    shape = (edges.size, hinges)
    halves = sps.csr_array(sps.coo_array((np.full(inner.size, 0.5), place), shape=shape))
    shares = sps.csr_array(sps.coo_array((np.where(left, 1.0, -1.0).ravel()[inner], place), shape=shape))
    blocks = sps.block_diag(list(single_moments(mesh, poisson)), format="csr")
    return halves.T @ blocks @ halves, shares.T @ blocks @ halves, shares.T @ blocks @ shares
