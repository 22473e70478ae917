"""How vertices of modal models turn, and their frames on colliders that are not compiled: derivatives by vertex."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, final

import numpy as np

from modalshell.contact import modal_kernels as kernels
from modalshell.contact import row_kernels as rows_by
from modalshell.contact.gap_kernels import Packed
from modalshell.contact.local_shapes import LocalShapes
from modalshell.contact.pressed import Pressed
from modalshell.contact.touching import Touching
from modalshell.core.typing import Array, Index

SETTLED = 1e-9
"""Gap, as a share of the shell's size, at which a frame is solved."""
FAR = 1e-4
"""Move, as a share of the shell's size, of a linearisation that still counts as one about its end."""
SMALL = 1e-12
"""Gap, as a share of the shell's size, that is none in small problems."""
STILL = 1e-5
"""Move, as a share of the shell's size, since derivatives were taken, within which they are kept."""
NEARLY = 1e-7
"""Gap, as a share of the shell's size, that one more solution closes: derivatives change little over FAR."""

Near = Callable[[Array, Index, Array | None], tuple[Array, Array | None]]
"""Positions (k, 3) [m] of some vertices, and derivatives (k, d, m) along directions (d, 3), if these are asked for."""
_NONE = np.empty((0, 3))
"""Rotation vectors of vertices that do not turn."""


@final
class Turning:
    """Rotation vectors of vertices at coordinates (m,); what was asked for last is kept.

    Vertices turn with the modal ``rotations`` (3n, m), or not, or ``turns`` gives their rotation vectors (n, 3) [rad].
    ``spin`` (m, 3n) are the turns of all in each mode; (0, 3n) where they do not turn by these.
    """

    def __init__(self, turns: bool | Callable[[Array], Array], rotations: Array) -> None:
        self._turns, self.spin = turns, np.empty((0, len(rotations)))
        if turns is True:
            self.spin = np.ascontiguousarray(rotations.T)
        self._last: tuple[Array, Array] | None = None
        self._chosen = b"", np.empty((len(self.spin), 0))

    def vectors(self, q: Array) -> Array:
        """Rotation vectors (n, 3) [rad] of all vertices at q; (0, 3) where they do not turn."""
        if not self._turns:
            return _NONE
        last = self._last
        if last is not None and last[0] is q:
            return last[1]
        vectors = self._turns(q) if callable(self._turns) else np.asarray(q @ self.spin).reshape(-1, 3)
        self._last = q, vectors
        return vectors

    def unspun(self, q: Array) -> Array:
        """Rotation vectors (n, 3) of all vertices where these do not turn by :attr:`spin`, else (0, 3)."""
        return self.vectors(q) if callable(self._turns) else _NONE

    def of(self, q: Array, vertices: Index) -> Array:
        """Rotation vectors (k, 3) [rad] of some vertices; (0, 3) where they do not turn."""
        by_modes, vectors = self.parts(q, vertices)
        return np.asarray(q @ by_modes).reshape(-1, 3) if len(by_modes) else vectors

    def parts(self, q: Array, vertices: Index) -> tuple[Array, Array]:
        """Turns (m, 3k) of some vertices in each mode, whatever q; or, without modes, their vectors (k, 3) at q."""
        (known, by_modes), key = self._chosen, vertices.tobytes()
        if not len(self.spin):
            return by_modes, self.vectors(q)[vertices] if self._turns else _NONE
        if known != key:
            by_modes = self.spin.reshape(q.size, -1, 3)[:, vertices].reshape(q.size, 3 * vertices.size)
            self._chosen = key, by_modes
        return by_modes, _NONE


class Pressing(Protocol):
    """What frames need of the contacts that ask for them; see :class:`~modalshell.contact.modal.ModalContacts`."""

    touching: Touching
    bodies: Packed | None
    directions: Array
    shapes: LocalShapes
    spins: Turning
    reach: Array

    def positions(self, q: Array) -> Array:
        """Positions (n, 3) [m] at q (m,)."""

    def moves(self, q: Array, vertices: Index) -> Array:
        """Their derivatives (k, 3, m) at some vertices."""

    def candidates(self, gaps: Array, pushes: Array, reach: float = np.inf) -> Index:
        """Rows (k,) of the candidates."""

    def ended(self, q: Array, slots: Index, forces: Array) -> tuple[Array, Array, Array, float]:
        """Positions and displacements (n, 3) [m], gaps (r,) [m], and the least of these."""


