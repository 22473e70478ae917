"""The modal force of loads at points on a fitted surface, by patches of its triangles."""

from __future__ import annotations

from typing import final

import numpy as np
import scipy.sparse as sps

from modalshell.core.typing import Array
from modalshell.mesh import TriangleMesh
from modalshell.models.reduction.load_points import LoadPoints, halved
from modalshell.models.reduction.patched_work_kernels import bent_push
from modalshell.models.reduction.poisson import PoissonFit

_PATCHES = 128
"""Patches of triangles that turn as one."""


@final
class PatchedWork:
    """Gradients of the work of forces at points, on a surface fitted to turned and strained triangles.

    The work's linear part is that of the modes. The rest is a sum over patches of triangles, which turn and strain by
    their means, times the sums over them of the fit's answers to the forces, from a table. ``columns`` (T, m, 6) are
    turn and strain of the triangles in every mode, in their frames.
    """

    def __init__(self, mesh: TriangleMesh, fit: PoissonFit, columns: Array, points: LoadPoints) -> None:
        faces = np.asarray(mesh.faces, dtype=np.int64)
        groups, _ = halved(mesh, faces, _PATCHES)
        count, modes = int(groups.max()) + 1, columns.shape[1]
        sums = sps.csr_array((np.ones(len(faces)), (groups, np.arange(len(faces)))), shape=(count, len(faces)))
        areas = np.asarray(mesh.face_areas)
        totals: Array = np.asarray(sums @ areas)
        means = sps.diags_array(1.0 / totals) @ sums @ sps.diags_array(areas)
        first, second, _ = np.moveaxis(fit.frames, 1, 0)
        turns = np.einsum("tmk,tki->tim", columns[:, :, :3], fit.frames)
        strains = np.stack(
            [
                columns[:, :, 3] * (first[:, i] * first[:, j])[:, None]
                + columns[:, :, 4] * (second[:, i] * second[:, j])[:, None]
                + columns[:, :, 5] * (first[:, i] * second[:, j] + first[:, j] * second[:, i])[:, None]
                for i, j in ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
            ],
            axis=1,
        )
        self._turns = np.ascontiguousarray((means @ turns.reshape(len(faces), -1)).reshape(count, 3, modes))
        self._strains = np.ascontiguousarray((means @ strains.reshape(len(faces), -1)).reshape(count, 6, modes))
        self._modes = points.modes.reshape(-1, modes)
        self._coupled = fit.coupled
        self._table = _table(fit, points, sums)

    def at_points(self, q: Array, forces: Array) -> Array:
        """Modal forces (m,) at q (m,) of forces (k, 3) [N] at the points."""
        push = forces.ravel() @ self._modes
        gradients = self._table @ (forces.ravel() if self._coupled else forces)
        bent_push(gradients.reshape(-1, 3, 3), self._turns, self._strains, q, push)
        return np.asarray(push)


def _table(fit: PoissonFit, points: LoadPoints, sums: sps.csr_array) -> Array:
    """Sums over patches (3P, k) of ``A grad y``, y the fit's answers to unit forces, the same along each axis.

    Where supports couple the axes (9P, 3k): of the answers along all axes to unit forces along each.
    """
    weights = sps.csr_array(points.means)
    many, vertices = weights.shape
    if fit.coupled:
        table = np.empty((sums.shape[0], 3, 3, many, 3))
        for point in range(many):
            for axis in range(3):
                load = np.zeros((vertices, 3))
                load[:, axis] = weights[[point]].toarray()[0]
                table[:, :, :, point, axis] = _summed(fit, load, sums)
        return table.reshape(9 * sums.shape[0], 3 * many)
    table = np.empty((sums.shape[0], 3, many))
    for start in range(0, many, 3):  # three at once, as if they pushed along the three axes
        chosen = range(start, min(start + 3, many))
        load = np.zeros((vertices, 3))
        load[:, : len(chosen)] = weights[list(chosen)].toarray().T
        table[:, :, start : start + len(chosen)] = _summed(fit, load, sums)[:, :, : len(chosen)]
    return table.reshape(3 * sums.shape[0], many)


def _summed(fit: PoissonFit, load: Array, sums: sps.csr_array) -> Array:
    """Sums over patches (P, 3, 3) of the gradients (T, 3) of the fit to a load (n, 3), by components and axes."""
    answer = fit.adjoint(load)[0][fit.slots]
    height, foot, length = (side[:, None] for side in fit.sides.T)
    one, two = answer[:, 1] - answer[:, 0], answer[:, 2] - answer[:, 0]
    along, across = 0.5 * height * one, 0.5 * (length * two - foot * one)
    gradients = fit.frames[:, 0, :, None] * along[:, None] + fit.frames[:, 1, :, None] * across[:, None]
    return np.asarray((sums @ gradients.reshape(len(gradients), 9)).reshape(-1, 3, 3))
