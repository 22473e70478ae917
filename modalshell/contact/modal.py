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

from modalshell.contact import modal_kernels as kernels
from modalshell.contact.complementarity import complementary
from modalshell.contact.contact import Contact
from modalshell.contact.gap_kernels import gaps_of
from modalshell.contact.local_shapes import LocalShapes
from modalshell.contact.touching import EXACT_GAP, Touching
from modalshell.core.typing import Array, Index
from modalshell.kernels.rotations import rotate
from modalshell.modes import Basis

CANDIDATES = 50
"""Vertices of a frame, the nearest, that may touch it; all that are inside may, as far as their shapes are kept."""
_NEAR = 0.02
"""Gap, as a share of the shell's size, up to which a vertex is a candidate at most."""
_SETTLED = 1e-9
"""Gap, as a share of the shell's size, at which a frame is solved."""
_MOVED = 1e-3
"""Move, as a share of the shell's size, of a linearisation that still counts as one about its end."""
_PASSES = 12
"""Linearisations of a frame at most."""
_SOFT = 1e-9
"""Compliance added, as a share of the mean one: more vertices may touch than the modes can move apart."""
_CORRECTIONS = 8
"""Corrections of one by the gaps that it leads to, at most."""
_NO_TURNS = np.empty((0, 3))
_RENEWED = 12
"""Times that vertices are taken in which a frame's end would leave inside."""

