"""Contact of modal models: a small complementarity problem in modal coordinates, with the residual compliance.

Of the vertices the nearest to the colliders are candidates in each frame. Modes alone leave the problem singular where
more vertices touch than there are modes: what the shell gives way beyond its modes, quasi-statically, under a force at
a vertex makes it regular. It is the residual compliance ``K^-1 - Phi Lambda^-1 Phi^T``, turned with the vertices
(theory 13, eq. 7 and 8).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from scipy.spatial.transform import Rotation

from modalshell.contact.complementarity import complementary, local_shape, residual_compliance
from modalshell.contact.contact import Contact
from modalshell.contact.touching import EXACT_GAP, Touching
from modalshell.core.errors import SolverError
from modalshell.core.typing import Array, Index
from modalshell.modes import Basis, Factoriser, condensed_factor
from modalshell.shell import GAUSS_NEWTON

CANDIDATES = 50
"""Vertices that may touch in a frame at most: the nearest."""
_NEAR = 0.02
"""Gap, as a share of the shell's size, up to which a vertex is a candidate."""
_KEPT = 2e8
"""Bytes of local shapes that are kept."""
_SETTLED = 1e-9
"""Gap, as a share of the shell's size, at which a frame is solved."""
_MOVED = 1e-3
"""Move, as a share of the shell's size, of a linearisation that still counts as one about its end."""
_PASSES = 12
"""Linearisations of a frame at most."""

Rows = Callable[[Array, Index], Array]
"""Derivatives (k, 3, m) of some vertices' positions by the coordinates (m,)."""


@final
@dataclass(frozen=True, eq=False)
class Pressed:
    """Where contacts leave a modal shell.

    Attributes
    ----------
    q : ndarray, shape (m,)
        Coordinates.
    local : ndarray, shape (n, 3)
        Displacements [m] beyond the modes.
    pushes : ndarray, shape (r,)
        Forces [N] along the normals, of all rows.
    solved : bool
        Whether the gaps of all rows met their tolerance.
    """

    q: Array
    local: Array
    pushes: Array
    solved: bool


