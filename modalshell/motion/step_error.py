"""What the steps of a motion cost in accuracy: the error that they add up to, and the damping that they add.

See theory 12, eq. 13 and 14.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from modalshell.core.checks import checked_number
from modalshell.core.typing import Array
from modalshell.core.units import at_most
from modalshell.integrators.full.base import oscillation
from modalshell.integrators.full.second_order import SecondOrderRule
from modalshell.integrators.state import COST, MotionState
from modalshell.models.base.modal import as_modal
from modalshell.models.base.stepper import Stepper
from modalshell.modes.rigid import left_free
from modalshell.shell.damping import Damping

_SEEN, _EARLY, _LATER = 8, 64, 19
"""Steps from one look at the motion's size to the next, of this many early ones, and of later ones, of which no period
is likely to be a multiple."""
SEEN_FROM = "seen_from"
"""Name in a checkpoint of the coordinates from which the motion's size is measured, where another model goes on."""
_COHERENT = 0.5 * np.pi
"""Error of an oscillation over the sum of what its steps add: their errors have one sign along its orbit, of which the
coordinates show the mean of a cosine."""
_PLAIN = 1e-2, 0.2
"""Damping ratio that steps add, and its share of the one asked for, from which a motion says so."""
_FEW, _MUCH = 4.0, 0.02
"""Steps a period below which frames do not show a mode, and its share of the motion from which it counts."""
_RESOLVED = 6.0
"""Steps a period from which the exponential rule follows a mode under forces that turn."""
_BEYOND = 3.0
"""Error over the tolerance from which a motion says so: errors of a motion are known to such a factor."""
_MANY = 64
"""Parts of a step on average from which a motion says so."""
_BLIND = (
    "by this rule the errors that constraints cause are not known, and the tolerance does not bound them: compare with "
    "steps half as long"
)
_LEAST = 1e-300
_STRUCK = 0.125
"""Part of what is left of a tolerance that a step may take in which something strikes."""
_OFTEN = 0.1
"""Share of steps that implicit Euler stood in for, from which what is said of the damping of steps names it."""
_AIM = 0.05
"""Share of the damping asked for, or of its least that counts, that a better step may add."""


@final
@dataclass(frozen=True)
class Tolerance:
    """Error that the steps of a motion may make."""

    share: float
    """Of the shell's size."""
    span: float
    """Time [s] over which errors add up to that."""

    def __post_init__(self) -> None:
        checked_number("tolerance", self.share, at_least=1e-9, at_most=1.0)


