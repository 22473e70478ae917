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
_SEEN = 2.0
"""Angle ``omega h`` of a mode between two frames up to which three of them tell its acceleration."""


@final
class Drift:
    """Errors that add up in one motion: rows (5, m) of e, e', the present s, and a check's s and coordinates.

    Attributes
    ----------
    none : ndarray, shape (5, m)
        The rows where nothing is known yet. A motion holds this very array, not a copy: no step need be taken then.
    """

    def __init__(self, basis: Basis, damping: Damping) -> None:
        self._stiffness, self._damp = np.maximum(basis.eigenvalues, _TINY), damping.of_modes(basis.eigenvalues)
        self._projection = basis.modes.T * np.repeat(basis.shell.mass, 3)
        self._rest = basis.shell.rest_positions
        self._flow: tuple[float, Array, Array] | None = None
        self.none = np.zeros((5, self._stiffness.size))

    def forgotten(self, rows: Array) -> Array:
        """The same without a check: what has added up beyond the present s, which the next level may lack."""
        return rows if rows is self.none else np.vstack([rows[0] - rows[2], rows[1], np.zeros_like(rows[2:])])

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

        ``at`` are the coordinates (m,) of the last two frames. What the check finds otherwise than was taken has not
        come at once: errors stay as far from s as they were. But the first one after a switch finds what the level has
        brought: errors stay as they were. One much nearer to rest than the last, which tells less of how s grows, does
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
        error = rows[0] if first else rows[0] + present - rows[2]
        return np.stack([error, rows[1], present, missing, middle])

    @staticmethod
    def share(rows: Array) -> float:
        """How much of s errors have taken on: 1 where they follow it, as under a load that grows slowly."""
        error, present = rows[0], rows[2]
        size = float(present @ present)
        return max(0.0, min(1.0, float(error @ present) / size)) if size > 0.0 else 0.0

    def advanced(self, rows: Array, q: Array, dt: float, power: int) -> tuple[Array, float]:
        """The same after a step of ``dt`` [s] to coordinates q (m,), by a level that errs with a power of c; and size.

        Where no check has found anything, as of DS, q may be any.
        """
        after, coefficients = np.empty_like(rows), self._at(dt)[0]
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
