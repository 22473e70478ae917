"""Continuation in a fraction, of the load or of a motion of the boundary, and statics by it."""

from __future__ import annotations

from dataclasses import replace
from typing import final

import numpy as np

from modalshell.core.errors import SolverError
from modalshell.core.typing import Array
from modalshell.shell import EXACT
from modalshell.statics.bifurcation import branch_end
from modalshell.statics.mixed_newton import CONTINUED, GOAL
from modalshell.statics.newton import Matrix, NewtonResult, Problem, is_minimum, mixed_newton

_LOAD_STEPS = 200
"""Load steps at most."""
_BEYOND = 1.02
"""Load at which a shell is equilibrated after a snap, over the last one of its branch."""
_LAST_DESCENTS = 2
"""Further descents under a whole dead load, each from where the last one ended: thin folds crumple on the way."""
_SMALLEST_LOAD = 1e-3
_GROWTH = 2.0
"""Factor on the step after a success."""
_SHRINK, _SMALLEST_STEP = 0.25, 1.0 / 256.0
"""Factor after a failure, which costs as much as several successes, and the smallest step."""
_FINE_SHRINK, _FINE_SMALLEST_STEP = 0.5, 1.0 / 1024.0
"""The same where failures are cheap: small steps tell a branch that ends from one that is only steep."""


@final
class Steps:
    """The steps of a continuation: a fraction grows from 0 to 1 by steps that follow the solver's success.

    Parameters
    ----------
    first : float
        The first step.
    fine : bool
        Whether failures are cheap, so that steps shrink slowly and far.

    Attributes
    ----------
    fraction : float
        Where the continuation has come to.
    step : float
        The next step.
    """

    def __init__(self, first: float = 1.0, *, fine: bool = False) -> None:
        self.fraction, self.step = 0.0, first
        self._shrink, self._smallest = (_FINE_SHRINK, _FINE_SMALLEST_STEP) if fine else (_SHRINK, _SMALLEST_STEP)

    @property
    def target(self) -> float:
        """Where the next step leads."""
        return min(1.0, self.fraction + self.step)

    def limit(self, step: float = 1.0) -> float:
        """Make the next step no longer than ``step``, nor than the rest of the way; the step."""
        self.step = min(self.step, step, 1.0 - self.fraction)
        return self.step

    def accept(self, reached: float | None = None) -> None:
        """Go on from the target, or from what was reached instead, with a longer step."""
        self.fraction, self.step = self.target if reached is None else reached, min(1.0, _GROWTH * self.step)

    def refuse(self, of: float = 1.0) -> bool:
        """Shorten the step; False, and the step as it was, where it would become too small, as a share ``of`` this."""
        possible = self._shrink * self.step >= self._smallest * of
        self.step *= self._shrink if possible else 1.0
        return possible


def equilibrium(problem: Problem[Matrix], start: Array | None) -> NewtonResult:
    """Minimum of the potential: near ``start``, held vertices in place, or where that fails from rest."""
    iterations = 0
    if start is not None:
        scale = problem.scale_at(start)
        loaded = problem.measure(problem.push) > 0.0
        result = mixed_newton(problem, start, scale)
        if is_minimum(problem, result):
            return result
        iterations = result.iterations
        if not loaded or not np.array_equal(start, problem.origin):
            result = problem.descend(start, scale)
            result.iterations = iterations = iterations + result.iterations
            if result.converged or not loaded:
                return result
    followed = follow(problem, problem.scale_at(None))
    followed.iterations += iterations
    return followed


def follow(whole: Problem[Matrix], scale: float) -> NewtonResult:
    """Load continuation from rest along tangents, each step as long as ``whole.load_step`` allows.

    Where the branch ends, the potential is minimised under a little more load, and the continuation resumes from there:
    the answer is that of a load that grows slowly, snaps included.
    """
    x, steps, iterations, count, snaps, left, stuck = whole.origin, Steps(), 0, 0, 0, False, False
    path: list[tuple[float, Array]] = []
    jumps: list[tuple[str, float]] = []
    tangent: Array | None = None
    while True:
        count += 1
        factor = steps.fraction
        if not stuck and count <= _LOAD_STEPS:
            try:
                if tangent is None:  # at rest; later the factor that showed a minimum gives it
                    present = whole if whole.is_dead else whole.loaded(factor)
                    tangent = whole.step(whole.factor(present.linearise(x, EXACT)[1]), -whole.push_at(x))
                    iterations += 1
                guess, stresses, part = whole.moved(x, (1.0 - factor) * tangent, steps.step * whole.load_step)
                target = factor + part * (1.0 - factor) if part < 0.999 else 1.0
            except SolverError:
                stuck = True
                continue
            problem, goal = whole.loaded(target), GOAL if target == 1.0 else whole.path_goal
            result = mixed_newton(problem, guess, scale, limit=CONTINUED, goal=goal, stresses=stresses)
            iterations += result.iterations
            if not is_minimum(problem, result, exactly=target == 1.0):
                stuck = not steps.refuse()
                continue
        else:
            snaps += 1
            if whole.is_dead and whole.snaps and (end := branch_end(whole, x, factor)) is not None:
                jumps.append((end.kind, end.factor))
            stop = snaps > whole.snaps or count > _LOAD_STEPS
            target = 1.0 if stop else min(1.0, max(_BEYOND * factor, _SMALLEST_LOAD))
            result = whole.loaded(target).descend(x, scale)
            iterations += result.iterations
            left = left or result.left_saddle
            for _ in range(_LAST_DESCENTS if target == 1.0 and whole.is_dead else 0):
                if result.converged:
                    break
                further = whole.descend(result.point, scale)
                iterations += further.iterations
                left, result = left or further.left_saddle, further
            if not result.converged and target < 1.0:
                snaps = whole.snaps
                continue
            steps.step, stuck = 1.0, False
        steps.accept(target)
        x = result.point
        path.append((target, x))
        if target == 1.0:
            return replace(result, iterations=iterations, left_saddle=left, path=path, jumps=jumps)
        # A dead load leaves the Hessian alone: the minimum's serves the next step.
        tangent = None if result.factor is None or not whole.is_dead else whole.step(result.factor, -whole.push)