@final
class StepErrors:
    """Adds up what the steps of a motion cost.

    In an oscillation the error of a step is one of amplitude and phase, so that the errors of all steps add up, and
    decay as the motion does: ``e+ = e exp(-gamma h) + (pi / 2) |step's own error|``, gamma being the damping of the
    frequency of the motion, ``omega^2 = sum |dv|^2 / sum |dx|^2`` over all steps in the norm of the mass. It is at most
    as large as the motion.

    Attributes
    ----------
    error, largest : float
        The error now and the largest so far [m].
    halvings : int
        Halvings of the present step.
    peaks : ndarray, shape (m,)
        Largest rate of each mode of a modal model, seen at some of the steps.
    """

    def __init__(self, stepper: Stepper, start: MotionState) -> None:
        self._stepper = stepper
        self._damping: Damping = stepper.setup.damping
        self._first, self._start = start, start.coordinates
        self.error, self._largest, self.halvings = 0.0, 0.0, 0
        self._gained, self._moved, self._steps = 0.0, 0.0, 0
        self._time, self._stood, self._stood_time = 0.0, 0, 0.0  # [s], and of steps that implicit Euler stood in for
        self._size, self._shape = 0.0, 0.0
        self._obtained: tuple[MotionState, int, float] | None = None
        modal = as_modal(stepper.model)
        self.peaks = np.zeros(0 if modal is None else modal.basis.count)
        # The exponential rule knows its error without the forces that lead its ends onto constraints.
        self._known = modal is None or not (stepper.setup.constraints and COST in start.memory)

    def arrays(self) -> dict[str, Array]:
        """Everything that :meth:`restore` needs."""
        numbers = [self.error, self._largest, self.halvings, self._gained, self._moved, self._steps, self._known]
        numbers += [self._size, self._shape, self._time, self._stood, self._stood_time]
        errors = np.array(numbers, dtype=np.float64)
        # Nothing where it is the motion's start, which is known.
        seen_from = np.empty(0) if self._start is self._first.coordinates else self._start.copy()
        return {"errors": errors, "peaks": self.peaks.copy(), SEEN_FROM: seen_from}

    def restore(self, arrays: dict[str, Array]) -> None:
        """Go on from :meth:`arrays`."""
        numbers = [float(number) for number in arrays["errors"]]
        self.error, self._largest, halvings, self._gained, self._moved, steps, known = numbers[:7]
        self._size, self._shape, self._time, stood, self._stood_time = numbers[7:]
        self.halvings, self._steps, self._known, self._stood = int(halvings), int(steps), bool(known), int(stood)
        self.peaks = np.array(arrays["peaks"])
        seen_from = np.array(arrays[SEEN_FROM])
        self._start = seen_from if seen_from.size else self._first.coordinates

    def are_known(self, dt: float) -> bool:
        """Whether the model's rule knows the error of a step of ``dt`` [s] at the start."""
        start = self._first
        return COST in start.memory or self._stepper.model.local_error(start, start, dt) is not None

    def of_step(self, before: MotionState, after: MotionState, dt: float) -> tuple[float, float, float]:
        """Squares of one step's error and of its changes of rates and coordinates, in the norm of the mass."""
        if (cost := after.memory.get(COST)) is not None:
            error, gained, moved = cost.tolist()
            return error, gained, moved
        model = self._stepper.model
        change = model.local_error(before, after, dt)
        self._known &= change is not None
        if before.rates.shape != after.rates.shape or change is None:
            return 0.0, 0.0, 0.0
        gained, moved = after.rates - before.rates, after.coordinates - before.coordinates
        return model.squared(change), model.squared(gained), model.squared(moved)

    def length(self, squared: float) -> float:
        """Displacement [m] of the vertex that moves most, in a change of given square, as in the motion so far."""
        return self._shape * math.sqrt(squared)

    @property
    def looks(self) -> bool:
        """Whether this is one of the steps at which the size of the motion is looked at."""
        if self._shape == 0.0 or self.error == 2.0 * self._size:  # an error that is held to the size waits for it
            return True
        return self._steps % (_SEEN if self._steps < _EARLY else _LATER) == 0

    def see(self, after: MotionState) -> None:
        """Look at the size of the motion."""
        if self.looks:
            if self.peaks.size:
                np.maximum(self.peaks, np.abs(after.rates), out=self.peaks)
            if after.coordinates.shape != self._start.shape:  # another model goes on: sizes are those since it began
                self._start = after.coordinates
                return
            model, moved = self._stepper.model, after.coordinates - self._start
            length, squared = model.largest_move(moved), model.squared(moved)
            self._size = max(self._size, length)
            self._shape = length / math.sqrt(squared) if squared > 0.0 else self._shape

    def add(self, dt: float, cost: tuple[float, float, float], after: MotionState) -> None:
        """Count a step of ``dt`` [s] to a state."""
        error, gained, moved = cost
        if not _strikes(after):  # whose jump of speeds is of no frequency
            self._gained += gained
            self._moved += moved
        self._steps += 1
        self._time += dt
        if "order" in after.memory and after.memory["order"][0] < 2.0:
            self._stood += 1
            self._stood_time += dt
        error = self.error * math.exp(-self.decay * dt) + _COHERENT * self.length(error)
        if error > 2.0 * self._size > 0.0:
            error = 2.0 * self._size
        self.error = error
        if error > self._largest:
            self._largest = error

    @property
    def largest(self) -> float | None:
        """Largest error so far, as a share of the shell's size; None where the rule does not know its own."""
        known = self._known and math.isfinite(self._largest)
        return self._largest / self._stepper.shell.mesh.moment_length if known else None

    def excess_note(self, tolerance: Tolerance) -> str:
        """The message about errors far above a tolerance that the shortest steps do not meet, or may not; else ""."""
        largest, setup = self.largest, self._stepper.setup
        if largest is None:
            return "" if self._known else _BLIND
        if not largest > _BEYOND * tolerance.share:
            most = _BEYOND * largest
            if not (setup.contacts and self._stood and most > tolerance.share and left_free(self._stepper.shell)):
                return ""
            return (
                f"what strikes a collider is free to move on, so that errors of its speed go on: they may come to "
                f"{most:.2g} of the shell's size, beyond the tolerance of {tolerance.share:g}"
            )
        return (
            f"steps are off by up to {largest:.2g} of the shell's size, beyond the tolerance of {tolerance.share:g}: "
            "what comes at once excites motion that no step resolves; let it take some time, or take more damping"
        )

    def many(self, count: int) -> str:
        """What is said of the parts that a tolerance has taken of ``count`` steps; "" where they are not many."""
        parts = self._steps / max(count, 1)
        if parts <= _MANY:
            return ""
        return (
            f"steps were taken in {parts:.0f} parts each on average, as their tolerance follows fast motion that does "
            "not die: let loads take some time to come, take damping by the stiffness, or a larger tolerance"
        )

    def damping_error(self, state: MotionState) -> float | None:
        """Error of the damping ratio at the motion's frequency, over the one asked for; None where not known."""
        obtained, asked = self._obtained_at(state), self.asked
        return None if np.isnan(obtained) or asked == 0.0 else obtained / asked - 1.0

    @property
    def decay(self) -> float:
        """Rate [1/s] at which oscillations of the motion's frequency die away."""
        return 0.5 * self._damping_rate(self.frequency) if self._gained and self._moved else 0.0

    @property
    def frequency(self) -> float:
        """Angular frequency [rad/s] of the motion; 0 where nothing moves."""
        return math.sqrt(self._gained / self._moved) if self._moved > 0.0 else 0.0

    @property
    def asked(self) -> float:
        """Damping ratio asked for at the motion's frequency."""
        omega = self.frequency
        return 0.5 * self._damping_rate(omega) / omega if omega else 0.0

    def allowed(self, tolerance: Tolerance, dt: float, after: MotionState) -> float:
        """Error [m] that a step of ``dt`` [s] to a state may make, so that all of them add up to a tolerance.

        Where errors die away within a step, each of them may make all of it, and not more. Where something strikes,
        speeds jump, and the error falls as the step does, as what it may be: there it may be a part of what is left.
        """
        whole = tolerance.share * self._stepper.shell.mesh.moment_length
        share = min(1.0, dt * max(self.decay, 1.0 / tolerance.span))
        if _strikes(after):
            share = max(share, _STRUCK * (1.0 - self.error / whole))
        return whole * share / _COHERENT

    def obtained(self, state: MotionState, dt: float) -> float:
        """Damping ratio that steps of ``dt`` [s], as to ``state``, give motion of its frequency; NaN if unknown."""
        omega, model = self.frequency, self._stepper.model
        if not omega:
            return float("nan")
        damp, whole = self._damping_rate(omega), self._stepper.setup.dt
        step, share = dt, self._stood_time / self._time
        if self._stepper.setup.divided and self._stood < self._steps:
            step *= (self._time - self._stood_time) / (self._steps - self._stood) / whole
        growth = model.mean_growth(state, omega**2, damp, step)
        size, angle = np.log(max(abs(growth), np.finfo(float).tiny)), np.angle(growth)
        if share:  # in a second, each for its share of it; what strikes does so as often in shorter steps
            parts, share = getattr(model.integrator, "stand_ins", 1), share * dt / whole
            part = self._stood_time / self._stood * dt / whole / parts
            euler = np.log(1.0 / (1.0 - oscillation(omega**2, damp, part))) * share / part
            size, angle = (1.0 - share) * size / step + euler.real, (1.0 - share) * angle / step + euler.imag
        return float(-size / np.hypot(size, angle)) if growth == growth and size else float("nan")

    def _obtained_at(self, state: MotionState) -> float:
        """The damping ratio by the motion's own steps, once for what is stated and what is said of it."""
        kept, steps = self._obtained, self._steps
        if kept is None or kept[0] is not state or kept[1] != steps:
            kept = self._obtained = state, steps, self.obtained(state, self._stepper.setup.dt)
        return kept[2]

    def remark(self, state: MotionState) -> str:
        """What the damping that steps add does to the motion, and the step that would not; "" if it is little."""
        dt, asked = self._stepper.setup.dt, self.asked
        added = self._obtained_at(state) - asked
        if not added > max(_PLAIN[0], _PLAIN[1] * asked) or asked >= 1.0:
            return ""
        fitting = dt
        while self.obtained(state, fitting) - asked > _AIM * max(asked, _PLAIN[0]) and fitting > 1e-6 * dt:
            fitting *= 0.5
        rule = getattr(self._stepper.model, "integrator", None)  # which auto has none of to choose
        other = "" if rule is None or isinstance(rule, SecondOrderRule) else " or an integrator of second order"
        if self._stood > _OFTEN * self._steps:
            often = f"{self._stood} of {self._steps} steps"
            other = f" (implicit Euler stood in for {often}, where contacts changed or motion was violent)"
        wanted = "a smaller tolerance" if self._stepper.setup.divided else f"dt <= {fitting:.2g} s"
        return (
            f"steps add a damping ratio of {added:.2g} to motion at {self.frequency / (2.0 * np.pi):.3g} Hz "
            f"(asked {asked:.2g}): take {wanted}{other}"
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

    def unresolved(self) -> str:
        """What may feed a motion that does not die: forces that turn, on modes that steps do not resolve; else ""."""
        modal, dt = as_modal(self._stepper.model), self._stepper.setup.dt
        if modal is None or modal.integrator.backward or modal.integrator.forced_at < 1.0:
            return ""
        if modal.largest_turn(np.ones(modal.basis.count)) == 0.0:
            return ""
        fastest = math.sqrt(float(modal.basis.eigenvalues.max()))
        resolved = 2.0 * math.pi / (_RESOLVED * fastest)
        if dt <= resolved:
            return ""
        return (
            f"forces that turn can feed modes of fewer than {_RESOLVED:g} steps a period: take dt <= "
            f"{at_most(resolved)} s, fewer modes, or integrator 'implicit_euler'"
        )

    def _damping_rate(self, omega: float) -> float:
        damping = self._damping
        rate = damping.mass_factor + damping.stiffness_factor * omega**2
        if damping.ratios:
            rate += 2.0 * float(np.mean(damping.ratios)) * omega
        return rate


def _strikes(after: MotionState) -> bool:
    """Whether something struck or parted in the step to a state, so that its rule has to begin again."""
    return "order" in after.memory and after.memory["order"][0] == 0.0
