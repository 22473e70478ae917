"""How far a level's motion goes off that of DS by errors that add up, as those of phase do.

A frame that is right by its bar moves on by a stiffness that is slightly wrong: where a check's steps lead from x to
``x_2`` the level moves as if its modes were pushed by ``Lambda s`` less, with ``s = Phi^T M (x_2 - x)``. So errors e of
its coordinates grow as

    e'' + C e' + Lambda (e - s) = 0

about rest. Accelerations that a check takes of three frames at intervals h lack a share of vibrations of each mode,
``1 - sinc^2(omega h / 2)``, which is no error of the level: what that makes of s is taken out. Between checks s is that
of the last one, times a power of the share c of its coordinates that the motion has, those of a level of modes being
its own: c^3 where a level errs by its geometry, as levels of modes do, c where it errs at rest, as those of a coarse
shell do. Of DS s is zero, and what has added up goes on.
"""

from __future__ import annotations

import math
from typing import final

import numpy as np

from modalshell.core.typing import Array
from modalshell.integrators.modal.flow import flow
from modalshell.models.auto import drift_kernel as kernel
from modalshell.modes import Basis
from modalshell.shell.damping import Damping

_FARTHEST = 1.25
"""Share of the coordinates of a check up to which its errors are taken to grow: further on they are as they were."""
_TINY, _SLOW = 1e-300, 1e-3
"""Least eigenvalue [1/s^2] that is divided by, and angle of a mode between two frames."""
_FAR = 0.5
"""Distance from rest, over that of the check that is known, from which another one takes its place."""
_STEPS, _LENGTH, _WAY, _MOST_STEPS = 7, 8, 9, 24
"""Rows of the number and the length of steps since a check, the first one of coordinates, and how many these are."""
_SEEN = 2.0
"""Angle ``omega h`` of a mode between two frames up to which three of them tell its acceleration."""


