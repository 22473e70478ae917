"""Frames of a modal shell that rests on colliders: one small linear problem, kept as long as the shell stays there.

About a frame that was solved with all its gaps, the shell's positions are linear in coordinates and forces while these
change by rounding: what is left out is of second order. So one problem serves, of all models alike, and no position is
asked for (theory 13, eq. 7 and 8).
"""

from __future__ import annotations

from typing import final

import numpy as np

from modalshell.contact.modal import ModalContacts
from modalshell.contact.row_kernels import rest_frame, row_problem
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
    """The problem about one frame at rest.

    Parameters
    ----------
    pressing : ModalContacts
        The contacts, whose colliders rest.
    about : tuple of ndarray
        Coordinates (m,), forces (r,) [N] and displacements (n, 3) [m] beyond the modes of that frame; and coordinates
        (m,) at which it took derivatives.
    compliance, eigenvalues : ndarray, shape (m,)
        Change of the coordinates [s^2] in a step of implicit Euler per modal force, and stiffness of the modes [1/s^2].

    Attributes
    ----------
    about, compliance : tuple of ndarray, and ndarray
        As given: another frame, or step, has another problem.
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
        across = np.ascontiguousarray(np.einsum("ki,kim->km", normals, moves))
        # What the frame left of the gaps that it closed counts as none: the problem's answer there is the frame's.
        left = np.where(forces > 0.0, 0.0, np.maximum(gap, 0.0))
        problem[3][:] = left - forces @ columns + across @ (forces @ problem[2])
        reach, longest = pressing.reach_within(local), np.abs(shapes.store[slots]).max(axis=(1, 2), initial=0.0)
        ways = np.array(reach), np.array(longest, np.float64)
        self._kept = columns, beyond, problem[2], problem[3], across, rows, forces
        self._step = at, compliance, eigenvalues, *ways
        self._limits = _STAYS * size, _ACCURACY * size
        self._serves = bool(np.isfinite(across).all() and np.isfinite(columns).all())

    def frame(self, before: tuple[Array, Array, Array], force: Array, dt: float, out: tuple[Array, Array, Array]) -> bool:
        """Whether the end of a step under a modal ``force`` (m,) is one of this problem; it is written to ``out``.

        ``before`` are coordinates (m,), rates (m,) and forces (r,) [N] at the step's beginning; ``out`` coordinates and
        rates without contacts, then with these (4, m), forces (r,), and the energy (1,) [J] beyond the modes.
        """
        return self._serves and bool(rest_frame(self._kept, self._step, before, force, dt, self._limits, out))
