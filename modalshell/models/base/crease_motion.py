"""Motion of full models with creases that yield."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, final

import numpy as np

from modalshell.core.typing import Array
from modalshell.integrators.full import ImplicitRule
from modalshell.integrators.full.base import inner_force
from modalshell.integrators.full.implicit_rule import EulerStart, ShellSteps, StageOf, steps_of
from modalshell.integrators.state import CREASES, HEAT, MotionState
from modalshell.shell.creases import CreaseSet
from modalshell.shell.damping import Damping
from modalshell.statics.creases import MET, yielded
from modalshell.statics.newton import NewtonResult
from modalshell.statics.potential import Potential, solve


@final
class CreaseMotion:
    """Takes the steps of a full model whose shell has creases.

    While none yields, the model's rule steps, its rest angles as they are. Where one would be beyond its limit at the
    end of a step, implicit Euler stands in for the rule: each of its steps ends at a minimum by positions and plastic
    folds together, so that a rule of order two is of order one there, and no step makes heat negative. After explicit
    steps, and those with contacts, creases yield at the positions where the step has ended.
    """

    def __init__(self, creases: CreaseSet, damping: Damping) -> None:
        self._creases, self._damping = creases, damping

    def begin(self, state: MotionState, angles: Array, heat: float) -> MotionState:
        """A start that knows what its creases have kept."""
        return self._kept(state, angles.copy(), heat)

    def _kept(self, state: MotionState, angles: Array, heat: float) -> MotionState:
        memory = state.memory | {CREASES: angles, HEAT: np.array([heat])}
        return MotionState(state.coordinates, state.rates, memory)

    def _drive_and_residual(self, shell: Any, x: Array, angles: Array) -> tuple[Array, Array]:
        """Driving moments of the creases at x (n, 3), and residuals of their yield conditions."""
        drive = self._creases.drive(shell.elastic_energy.fold_couples(x, self._creases.hinges), angles)
        return drive, self._creases.yield_residual(drive, np.zeros_like(angles))

    def after(self, model: Any, before: MotionState, after: MotionState) -> MotionState:
        """The end of a step whose positions stay, with creases that yield there."""
        angles, heat = before.memory[CREASES], float(before.memory[HEAT][0])
        creases, x = self._creases, after.coordinates
        drive, beyond = self._drive_and_residual(model.as_creased(before).shell, x, angles)
        if not beyond.any():
            return self._kept(after, angles, heat)
        fixed = model.shell.elastic_energy.fold_stiffness(creases.hinges)
        every = np.ones(angles.size, dtype=bool)
        new = angles + creases.flow(fixed, drive, np.zeros_like(angles), every).change
        kept = self._kept(after, new, heat + creases.heat(angles, new))
        if "force" in kept.memory:  # that of the rest angles before
            kept.memory["force"] = inner_force(model.as_creased(kept).shell, x, after.rates, self._damping)
        return kept

    def advance(self, model: Any, at: StageOf, state: MotionState, dt: float) -> tuple[MotionState, bool]:
        """The state a step of ``dt`` [s] after ``state`` by an implicit rule; and whether it was solved."""
        creases, damping, rule = self._creases, self._damping, model.integrator
        assert isinstance(rule, ImplicitRule)
        angles, heat = state.memory[CREASES], float(state.memory[HEAT][0])
        own = model.as_creased(state)
        steps = steps_of(ShellSteps(own, lambda start: _placed(at(start), angles), damping), model.free_parts, damping)
        after, solved = rule.march(steps, state, dt)
        beyond = self._drive_and_residual(own.shell, after.coordinates, angles)[1]
        if solved and float(beyond.max()) <= MET * float(creases.limits.max()):
            return self._kept(after, angles, heat), True
        now = [angles]

        def felt(start: EulerStart) -> tuple[Any, Array, Array | None]:
            return _placed(at(start), now[-1])

        def minimum(
            problem: Potential, first: Array, scale: float, goal: float, stresses: list[Array], _: float
        ) -> tuple[Array, bool]:
            def solver(own: Potential, point: Array, predicted: list[Array] | None) -> NewtonResult:
                return solve(own, point, scale, goal, predicted)

            found = yielded(problem, first, now[-1], solver, stresses, max(MET, 1e-2 * goal))
            now.append(found.angles)
            return found.result.point, found.settled

        yielding = steps_of(ShellSteps(own, felt, damping, minimum), model.free_parts, damping)
        after, solved = rule.standing_in(yielding, state, dt)
        after = rule.stood_in_for(state, yielding.landed(state, after, dt), dt)
        heat += sum(creases.heat(a, b) for a, b in pairwise(now))
        return self._kept(after, now[-1], heat), solved


def _placed(given: tuple[Any, Array, Array | None], angles: Array) -> tuple[Any, Array, Array | None]:
    """What a shell feels, its creases with these plastic folds (C,) [rad]."""
    body, load, held = given
    return body.with_creases(angles), load, held
