"""Load continuation: the whole load at once from a start, or in steps from rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from modalshell.core.errors import SolverError
from modalshell.core.typing import Array
from modalshell.shell import EXACT
from modalshell.statics.bifurcation import branch_end
from modalshell.statics.mixed_newton import GOAL
from modalshell.statics.newton import Matrix, NewtonResult, Problem, is_minimum, mixed_newton

_LOAD_STEPS = 200
"""Load steps at most."""
_BEYOND = 1.02
"""Load at which a shell is equilibrated after a snap, over the last one of its branch."""
_SMALLEST_LOAD = 1e-3
_SMALLEST_TRUST = 1.0 / 300.0
"""Smallest trust radius of the load path."""


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
    x, factor, trust, iterations, steps, snaps, left = whole.origin, 0.0, 1.0, 0, 0, 0, False
    path: list[tuple[float, Array]] = []
    jumps: list[tuple[str, float]] = []
    tangent: Array | None = None
    while True:
        steps += 1
        result = None
        if trust >= _SMALLEST_TRUST and steps <= _LOAD_STEPS:
            try:
                if tangent is None:  # at rest; later the factor that showed a minimum gives it
                    present = whole if whole.is_dead else whole.loaded(factor)
                    tangent = whole.step(whole.factor(present.linearise(x, EXACT)[1]), -whole.push_at(x))
                    iterations += 1
                guess, stresses, share = whole.moved(x, (1.0 - factor) * tangent, trust * whole.load_step)
                target = factor + share * (1.0 - factor) if share < 0.999 else 1.0
            except SolverError:
                trust = 0.0
                continue
            problem, goal = whole.loaded(target), GOAL if target == 1.0 else whole.path_goal
            result = mixed_newton(problem, guess, scale, limit=25, goal=goal, stresses=stresses)
            iterations += result.iterations
            if not is_minimum(problem, result, exactly=target == 1.0):
                trust *= 0.25
                continue
            trust = min(1.0, 2.0 * trust)
        else:
            snaps += 1
            if whole.is_dead and whole.snaps and (end := branch_end(whole, x, factor)) is not None:
                jumps.append((end.kind, end.factor))
            stop = snaps > whole.snaps or steps > _LOAD_STEPS
            target = 1.0 if stop else min(1.0, max(_BEYOND * factor, _SMALLEST_LOAD))
            result = whole.loaded(target).descend(x, scale)
            iterations += result.iterations
            left = left or result.left_saddle
            if not result.converged and target < 1.0:
                snaps = whole.snaps
                continue
            trust = 1.0
        x, factor = result.point, target
        path.append((factor, x))
        if target == 1.0:
            return replace(result, iterations=iterations, left_saddle=left, path=path, jumps=jumps)
        # A dead load leaves the Hessian alone: the minimum's serves the next step.
        tangent = None if result.factor is None or not whole.is_dead else whole.step(result.factor, -whole.push)
