"""What a shell gives way beyond its modes under a force on a vertex, found at first touch and kept."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import final

import numpy as np

from modalshell.contact.modal_kernels import between_slots
from modalshell.core.errors import SolverError
from modalshell.core.typing import Array, Index
from modalshell.modes import Basis, Factoriser, condensed_factor
from modalshell.modes.rigid import RigidFreeSolver
from modalshell.shell import EXACT, GAUSS_NEWTON

_KEPT, _KIND = 2e8, np.float32
"""Bytes of shapes that are kept, and their numbers: a frame reads all that are pushed, and half as much is twice as
fast. A shape is rounded by 3e-8 of itself, and so is what is taken of it anywhere.
"""
_TOGETHER = 8
"""Vertices whose shapes are solved for at once: their forces fill the registers of a solve."""
_GIVES = 1e-9
"""What a patch gives way, over what the one of them does that gives most, from which it is no rounding."""
_MOST = 512
"""Shapes that are kept at most: their blocks grow with the square."""


@final
class LocalShapes:
    """Shapes ``(K^-1 - Phi Lambda^-1 Phi^T) e`` of the shell at rest under unit forces on some vertices.

    Where supports leave rigid motions, inertial forces balance the unit ones, and shapes have no share in them. There
    is room for ``least`` vertices at least. Shapes leave the mean of each of the ``patches``, which are led, where it
    is.

    Attributes
    ----------
    store : ndarray of float32, shape (s, 3, 3n)
        Displacements [m/N] under unit forces along each axis, of each slot.
    places : ndarray, shape (n,)
        Slot of each vertex, less than 0 for none.
    blocks : ndarray, shape (s, s, 3, 3)
        Those at the vertices of all slots: ``blocks[a, b] = store[a]`` at the vertex of b.
    most, begun : int
        Shapes that are kept at most, and how often all were dropped.
    """

    def __init__(self, basis: Basis, least: int, patches: Sequence[Index] = ()) -> None:
        self._basis, count = basis, len(basis.shell.rest_positions)
        self._patches = patches
        self._means: tuple[Array, Array] | None = None
        self.places, self._vertices = np.full(count, -1, np.int64), np.empty(0, np.int64)
        self.most = max(least, min(_MOST, int(_KEPT / (36.0 * count))))
        self.store, self.blocks = np.empty((0, 3, 3 * count), _KIND), np.empty((0, 0, 3, 3))
        self._solve: Callable[[Array], Array] | None = None
        self._together = 1
        self.begun = 0
        self._between = (-1, b""), np.empty(0, np.int64), np.empty((3, 3, 0, 0))

    def slots(self, vertices: Index) -> Index:
        """Slots (k,) of vertices, whose shapes are found where they are not kept."""
        places = self.places[vertices]
        if places.size and places.min() < 0:
            missing = np.unique(vertices[places < 0])
            if missing.size + self._vertices.size > self.most:
                self.places[:], self._vertices, self.begun = -1, np.empty(0, np.int64), self.begun + 1
                missing = np.unique(vertices)
            self._add(missing)
            places = self.places[vertices]
        return places

    def between(self, vertices: Index) -> tuple[Index, Array]:
        """Slots (k,) of vertices, and :func:`between_slots` of them; those of the last are kept."""
        key = self.begun, vertices.tobytes()
        if self._between[0] != key:
            slots = self.slots(vertices)
            self._between = (self.begun, key[1]), slots, between_slots(self.blocks, slots)
        return self._between[1:]

    def _add(self, missing: Index) -> None:
        used, vertices = self._vertices.size, np.concatenate([self._vertices, missing])
        if vertices.size > len(self.store):  # twice as large
            room = max(vertices.size, min(self.most, 2 * vertices.size))
            store, blocks = np.empty((room, *self.store.shape[1:]), _KIND), np.zeros((room, room, 3, 3))
            store[:used], blocks[:used, :used] = self.store[:used], self.blocks[:used, :used]
            self.store, self.blocks = store, blocks
        if self._solve is None:
            self._solve, self._together = _static_solver(self._basis)
            self._means = self._held(self._solve) if self._patches else None
        for first in range(used, vertices.size, self._together):
            last = min(first + self._together, vertices.size)
            self.store[first:last] = self._shapes(self._solve, vertices[first:last])
        whole = self.store[: vertices.size].reshape(vertices.size, 3, -1, 3)
        self.blocks[:used, used : vertices.size] = whole[:used][:, :, missing].transpose(0, 2, 1, 3)
        self.blocks[used : vertices.size, : vertices.size] = whole[used:][:, :, vertices].transpose(0, 2, 1, 3)
        self.places[missing], self._vertices = np.arange(used, vertices.size), vertices

    def _shapes(self, solve: Callable[[Array], Array], vertices: Index) -> Array:
        """Displacements (k, 3, 3n) [m] of the shell at rest beyond its modes, under unit forces on each vertex."""
        coordinates = (3 * vertices[:, None] + np.arange(3)).ravel()
        loads = np.zeros((self._basis.shell.rest_positions.size, coordinates.size))
        loads[coordinates, np.arange(coordinates.size)] = 1.0
        return np.asarray(self._residual_flexibility(solve, loads).T).reshape(vertices.size, 3, -1)

    def _residual_flexibility(self, solve: Callable[[Array], Array], loads: Array) -> Array:
        """Displacements (3n, 3k) [m] of the shell at rest beyond its modes, under loads (3n, 3k) [N]."""
        basis, shell = self._basis, self._basis.shell
        whole = np.asarray(shell.unknowns.prolong(solve(np.asarray(shell.unknowns.restrict(loads)))))
        modes, eigenvalues = basis.modes[:, basis.rigid_modes :], basis.eigenvalues[basis.rigid_modes :]
        # Of one vertex at a time: sums of a product depend on its width, and the vertices on when a run was resumed.
        for three in np.split(np.arange(loads.shape[1]), loads.shape[1] // 3):
            whole[:, three] -= modes @ ((modes.T @ loads[:, three]) / eigenvalues[:, None])
            if self._means is not None:
                means, back = self._means
                whole[:, three] -= back @ (means.T @ whole[:, three])
        return whole

    def _held(self, solve: Callable[[Array], Array]) -> tuple[Array, Array]:
        """Means (3n, 3p) of the patches, and displacements (3n, 3p) [m] beyond the modes that move each by a unit."""
        means = np.zeros((len(self.places), 3, len(self._patches), 3))
        for index, vertices in enumerate(self._patches):
            means[vertices, :, index] = np.eye(3) / vertices.size
        rows = means.reshape(-1, 3 * len(self._patches))
        given = self._residual_flexibility(solve, rows)
        return rows, given @ np.linalg.pinv(rows.T @ given, rcond=_GIVES, hermitian=True)


def _static_solver(basis: Basis) -> tuple[Callable[[Array], Array], int]:
    """Static solutions of a shell at rest under forces on its free unknowns, without rigid motions.

    Also returns of how many vertices at once: a solution is not to depend on those that come with it.
    """
    shell = basis.shell
    data = shell.hessian(shell.rest_positions, EXACT if shell.stressed else GAUSS_NEWTON)
    if basis.rigid_modes:
        return RigidFreeSolver.of(shell, data).solve, 1
    try:
        factor = Factoriser(use="solve").definite(shell.pattern.free_matrix(data))
    except SolverError as error:
        raise SolverError(f"contacts of a modal model need a shell that its supports hold: {error}") from error
    solve = condensed_factor(factor, shell.pattern.internal_count).solve
    return (lambda loads: solve(loads)), _TOGETHER if factor.backend == "cholesky" else 1
