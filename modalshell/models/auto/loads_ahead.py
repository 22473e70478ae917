"""What the loads of a motion will do to a level of modes: factors, linear answers, and the largest load to come."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple, final

import numpy as np

from modalshell.core.typing import Array
from modalshell.integrators.state import MotionState
from modalshell.models.auto.answered import Answer, SumAnswers, along
from modalshell.models.auto.checks import Check
from modalshell.models.base.setup import MotionSetup
from modalshell.models.base.stepper import LEAD
from modalshell.models.motion_check import acting_load
from modalshell.supports import SupportPath

_MOST_TOGETHER = 2
"""Loads that change whose largest factors are taken together."""
_LOOKS = 200
"""Times at which a path is looked at for the sizes of its accelerations and turns."""
_LITTLE = 1e-9
"""Share of such a size that is rounding."""


@final
class LedSupports:
    """Numbers, ``count`` of them, that say what a path of supports does to a shell at rest in their frame.

    Those are the acceleration of the supports, and of a path that turns the angular velocity and acceleration, and how
    far the world has turned, in which loads act: each over its largest length on the path.
    """

    def __init__(self, path: SupportPath) -> None:
        self._path = path
        looked = [self._parts(time) for time in path.samples(_LOOKS).tolist()]
        sizes = np.max([[np.linalg.norm(part) for part in parts] for parts in looked], axis=0)
        self._sizes = np.where(sizes > 0.0, sizes, 1.0).tolist()
        self.count = sum(part.size for part in looked[0])

    def _parts(self, time: float) -> tuple[Array, ...]:
        pose = self._path.at(time)
        if not self._path.turns:
            return (pose.acceleration,)
        return pose.acceleration, pose.turn_rate, pose.turn_acceleration, (pose.rotation - np.eye(3)).ravel()

    def values(self, time: float) -> list[float]:
        """The numbers at ``time`` [s]."""
        numbers = np.concatenate([part / size for part, size in zip(self._parts(time), self._sizes, strict=True)])
        numbers[np.abs(numbers) < _LITTLE] = 0.0
        return numbers.tolist()


class Coming(NamedTuple):
    """A load that is known to come."""

    force: Array
    """The load [N]; shape (n, 3)."""
    whole: float
    """Length of the linear answer to it in the norm of the mass [kg^(1/2) m]."""
    factors: Array
    """Factors of the loads that change; shape (k,)."""


@final
class LoadsAhead:
    """The loads of one motion of the model that switches itself.

    ``change`` says whether any load changes, ``dear`` whether one does by more than a factor; ``count`` is
    how many numbers tell how loads have changed.
    """

    def __init__(self, model: Any, setup: MotionSetup, check: Check) -> None:
        self._model, self._loading, self._dt, self._check = model, setup.loading, setup.dt, check
        live = setup.loading.live
        self._supports = setup.supports
        self._led = None if setup.supports is None else LedSupports(setup.supports)
        self.change = bool(live or self._led)
        self.count = len(live) + (0 if self._led is None else self._led.count)
        self._at: tuple[float, list[float]] = (-math.inf, [])
        forces = [load.constant for load in live if load.constant is not None]
        self._parts = forces if len(forces) == len(live) and not (check.least or self._led) else None
        self.dear = self.change and self._parts is None
        self._sums: tuple[Array, Array, SumAnswers] | None = None
        self._coming: tuple[Array, list[Coming]] | None = None

    def values(self, time: float) -> list[float]:
        """Factors of the loads that change, and numbers of supports that move: a list is quicker than an array."""
        if self._at[0] != time:
            led = [] if self._led is None else self._led.values(time)
            self._at = time, [load.factor_at(time) for load in self._loading.live] + led
        return self._at[1]

    def factors(self, time: float) -> Array:
        """The same in an array (k,)."""
        return np.array(self.values(time))

    def exceeds(self, time: float, most: float) -> bool:
        """Whether the load that alone changes is beyond a factor at ``time`` [s]."""
        return most < math.inf and not abs(self.values(time)[0]) <= most

    def answer(self, state: MotionState, memory: dict[str, Array], time: float, dead: Array) -> Answer | None:
        """The linear answer to the load at ``time`` [s]; None of none, or one that is not finite, as motion says."""
        if self._parts is not None:
            forces, answers = self._summed(dead, self._parts)
            factors = np.array([1.0, *self.values(time)])
            if not 0.0 < self.most(dead) == memory["ahead"][0]:  # else both ends, and so all between, have been seen
                along(np.tensordot(factors, forces, 1), memory)
            return answers.of(factors)
        force = self.force(state, time, dead)
        if not (np.isfinite(force).all() and force.any()):
            return None
        found: Answer = self._model.answers.following(force, memory)
        return found

    def _summed(self, dead: Array, parts: Sequence[Array]) -> tuple[Array, SumAnswers]:
        """The dead load and the loads that change (1 + k, n, 3) [N], and the linear answers to their sums."""
        kept = self._sums
        if kept is None or kept[0] is not dead:
            forces = [dead, *parts]
            kept = self._sums = dead, np.stack(forces), self._model.answers.of_sums(forces)
        return kept[1:]

    def force(self, state: MotionState, time: float, dead: Array) -> Array:
        """Load (n, 3) [N] in the frames that bends the shell in a state."""
        loading, x, lead = self._loading, state.coordinates, LEAD * self._dt
        if not (self.change or self._check.least):
            return dead
        v = state.rates if loading.by_velocity or self._check.least else np.zeros_like(x)
        with np.errstate(over="ignore", invalid="ignore"):
            if self._led is not None:
                return self.at(x, state.rates, time, dead)
            force = loading.moving_force(dead, x, x - lead * v, 1.0 / lead, time)
            return self._check.standing(force, x, v) if np.isfinite(force).all() else force

    def at(self, x: Array, v: Array, time: float, dead: Array) -> Array:
        """Load (n, 3) [N] at positions x (n, 3) [m] with velocities v (n, 3) [m/s], that of supports that move too."""
        return acting_load(x, v, time, dead, self._loading, self._model.shell.mass, self._supports)

    def coming(self, dead: Array) -> list[Coming]:
        """The largest loads that are known to come, one each way, of one or two loads that change by factors alone.

        Of two each of one comes with each of the other. Loads that follow the shell are others when they come.
        """
        if self._coming is None or self._coming[0] is not dead:
            self._coming = dead, self._ends(dead)
        return self._coming[1]

    def most(self, dead: Array) -> float:
        """Length of the longest linear answer to them; 0 of none."""
        return max((one.whole for one in self.coming(dead)), default=0.0)

    def farthest(self, dead: Array, ahead: float) -> float | None:
        """Factor of a load that changes, without any other, up to which a look ahead has seen it; None of others.

        ``ahead`` is the length of the linear answer that was looked at.
        """
        if not 0.0 < self.most(dead) == ahead or dead.any() or len(self._loading.live) > 1:
            return None
        return max(abs(float(one.factors[0])) for one in self.coming(dead))

    def _ends(self, dead: Array) -> list[Coming]:
        live, parts = self._loading.live, self._parts
        if parts is None or not 1 <= len(live) <= _MOST_TOGETHER:
            return []
        ends = []
        for load in live:
            factors = [load.factor_at(time) for time in load.times]
            ends.append(sorted({min(factors), max(factors)}))
        (forces, answers), coming = self._summed(dead, parts), []
        for corner in itertools.product(*ends):
            if any(corner):
                largest = np.array(corner)
                force, answer = dead + np.tensordot(largest, forces[1:], 1), answers.of(np.array([1.0, *corner]))
                answer = answer or self._model.answers.of(force)  # none, or beyond all numbers: as that says
                coming.append(Coming(force, answer.whole, largest))
        return coming
