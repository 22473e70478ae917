"""Frames of a modal shell that rests on colliders: one small linear problem, kept as long as the shell stays there.

About a frame that was solved with all its gaps, the shell's positions are linear in coordinates and forces while these
change by rounding: what is left out is of second order. So one problem serves, of all models alike, and no position is
asked for (theory 13, eq. 7 and 8).
"""

from __future__ import annotations

from typing import final

import numpy as np

from modalshell.contact.modal import ModalContacts
from modalshell.contact.rest_kernels import rest_frame
from modalshell.contact.row_kernels import row_problem
from modalshell.core.typing import Array

STILL = 1e-11
"""Move of a frame, as a share of the shell's size, from which it counts as one at rest."""
_STAYS = 1e-10
"""Move, as a share of the shell's size, since the problem was taken, within which it is kept."""
_OPEN = 1e-8
"""Gap, as a share of the shell's size, from which a vertex cannot touch within that move."""
_ACCURACY = 1e-12
"""Gap, as a share of the shell's size, that is none in the small problem."""


@final
class Resting:
    """The problem about one frame at rest, on colliders at rest.

    It is ``about`` the coordinates (m,), forces (r,) [N] and displacements (n, 3) [m] beyond the modes of that frame,
    and the coordinates (m,) at which it took derivatives; ``compliance`` (m,) is the change of the coordinates [s^2] in
    a step of implicit Euler per modal force, and ``eigenvalues`` (m,) are the stiffness of the modes [1/s^2]. Another
    frame, or step, has another problem.
    """

    def __init__(
        self, pressing: ModalContacts, about: tuple[Array, Array, Array, Array], compliance: Array, eigenvalues: Array
    ) -> None:
        self.about, self.compliance = about, compliance
        self._serves = False
        (at, pushes, local, taken), touching, shapes = about, pressing.touching, pressing.shapes
        size, x = touching.size, pressing.positions(at) + local
        rows = np.flatnonzero((pressing.gaps(x) < _OPEN * size) | (pushes > 0.0))
        vertices, count = touching.vertices[rows], rows.size
        if np.unique(vertices).size > shapes.most:
            return
        gap, normals, _ = touching.gaps(x, rows)
        slots, between = shapes.between(vertices)
        forces, moves = pushes[rows], np.ascontiguousarray(pressing.moves(taken, vertices))
        columns, beyond = np.empty((2, count, count))
        problem = columns, beyond, np.empty((count, at.size)), np.empty(count), np.empty((3, count))
        frame, turns = (gap, normals, vertices, local), pressing.spins.of(at, vertices)
        row_problem(moves, frame, (np.zeros(at.size), forces), turns, between, compliance, problem)
        # What the frame left of the gaps that it closed counts as none: the problem's answer there is the frame's.
        left, chosen = np.where(forces > 0.0, 0.0, np.maximum(gap, 0.0)), np.flatnonzero(forces > 0.0)
        across = np.ascontiguousarray(np.einsum("ki,kim->km", normals, moves))
        try:
            inverse = np.linalg.inv(columns[np.ix_(chosen, chosen)])
        except np.linalg.LinAlgError:
            return
        slopes, loaded = beyond @ forces, float((columns - beyond - problem[2] @ across.T)[:1, :1].sum())
        self._kept = columns, left, forces, chosen, inverse
        self._about = at, forces @ problem[2], across, problem[2], float(0.5 * forces @ slopes), slopes
        longest = np.abs(shapes.store[slots]).max(axis=(1, 2), initial=0.0).astype(np.float64)
        self._step = compliance, eigenvalues, pressing.reach_within(local), longest, rows
        self._limits = _STAYS * size, _ACCURACY * size, loaded
        self._serves = all(np.isfinite(part).all() for part in (columns, across, inverse))

    def frame(self, before: tuple[Array, Array], force: Array, dt: float, out: tuple[Array, Array, Array]) -> bool:
        """Whether the end of a step under a modal ``force`` (m,) is one of this problem; it is written to ``out``.

        ``before`` are coordinates and rates (m,) at the step's beginning; ``out`` coordinates and rates without
        contacts, then with these (4, m), forces (r,) [N], and the energy (1,) [J] beyond the modes.
        """
        given = self._kept, self._about, self._step, before, force, dt, self._limits, out
        return self._serves and bool(rest_frame(*given))