@final
class RowFrames:
    """Problems of the rows of contacts, of vertices whose positions and derivatives ``near`` gives, or those of all."""

    def __init__(self, pressing: Pressing, near: Near | None) -> None:
        self._pressing, self._near = pressing, near
        self._reach, self._still = pressing.reach, STILL * pressing.touching.size
        self._taken: tuple[bytes, Array, Array] | None = None

    @property
    def alone(self) -> bool:
        """Whether some vertices can be looked at without all others."""
        return self._near is not None and self._pressing.bodies is not None

    def press(
        self,
        free: Array,
        compliance: Array,
        begin: tuple[Array, Array, Array],
        gaps: Array,
        before: tuple[Array, Array, float, Array | None],
    ) -> Pressed:
        """As of :meth:`ModalContacts.press`, to which ``before`` adds how far [m] a vertex may go."""
        start, q, base = begin
        local, pushes, reach, at = before
        pressed, at = self.begin(Pressed(q, local, pushes, False, base, at=at), start)
        for _ in range(rows_by.PASSES):
            rows = self._pressing.candidates(gaps, pressed.pushes, reach)
            pressed = self.newton(free, compliance, pressed, rows, rows_by.CORRECTIONS, at)[0]
            assert pressed.gaps is not None
            if pressed.solved:
                break
            gaps, at = np.minimum(gaps, pressed.gaps), pressed.q  # what entered is taken in, too
        return pressed

    def begin(self, before: Pressed, start: Array) -> tuple[Pressed, Array]:
        """Where a problem is linearised that is to begin at ``start`` (m,), and the coordinates of its derivatives.

        Those of earlier frames serve as long as the shell is almost where they were taken.
        """
        at = before.at
        if at is None or not kernels.reach_of(at, start, self._reach) <= self._still:
            return before._replace(q=start, positions=None, at=start), start
        return before, at

    def stay(
        self, free: Array, compliance: Array, before: Pressed, start: Array, rows: Index
    ) -> tuple[Pressed, Array] | tuple[None, None]:
        """The same where all ``rows`` stay pushed, begun as of :meth:`press`; None where one opens.

        Where rows are looked at :attr:`alone`, all in ``before`` and what is returned is of these: positions and
        displacements (k, 3), forces and gaps (k,). Also returned are forces (k, 3) [N] in the axes at rest.
        """
        pressed, at = self.begin(before, start)
        for _ in range(rows_by.PASSES):
            pressed, turned = self.newton(free, compliance, pressed, rows, rows_by.CORRECTIONS, at, alone=self.alone)
            if np.count_nonzero(pressed.pushes > 0.0) < rows.size:
                break
            if pressed.solved:
                return pressed, turned
            at = pressed.q
        return None, None

    def _frame(self, q: Array, vertices: Index) -> tuple[Array, Array]:
        """Positions (k, 3) [m] of some vertices at q (m,), and derivatives (k, d, m); those of the last are kept."""
        directions, pressing = self._pressing.directions, self._pressing
        asked, kept = b"".join(part.tobytes() for part in (q, vertices, directions)), self._taken
        if kept is None or kept[0] != asked:
            if self._near is None:
                points, moves = pressing.positions(q)[vertices], directions @ pressing.moves(q, vertices)
            else:
                points, moves = self._near(q, vertices, directions)  # type: ignore[assignment]
            kept = self._taken = asked, points, np.ascontiguousarray(moves)
        return kept[1:]

    def newton(
        self,
        free: Array,
        compliance: Array,
        begin: Pressed,
        rows: Index,
        corrections: int,
        at: Array,
        *,
        alone: bool = False,
    ) -> tuple[Pressed, Array]:
        """The problem of some rows linearised at ``begin``, by derivatives at ``at`` (m,), corrected by its gaps.

        Also returns forces (k, 3) [N] in the axes at rest. ``alone`` is as of :meth:`stay`.
        """
        pressing, touching, q = self._pressing, self._pressing.touching, begin.q
        size, vertices, contact_of = touching.size, touching.vertices[rows], touching.contact_of[rows]
        points, moves = self._frame(at, vertices)
        begun_anew = at is q  # not whether they were known: that is not the same once resumed
        own, chosen = (np.arange(rows.size), np.arange(rows.size)) if alone else (vertices, rows)
        if begin.positions is not None:
            points = begin.positions[own]
        (slots, between), symmetric = pressing.shapes.between(vertices), compliance.ndim == 1
        forces, pushes, turning = begin.pushes[chosen], np.zeros(begin.pushes.size), pressing.spins.parts(q, vertices)
        count, place, near = rows.size, (own, contact_of, begin.local, between), self._near
        square, normals = np.empty((2, count, count)), np.empty((3, count))
        problem = square[0], square[1], np.empty((count, q.size)), np.empty(count), normals
        if pressing.bodies is not None:
            given = q, free, forces
            rows_by.row_begin(pressing.bodies, place, points, moves, given, turning, compliance, problem)
        else:
            x = begin.local.copy()
            x[vertices] += points
            frame = *touching.gaps(x, rows)[:2], vertices, begin.local
            turns = pressing.spins.of(q, vertices)
            rows_by.row_problem(moves, frame, (free - q, forces), turns, between, compliance, problem)
        turned, expected, reached, local = np.empty((count, 3)), np.empty(count), np.empty(count), np.empty((count, 3))
        for left in reversed(range(corrections)):
            after = np.empty(q.size)
            energy = rows_by.row_end(problem, forces, free, SMALL * size, symmetric, (after, turned, expected))
            # Where derivatives stay, near rest, the first solve mostly serves: all vertices are asked for at once.
            few = alone or (0 < left < corrections - 1 + begun_anew and pressing.bodies is not None)
            if few and near is not None:
                turning = pressing.spins.parts(after, vertices)
                base, bodies, least = near(after, vertices, None)[0], pressing.bodies, np.inf
                off = rows_by.row_reached(place, base, turned, forces, turning, after, bodies, (reached, local))
                gaps = reached
            else:
                base, local, gaps, least = pressing.ended(after, slots, turned)
                reached, off = gaps[rows], rows_by.row_off(gaps[rows], forces)
            if not SETTLED * size < off < np.inf:
                break
            problem[3][:] += reached - expected
        if few and not alone and near is not None:
            base, local, gaps, least = pressing.ended(after, slots, turned)
        move = rows_by.row_ended(base, own, points, chosen, forces, pushes)
        solved = max(off, -least) <= SETTLED * size and move <= FAR * size
        return Pressed(after, local, pushes, solved, base, energy, at, gaps), turned