@final
class ModalContacts:
    """Contacts of a modal model.

    Parameters
    ----------
    contacts : sequence of Contact
        The contacts.
    basis : Basis
        Its modes; its shell is held by supports.
    positions : callable
        Positions (n, 3) [m] at coordinates (m,).
    rows : callable
        Their derivatives at some vertices.
    turns : bool
        Whether vertices turn with the modal rotations.

    Attributes
    ----------
    touching : Touching
        The contacts at the time that is looked at.
    """

    def __init__(
        self,
        contacts: Sequence[Contact],
        basis: Basis,
        positions: Callable[[Array], Array],
        rows: Rows,
        *,
        turns: bool = True,
    ) -> None:
        self.touching = Touching(contacts, basis.shell)
        self._basis, self._positions, self._rows, self._turns = basis, positions, rows, turns
        count = len(basis.shell.rest_positions)
        self._places, self._used = np.full(count, -1, np.int64), 0
        self._store = np.empty((0, count, 3, 3))
        self._solve: Callable[[Array], Array] | None = None
        self._most = max(CANDIDATES, int(_KEPT / (72.0 * count)))

    def at(self, time: float) -> None:
        """Look at the colliders as they are at ``time`` [s]."""
        self.touching = self.touching.at(time)

    def _slots(self, vertices: Index) -> Index:
        """Places (k,) of the local shapes of vertices, which are found where they are not kept."""
        missing = [int(vertex) for vertex in np.unique(vertices) if self._places[vertex] < 0]
        if len(missing) + self._used > self._most:
            self._places[:], self._used = -1, 0
            missing = [int(vertex) for vertex in np.unique(vertices)]
        for vertex in missing:
            if self._used == len(self._store):  # twice as large
                room = min(self._most, max(CANDIDATES, 2 * self._used)) - self._used
                self._store = np.concatenate([self._store, np.empty((room, *self._store.shape[1:]))])
            self._store[self._used] = self._shape(vertex)
            self._places[vertex] = self._used
            self._used += 1
        return self._places[vertices]

    def _shape(self, vertex: int) -> Array:
        """Displacements (n, 3, 3) [m] of the shell at rest beyond its modes, under unit forces on a vertex."""
        basis, shell = self._basis, self._basis.shell
        if self._solve is None:
            self._solve = _static_solver(basis)
        loads = np.zeros((shell.rest_positions.size, 3))
        loads[3 * vertex + np.arange(3), np.arange(3)] = 1.0
        whole = np.asarray(shell.unknowns.prolong(self._solve(np.asarray(shell.unknowns.restrict(loads)))))
        by_modes = basis.modes @ ((basis.modes.T @ loads) / basis.eigenvalues[:, None])
        return np.asarray((whole - by_modes).reshape(-1, 3, 3))

    def _rotation_vectors(self, q: Array) -> Array:
        """Rotation vectors (n, 3) [rad] of the vertices at q."""
        if not self._turns:
            return np.zeros_like(self._basis.shell.rest_positions)
        return np.asarray(self._basis.rotations @ q).reshape(-1, 3)

    def _own(self, vertices: Index, normals: Array, turns: Array) -> Array:
        """Normals (k, 3) in the axes of their vertices at rest."""
        if not self._turns:
            return normals
        return np.ascontiguousarray(Rotation.from_rotvec(turns[vertices]).apply(normals, inverse=True))

    def candidates(self, gaps: Array) -> Index:
        """Rows (k,) of the nearest vertices."""
        near = np.flatnonzero(gaps < _NEAR * self.touching.size)
        if near.size > CANDIDATES:
            near = near[np.argpartition(gaps[near], CANDIDATES)[:CANDIDATES]]
        return np.sort(near)

    def touches(self, q: Array, local: Array | float = 0.0) -> bool:
        """Whether a vertex touches at coordinates q, or is inside."""
        deep = EXACT_GAP * self.touching.size
        return bool((self.touching.distances(self._positions(q) + local) <= deep).any())

    def press(self, free: Array, compliance: Array, start: Array) -> Pressed:
        """The coordinates nearest to ``free`` (m,), in the norm of the stiffness, that leave every vertex outside.

        ``q = free + G J^T f`` with ``0 <= f _|_ gap(x(q) + local shapes of f) >= 0``, linearised about ``start`` and
        again where that leads. ``compliance`` is G, (m,) or (m, m).
        """
        pressed = Pressed(start, np.zeros_like(self._basis.shell.rest_positions), self._no_pushes(), False)
        for _ in range(_PASSES):
            pressed = self.press_once(free, compliance, pressed.q, pressed.pushes)
            if pressed.solved:
                break
        return pressed

    def press_once(self, free: Array, compliance: Array, q: Array, pushes: Array) -> Pressed:
        """The same to first order about ``q`` (m,) with ``pushes`` (r,) [N]; solved if its end meets the gaps."""
        touching, size = self.touching, self.touching.size
        gaps = touching.distances(self._positions(q) + self._local(q, pushes))
        rows = np.union1d(self.candidates(gaps), np.flatnonzero(pushes)).astype(np.int64)
        if rows.size:
            after, pushes, move = self._linearised(q, free, compliance, rows, pushes)
        else:
            after, move = free, 0.0
        local = self._local(after, pushes)
        gaps = touching.distances(self._positions(after) + local)
        held = float(np.abs(gaps[pushes > 0.0]).max(initial=0.0))
        met = float(gaps.min(initial=0.0)) >= -_SETTLED * size and held <= _SETTLED * size
        return Pressed(after, local, pushes, met and move <= _MOVED * size)

    def _no_pushes(self) -> Array:
        return np.zeros(self.touching.vertices.size)

    def _local(self, q: Array, pushes: Array) -> Array:
        """Displacements (n, 3) [m] beyond the modes, under forces along the normals."""
        local = np.zeros_like(self._basis.shell.rest_positions)
        rows = np.flatnonzero(pushes)
        if rows.size:
            vertices, turns = self.touching.vertices[rows], self._rotation_vectors(q)
            own = self._own(vertices, self.touching.gaps(self._positions(q), rows)[1], turns)
            slots = self._slots(vertices)
            local_shape(self._store, slots, pushes[rows, None] * own, turns, local)
        return local

    def _linearised(
        self, q: Array, free: Array, compliance: Array, rows: Index, before: Array
    ) -> tuple[Array, Array, float]:
        """Coordinates and forces of all rows of the problem linearised at q, and the move [m] there."""
        touching = self.touching
        vertices = touching.vertices[rows]
        gap, normals, _ = touching.gaps(self._positions(q), rows)
        moves = self._rows(q, vertices)
        along = np.einsum("kim,ki->km", moves, normals)
        softened = along * compliance if compliance.ndim == 1 else along @ compliance.T
        own = self._own(vertices, np.ascontiguousarray(normals), self._rotation_vectors(q))
        slots, between = self._slots(vertices), np.empty((rows.size, rows.size))
        residual_compliance(self._store, slots, vertices, own, between)
        matrix = along @ softened.T + between
        matrix[np.diag_indices(rows.size)] += 1e-9 * np.trace(matrix) / rows.size
        offset = gap + along @ (free - q)
        forces = before[rows].copy()
        accuracy = 1e-12 * touching.size
        complementary(np.ascontiguousarray(matrix), offset, forces, accuracy)
        pushes = np.zeros_like(before)
        pushes[rows] = forces
        after = free + softened.T @ forces
        move = np.abs(moves @ (after - q)).max(initial=0.0)
        return after, pushes, float(move)


def _static_solver(basis: Basis) -> Callable[[Array], Array]:
    """Static solutions of a shell at rest under forces on its free unknowns."""
    shell = basis.shell
    data = shell.energy_gradient_hessian(shell.rest_positions, GAUSS_NEWTON)[2]
    internal = shell.pattern.internal
    try:
        factor = Factoriser(use="solve").definite(shell.pattern.free_matrix(data))
    except SolverError as error:
        raise SolverError(f"contacts of a modal model need a shell that its supports hold: {error}") from error
    solve = condensed_factor(factor, 0 if internal is None else internal.count).solve
    return lambda loads: solve(loads)