@final
class Drift:
    """Errors that add up in one motion: rows (r, m) of e, e', the present s, and a check's s and coordinates.

    Behind them are e and e' at that check, two rows that begin with the number of steps since then and their length
    [s], and the coordinates at the end of each.

    Attributes
    ----------
    none : ndarray, shape (r, m)
        The rows before any check of a motion, which no step changes: a motion holds this very array, not a copy. Steps
        are not counted there, as the first check of a motion does not take errors again.
    """

    def __init__(self, basis: Basis, damping: Damping) -> None:
        self._stiffness, self._damp = np.maximum(basis.eigenvalues, _TINY), damping.of_modes(basis.eigenvalues)
        self._projection = basis.modes.T * np.repeat(basis.shell.mass, 3)
        self._rest, self._modes = basis.shell.rest_positions, basis.modes
        self._flow: tuple[float, Array, Array] | None = None
        self.none = np.zeros((_WAY + _MOST_STEPS, self._stiffness.size))
        self.none[_STEPS, 0] = math.inf

    @staticmethod
    def forgotten(rows: Array) -> Array:
        """The same without a check: what has added up beyond the present s, which the next level may lack."""
        after = np.zeros_like(rows)
        after[:2] = after[5:7] = rows[0] - rows[2], rows[1]
        return after

    def coordinates(self, x: Array) -> Array:
        """Coordinates (m,) [kg^(1/2) m] of positions x (n, 3) [m]."""
        return np.asarray(self._projection @ (x - self._rest).ravel())

    def checked(
        self,
        rows: Array,
        seen: tuple[tuple[Array, Array, Array], Array],
        at: tuple[Array, Array],
        dt: float,
        power: int,
        *,
        first: bool,
    ) -> Array:
        """The same after a check of the middle one of three frames (n, 3) [m], and where that leads (n, 3): ``seen``.

        ``at`` are the coordinates (m,) of the last two frames. Errors since the last check, or since the level began,
        are taken again by what this one finds, from those that there were then. Where that is too long ago, and of
        the first check of a motion, whose frames may be those of a load that comes at once, what it finds otherwise
        than was taken has not come at once: errors stay as far from s as they were; but as they were where it is the
        ``first`` one after a switch. A check much nearer to rest than the last, which tells less of how s grows, does
        not take its place.
        """
        ((before, x, after), corrected), (middle, end) = seen, at
        with np.errstate(over="ignore", invalid="ignore"):
            bent = self._projection @ (before - 2.0 * x + after).ravel()
            missing = self._projection @ (corrected - x).ravel() - self._at(dt)[1] * bent
        missing[self._stiffness * dt**2 > _SEEN**2] = 0.0
        if not np.isfinite(missing).all():
            missing = np.zeros_like(missing)
        if not first and _tells_less(middle, rows[4]):  # as in the middle of a swing
            missing, middle = rows[3], rows[4]
        present = kernel.share_of(middle, end, _FARTHEST) ** power * missing
        after = np.zeros_like(rows)
        after[2:5] = present, missing, middle
        if (first or rows[4].any()) and 0 < rows[_STEPS, 0] <= _MOST_STEPS:
            after[:2] = self._again(rows, after[2:5], dt, power)
        else:
            after[:2] = rows[0] if first else rows[0] + present - rows[2], rows[1]
        after[5:7] = after[:2]
        return after

    def _again(self, rows: Array, law: Array, dt: float, power: int) -> Array:
        """Errors and their rates (2, m) after the steps since the last check, with s by a ``law`` (3, m)."""
        steps, coefficients = int(rows[_STEPS, 0]), self._at(dt)[0]
        errors, after = np.concatenate([rows[5:7], law]), np.empty((5, rows.shape[1]))
        for q in rows[_WAY : _WAY + steps]:
            kernel.advance(errors, q, coefficients, self._stiffness, power == 3, _FARTHEST, after)
            errors = after.copy()
        return errors[:2]

    def beyond(self, displacement: Array) -> Array:
        """The part (n, 3) [m] of displacements (n, 3) [m] that no mode has."""
        in_modes = self._modes @ (self._projection @ displacement.ravel())
        return displacement - in_modes.reshape(-1, 3)

    def advanced(self, rows: Array, q: Array, dt: float, power: int) -> tuple[Array, float]:
        """The same after a step of ``dt`` [s] to coordinates q (m,), by a level that errs with a power of c; and size.

        Where no check has found anything, as of DS, q may be any.
        """
        after, coefficients = rows.copy(), self._at(dt)[0]
        steps = after[_STEPS, 0].item()
        known = steps < _MOST_STEPS and after[_LENGTH, 0].item() in (0.0, dt)
        if known:
            after[_WAY + int(steps)] = q
        after[_STEPS, 0], after[_LENGTH, 0] = steps + 1.0 if known else math.inf, dt
        return after, float(kernel.advance(rows, q, coefficients, self._stiffness, power == 3, _FARTHEST, after))

    def _at(self, dt: float) -> tuple[Array, Array]:
        """Coefficients e11 to e22 (4, m) of :func:`.flow.flow`, and what frames lack of accelerations (m,)."""
        known = self._flow
        if known is None or known[0] != dt:
            angle = np.minimum(np.sqrt(self._stiffness) * dt, _SEEN)
            slow = np.maximum(angle, _SLOW)  # of slower ones the difference cancels, and the limit serves
            lacking = (1.0 / np.sinc(slow / (2.0 * np.pi)) ** 2 - 1.0) / slow**2
            known = self._flow = dt, np.stack(flow(self._stiffness, self._damp, dt)[:4]), lacking
        return known[1:]

    def size(self, rows: Array) -> float:
        """How far the motion is off [kg^(1/2) m] beyond the present s, at the largest of the vibration that this is."""
        gap, rate = rows[0] - rows[2], rows[1]
        return math.sqrt(gap @ gap + rate @ (rate / self._stiffness))


def _tells_less(q: Array, known: Array) -> bool:
    """Whether a check at coordinates q (m,) tells less of how errors grow than that at the ``known`` ones (m,)."""
    return bool(q @ q < _FAR**2 * (known @ known))
