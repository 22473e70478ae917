"""Rigid motions that the supports leave free, exactly, and solves with the singular stiffness that they make."""

from __future__ import annotations

import numpy as np
import scipy.linalg
import scipy.sparse as sps

from modalshell.modes.factorisation import Factor, Factoriser, condensed_factor
from modalshell.shell import Shell
from modalshell.typing import Array


def six_motions(points: Array) -> Array:
    """Translations and turns about the centre of points (k, 3), as columns (k, 3, 6) of similar size."""
    centred = points - points.mean(axis=0)
    centred /= np.linalg.norm(centred, axis=1).max()
    motions = np.zeros((len(points), 3, 6))
    for axis in range(3):
        motions[:, axis, axis] = 1.0
        motions[:, :, 3 + axis] = np.cross(np.eye(3)[axis], centred)
    return motions


def rigid_motions(shell: Shell) -> Array:
    """Mass-orthonormal rigid motions (free unknowns, r) compatible with the supports.

    Each connected part of the shell has six; held vertices take away those that would move them, so a part held along
    one straight line keeps one, the turn about that line, unless an edge on it is clamped.
    """
    positions, unknowns = shell.rest_positions, shell.unknowns
    labels = shell.mesh.components
    columns = []
    for part in range(int(labels.max()) + 1):
        vertices = np.flatnonzero(labels == part)
        motions = six_motions(positions[vertices])
        whole = np.zeros((positions.shape[0], 3, 6))
        whole[vertices] = motions
        resisted = unknowns.resisted(whole).reshape(-1, 6)
        edges = shell.held_slopes()
        edges = edges[labels[edges[:, 0]] == part]
        if edges.size:  # about their own directions they cannot turn
            along = positions[edges[:, 1]] - positions[edges[:, 0]]
            turns = along / np.linalg.norm(along, axis=1, keepdims=True)
            resisted = np.vstack([resisted, np.hstack([np.zeros_like(turns), turns])])
        if resisted.any():
            _, values, right = np.linalg.svd(np.linalg.qr(resisted, mode="r"))
            rank = int(np.count_nonzero(values > 1e-6 * values[0]))
            if rank == 6:
                continue
            whole = whole @ right[rank:].T
        columns.append(unknowns.values(whole.reshape(positions.size, -1)))
    if not columns:
        return np.empty((unknowns.count, 0))
    root_mass = np.sqrt(unknowns.masses(shell.mass))[:, None]
    orthonormal, _ = np.linalg.qr(root_mass * np.hstack(columns))
    return orthonormal / root_mass


class RigidFreeSolver:
    """Solves ``K x = b`` on the complement of the rigid motions.

    As many unknowns as there are rigid motions are held, statically determinate, so that the rest of K is positive
    definite and no shift has to be chosen; the rigid part is projected out of ``b`` and ``x``.

    Parameters
    ----------
    stiffness : csc_array, shape (N, N)
        Stiffness of the free unknowns; internal unknowns, without mass, may follow them.
    rigid : ndarray, shape (N, r)
        Mass-orthonormal rigid motions.
    mass : ndarray, shape (N,)
        Lumped mass of each unknown.
    """

    def __init__(self, stiffness: sps.csc_array, rigid: Array, mass: Array, backend: str | None = None) -> None:
        self._rigid = rigid
        self._mass = mass
        self._kept = np.arange(mass.size)
        internal = stiffness.shape[0] - mass.size
        if rigid.shape[1]:
            _, _, order = scipy.linalg.qr(rigid.T, pivoting=True, mode="economic")
            self._kept = np.sort(order[rigid.shape[1] :])
            kept = np.concatenate([self._kept, mass.size + np.arange(internal)])
            stiffness = sps.csc_array(stiffness[kept][:, kept])
        self.factor: Factor = condensed_factor(Factoriser(backend, use="solve").definite(stiffness), internal)

    def solve(self, right_side: Array) -> Array:
        """Solution without rigid part, for (N,) right sides; their rigid part is left out."""
        if not self._rigid.shape[1]:
            return self.factor.solve(right_side)
        balanced = right_side - self._mass * (self._rigid @ (self._rigid.T @ right_side))
        solution = np.zeros_like(balanced)
        solution[self._kept] = self.factor.solve(balanced[self._kept])
        return solution - self._rigid @ (self._rigid.T @ (self._mass * solution))