Rows = Callable[[Array, Index], Array]
"""Derivatives (k, 3, m) of some vertices' positions by the coordinates (m,)."""
Shape = tuple[Array, Array, Array, bool]
"""Positions at rest (n, 3), modes and modal rotations (3n, m), and whether these turn the modes."""


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
    positions : ndarray or None, shape (n, 3)
        Positions [m] at q, without what is beyond the modes, where they are known.
    energy : float
        Elastic energy [J] of what is beyond the modes.
    """

    q: Array
    local: Array
    pushes: Array
    solved: bool
    positions: Array | None = None
    energy: float = 0.0


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
    turns : bool or callable
        Whether vertices turn with the modal rotations, or their rotation vectors (n, 3) [rad] at coordinates (m,).
    shape : tuple, optional
        Of warps in closed form, whose frames are compiled: positions at rest, modes, rotations, and ``turns``.

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
        turns: bool | Callable[[Array], Array] = True,
        shape: Shape | None = None,
    ) -> None:
        self.touching = Touching(contacts, basis.shell)
        self._basis, self._positions, self._rows, self._turns = basis, positions, rows, turns
        self._shape, self._spin = shape, np.asfortranarray(basis.rotations)
        self._shapes = LocalShapes(basis, CANDIDATES)
        self._moving = any(contact.motion is not None for contact in self.touching.contacts)
        self._bodies = self.touching.packed()

    @property
    def no_pushes(self) -> Array:
        """Forces (r,) [N] along the normals where nothing touches."""
        return np.zeros(self.touching.vertices.size)

    def at(self, time: float) -> None:
        """Look at the colliders as they are at ``time`` [s]."""
        if self._moving or self._bodies is None:
            self.touching = self.touching.at(time)
        if self._moving:
            self._bodies = self.touching.packed()

    def positions(self, q: Array) -> Array:
        """Positions (n, 3) [m] at q (m,), without what is beyond the modes."""
        return self._positions(q)

    def along(self, q: Array, rows: Index) -> Array:
        """Derivatives (k, m) of the gaps of some rows."""
        moves = self._rows(q, self.touching.vertices[rows])
        normals = self.touching.gaps(self._positions(q), rows)[1]
        return np.asarray((normals[:, None, :] @ moves)[:, 0])

    def turning(self, q: Array, x: Array, pushes: Array) -> Array:
        """Stiffness (m, m) that ``pushes`` (r,) [N] at positions x (n, 3) take away as they turn with the surfaces."""
        rows = np.flatnonzero(pushes)
        moves, curvatures = self._rows(q, self.touching.vertices[rows]), self.touching.gaps(x, rows)[2]
        return np.einsum("kim,kij,kjl->ml", moves, pushes[rows, None, None] * curvatures, moves, optimize=True)

    def pull(self, q: Array, forces: Array) -> Array:
        """Generalised force (m,) of contact forces (n, 3) [N]."""
        vertices = np.flatnonzero(forces.any(axis=1))
        return np.einsum("ki,kim->m", forces[vertices], self._rows(q, vertices))

    def gaps(self, x: Array) -> Array:
        """Gaps (r,) [m] of all rows at positions x (n, 3)."""
        touching = self.touching
        if self._bodies is None:
            return touching.distances(x)
        gaps = np.empty(touching.vertices.size)
        gaps_of(self._bodies, touching.vertices, touching.contact_of, np.ascontiguousarray(x), gaps)
        return gaps

    def _rotation_vectors(self, q: Array) -> Array:
        """Rotation vectors (n, 3) [rad] of the vertices at q."""
        if callable(self._turns):
            return self._turns(q)
        if not self._turns:
            return _NO_TURNS
        return np.asarray(self._spin @ q).reshape(-1, 3)

    def _own(self, vertices: Index, normals: Array, turns: Array) -> Array:
        """Normals (k, 3) in the axes of their vertices at rest."""
        if not self._turns:
            return normals
        own = np.empty(normals.shape)
        rotate(turns[vertices], np.ascontiguousarray(normals), -1.0, own)
        return own

    def candidates(self, gaps: Array, pushes: Array, reach: float = np.inf) -> Index:
        """Rows (k,) of the vertices nearer than ``reach`` [m], and of those that are inside or pushed."""
        near, kept = min(reach, _NEAR * self.touching.size), self._shapes.most
        most = CANDIDATES if reach < np.inf else kept
        return np.asarray(kernels.candidates(gaps, pushes, near, most, kept))

    def touched(self, gaps: Array) -> bool:
        """Whether a row of some gaps (r,) touches, or is inside."""
        return bool((gaps <= EXACT_GAP * self.touching.size).any())

    def press(
        self, free: Array, compliance: Array, start: Array, gaps: Array, before: tuple[Array, Array, float]
    ) -> Pressed:
        """The coordinates nearest to ``free`` (m,), in the norm of the stiffness, that leave every vertex outside.

        ``q = free + G J^T f`` with ``0 <= f _|_ gap(x(q) + local shapes of f) >= 0``, linearised about ``start`` (m,)
        and again where that leads. ``compliance`` is G, (m,).

        Parameters
        ----------
        free, compliance, start : ndarray, shape (m,)
            As above.
        gaps : ndarray, shape (r,)
            Gaps [m] of all rows before, which choose the candidates.
        before : tuple
            Displacements (n, 3) [m] beyond the modes, and forces (r,) [N], before; how far a vertex may go [m].
        """
        local, pushes, reach = before
        if self._shape is None or self._bodies is None:
            return self._press_by_rows(free, compliance, start, gaps, before)
        touching, size, shapes = self.touching, self.touching.size, self._shapes
        near = min(reach, _NEAR * size)
        limits = near, CANDIDATES, shapes.most, _SETTLED * size, _MOVED * size, 1e-12 * size
        step = free, compliance, start
        for _ in range(_RENEWED):
            while True:
                rows_of = touching.vertices, touching.contact_of, shapes.places, shapes.blocks
                found = kernels.press(self._shape, rows_of, self._bodies, step, (gaps, pushes, local), limits)
                if found[2].size:
                    break
                shapes.slots(touching.vertices[found[0]])
            _, slots, q, pushes, forces, energy, solved = found
            shape, turns = np.empty_like(local), self._rotation_vectors(q)
            kernels.local_shape(shapes.store, slots, forces, turns, shape)
            base = self._positions(q)
            after = self.gaps(base + shape)
            if not solved or after.min() >= -limits[3]:
                break
            gaps, local = np.minimum(gaps, after), shape  # what entered is taken in, too
        return Pressed(q, shape, pushes, bool(solved and after.min() >= -limits[3]), base, energy)

    def _press_by_rows(
        self, free: Array, compliance: Array, start: Array, gaps: Array, before: tuple[Array, Array, float]
    ) -> Pressed:
        """The same of models and colliders whose frames are not compiled: their gaps and rows are asked for."""
        local, pushes, reach = before
        pressed = Pressed(start, local, pushes, False, self._positions(start))
        for _ in range(_PASSES):
            rows = self.candidates(gaps, pressed.pushes, reach)
            pressed, after = self._newton(free, compliance, pressed, rows, _CORRECTIONS)
            if pressed.solved:
                break
            gaps = np.minimum(gaps, after)  # what entered is taken in, too
        return pressed

    def press_once(self, free: Array, compliance: Array, q: Array, pushes: Array) -> Pressed:
        """The same to first order about ``q`` (m,) with ``pushes`` (r,) [N]; solved if its end meets the gaps.

        ``compliance`` is G, (m,) or (m, m).
        """
        return self.pressed_on(free, compliance, self.state(q, pushes, 0.0))

    def pressed_on(self, free: Array, compliance: Array, begin: Pressed) -> Pressed:
        """The same about a :meth:`state`."""
        assert begin.positions is not None
        rows = self.candidates(self.gaps(begin.positions + begin.local), begin.pushes)
        return self._newton(free, compliance, begin, rows, 1)[0]

    def state(self, q: Array, pushes: Array, local: Array | float) -> Pressed:
        """What forces (r,) [N] press in at q (m,), along the normals where ``local`` (n, 3) [m] was pressed in."""
        base = self._positions(q)
        return Pressed(q, self._local(q, pushes, base + local), pushes, False, base)

    def _local(self, q: Array, pushes: Array, base: Array) -> Array:
        """Displacements (n, 3) [m] beyond the modes, under forces along the normals at positions (n, 3)."""
        rows = np.flatnonzero(pushes)
        vertices, turns = self.touching.vertices[rows], self._rotation_vectors(q)
        own = self._own(vertices, self.touching.gaps(base, rows)[1], turns)
        return self._shape_under(vertices, pushes[rows, None] * own, turns)

    def _shape_under(self, vertices: Index, forces: Array, turns: Array) -> Array:
        """Displacements (n, 3) [m] beyond the modes under forces (k, 3) [N] in the axes at rest, turned."""
        local, slots = np.empty_like(self._basis.shell.rest_positions), self._shapes.slots(vertices)
        kernels.local_shape(self._shapes.store, slots, forces, turns, local)
        return local

    def _newton(
        self, free: Array, compliance: Array, begin: Pressed, rows: Index, corrections: int
    ) -> tuple[Pressed, Array]:
        """The problem of some rows linearised at ``begin``, corrected by the gaps it leads to; and these gaps (r,)."""
        touching, size, q = self.touching, self.touching.size, begin.q
        vertices, base = touching.vertices[rows], self._positions(q) if begin.positions is None else begin.positions
        gap, normals, _ = touching.gaps(base + begin.local, rows)
        moves = self._rows(q, vertices)
        along = (normals[:, None, :] @ moves)[:, 0]
        softened = along * compliance if compliance.ndim == 1 else along @ compliance.T
        own = self._own(vertices, np.ascontiguousarray(normals), self._rotation_vectors(q))
        slots, matrix = self._shapes.slots(vertices), np.empty((rows.size, rows.size))
        kernels.residual_compliance(self._shapes.blocks, slots, own, matrix)
        beyond = matrix.copy()
        matrix += along @ softened.T
        soft = _SOFT * np.trace(matrix) / max(rows.size, 1)
        matrix[np.diag_indices(rows.size)] += soft
        columns = np.ascontiguousarray(matrix.T)
        offset = gap - np.sum(normals * begin.local[vertices], axis=1) + along @ (free - q)
        forces, pushes = begin.pushes[rows], np.zeros_like(begin.pushes)
        offset -= soft * forces  # softened about the forces before, so that repeated problems close the gaps
        for _ in range(corrections):
            complementary(columns, offset, forces, 1e-12 * size, compliance.ndim == 1)
            after = free + softened.T @ forces
            local = self._shape_under(vertices, forces[:, None] * own, self._rotation_vectors(after))
            base = self._positions(after)
            gaps = self.gaps(base + local)
            held = float(np.abs(gaps[rows[forces > 0.0]]).max(initial=0.0))
            near = max(held, -float(gaps[rows].min(initial=0.0)))
            if not _SETTLED * size < near < np.inf:
                break
            offset = offset + gaps[rows] - (offset + matrix @ forces)
        pushes[rows] = forces
        move = float(np.abs(moves @ (after - q)).max(initial=0.0))
        met = max(near, -float(gaps.min(initial=0.0))) <= _SETTLED * size
        energy = 0.5 * float(forces @ beyond @ forces)
        return Pressed(after, local, pushes, met and move <= _MOVED * size, base, energy), gaps
