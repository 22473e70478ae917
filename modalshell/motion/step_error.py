"""What the steps of a motion cost in accuracy: the error that they add up to, and the damping that they add."""

from __future__ import annotations

from typing import final

import numpy as np

from modalshell.integrators.state import Damping, MotionState
from modalshell.models.base.modal import as_modal
from modalshell.models.base.model import Stepper

_COHERENT = 0.5 * np.pi
"""Error of an oscillation over the sum of what its steps add: their errors have one sign along its orbit, of which the
coordinates show the mean of a cosine."""
_PLAIN = 1e-2, 0.2
"""Damping ratio that steps add, and its share of the one asked for, from which a motion says so."""
_FEW, _MUCH = 4.0, 0.02
"""Steps a period below which frames do not show a mode, and its share of the motion from which it counts."""
_LEAST = 1e-300
_AIM = 0.05
"""Share of the damping asked for, or of its least that counts, that a better step may add."""


@final
class StepErrors:
    """Adds up what the steps of a motion cost.

    In an oscillation the error of a step is one of amplitude and phase, so that the errors of all steps add up, and
    decay as the motion does: ``e+ = e exp(-gamma h) + (pi / 2) |step's own error|``, gamma being the damping of the
    frequency of the motion, ``omega^2 = sum |dv|^2 / sum |dx|^2`` over all steps in the norm of the mass. It is at most
    as large as the motion.

    Attributes
    ----------
    numbers : ndarray, shape (7,)
        The error now and the largest so far [m], the sums of the squares of the rates' and the coordinates' changes,
        whether all errors are known, the halvings of the present step, and the size of the motion [m].
    peaks : ndarray, shape (m,)
        Largest rate of each mode of a modal model.
    """

    def __init__(self, stepper: Stepper, start: MotionState) -> None:
        self._stepper = stepper
        self._damping: Damping = stepper.setup.damping
        self._start = start.coordinates
        self.numbers = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0])
        modal = as_modal(stepper.model)
        self.peaks = np.zeros(0 if modal is None else modal.basis.count)

    def of_step(self, before: MotionState, after: MotionState, dt: float) -> float:
        """Largest error [m] of a vertex by one step; 0 where it is not known."""
        error = self._stepper.local_error(before, after, dt)
        self.numbers[4] *= error is not None
        return 0.0 if error is None else error

    def add(self, before: MotionState, after: MotionState, dt: float, error: float) -> None:
        """Count a step of ``dt`` [s] with its own ``error`` [m]."""
        numbers = self.numbers
        if self.peaks.size:
            np.maximum(self.peaks, np.abs(after.rates), out=self.peaks)
        if before.rates.shape == after.rates.shape:
            numbers[2] += self._stepper.model.squared(after.rates - before.rates)
            numbers[3] += self._stepper.model.squared(after.coordinates - before.coordinates)
        if after.coordinates.shape == self._start.shape:
            numbers[6] = max(numbers[6], self._stepper.model.largest_move(after.coordinates - self._start))
        numbers[0] = min(numbers[0] * np.exp(-self.decay * dt) + _COHERENT * error, numbers[6])
        numbers[1] = max(numbers[1], numbers[0])

    @property
    def largest(self) -> float | None:
        """Largest error so far, as a share of the shell's size; None where the rule does not know its own."""
        known = self.numbers[4] and np.isfinite(self.numbers[1])
        return float(self.numbers[1]) / self._stepper.shell.size if known else None

    @property
    def halvings(self) -> int:
        """Halvings of the present step."""
        return int(self.numbers[5])

    @halvings.setter
    def halvings(self, count: int) -> None:
        self.numbers[5] = float(count)

    def damping_error(self) -> float | None:
        """Error of the damping ratio at the motion's frequency, over the one asked for; None where not known."""
        obtained, asked = self.obtained(self._stepper.setup.dt), self.asked
        return None if np.isnan(obtained) or asked == 0.0 else obtained / asked - 1.0

    @property
    def decay(self) -> float:
        """Rate [1/s] at which oscillations of the motion's frequency die away."""
        return self.asked * self.frequency

    @property
    def frequency(self) -> float:
        """Angular frequency [rad/s] of the motion; 0 where nothing moves."""
        gained, moved = self.numbers[2:4]
        return float(np.sqrt(gained / moved)) if moved > 0.0 else 0.0

    @property
    def asked(self) -> float:
        """Damping ratio asked for at the motion's frequency."""
        return 0.5 * self._damping_rate() / self.frequency if self.frequency else 0.0

    def allowed(self, tolerance: float, dt: float, span: float) -> float:
        """Error [m] that a step of ``dt`` [s] may make, so that those of a ``span`` [s] add up to ``tolerance`` [m]."""
        return tolerance * dt / (_COHERENT * min(span, 1.0 / max(self.decay, 1.0 / span)))

    def obtained(self, dt: float) -> float:
        """Damping ratio that steps of ``dt`` [s] give motion of its frequency; not a number where it is not known."""
        omega = self.frequency
        growth = self._stepper.model.growth(omega**2, self._damping_rate(), dt) if omega else complex(np.nan)
        size = np.log(max(abs(growth), np.finfo(float).tiny))
        return float(-size / np.hypot(size, np.angle(growth))) if growth == growth and size else float("nan")

    def remark(self) -> str:
        """What the damping that steps add does to the motion, and the step that would not; "" if it is little."""
        dt, asked = self._stepper.setup.dt, self.asked
        added = self.obtained(dt) - asked
        if not added > max(_PLAIN[0], _PLAIN[1] * asked) or asked >= 1.0:
            return ""
        fitting = dt
        while self.obtained(fitting) - asked > _AIM * max(asked, _PLAIN[0]) and fitting > 1e-6 * dt:
            fitting *= 0.5
        return (
            f"steps add a damping ratio of {added:.2g} to motion at {self.frequency / (2.0 * np.pi):.3g} Hz "
            f"(asked {asked:.2g}): take dt <= {fitting:.2g} s or an integrator of second order"
        )

    def undersampled(self) -> str:
        """Names modes that move much with few steps a period; "" if there are none."""
        modal, dt = as_modal(self._stepper.model), self._stepper.setup.dt
        if modal is None:
            return ""
        frequencies = np.sqrt(np.maximum(modal.basis.eigenvalues, _LEAST))
        amplitudes = np.where(modal.basis.eigenvalues > _LEAST, self.peaks / frequencies, 0.0)
        fast = (dt * frequencies > 2.0 * np.pi / _FEW) & (amplitudes > _MUCH * np.linalg.norm(amplitudes))
        if not fast.any():
            return ""
        first = int(np.flatnonzero(fast)[0])
        others = f" and {int(fast.sum()) - 1} more have" if fast.sum() > 1 else " has"
        return (
            f"mode {first + 1}{others} at most {2.0 * np.pi / (dt * frequencies[first]):.2g} steps a period: it moves "
            "faster than frames can show"
        )

    def _damping_rate(self) -> float:
        damping = self._damping
        rate = damping.mass_factor + damping.stiffness_factor * self.frequency**2
        if damping.ratios:
            rate += 2.0 * float(np.mean(damping.ratios)) * self.frequency
        return rate
