"""Statics of discrete shells and springs: the whole load at once from a start, or in steps from rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from modalshell.errors import SolverError
from modalshell.shell import EXACT
from modalshell.statics.newton import NewtonResult, Potential, descend, is_minimum, mixed_newton, warped_step
from modalshell.typing import Array

_STEP_TURN = 0.8
"""Turn of a vertex [rad] that one load step may predict."""
_LOAD_STEPS = 200
"""Load steps at most."""
_LOOSE = 1e-3
"""Relative residual that load steps before the last aim at."""
_SMALLEST_TRUST = 1.0 / 300.0
"""Trust below which the load path is given up."""


def scale_of(problem: Potential, start: Array | None) -> float:
    """Force [N] that residuals are held against: the load's norm, or without a load that of the start's own forces."""
    if problem.scale or start is None:
        return problem.scale or 1.0
    return float(np.linalg.norm(problem.residual(start))) or 1.0


def equilibrium(problem: Potential, start: Array | None) -> NewtonResult:
    """Minimum of the potential: from ``start`` (n, 3) [m], held vertices in place, or where that fails from rest."""
    iterations = 0
    if start is not None:
        scale = scale_of(problem, start)
        result = mixed_newton(problem, start, scale)
        if is_minimum(problem, result):
            return result
        iterations = result.iterations
        if problem.scale == 0.0:
            result = descend(problem, start, scale)
            result.iterations += iterations
            return result
    followed = follow(problem, problem.scale or 1.0)
    followed.iterations += iterations
    return followed


def follow(whole: Potential, scale: float) -> NewtonResult:
    """Load continuation from rest along tangents, each step as long as :data:`_STEP_TURN` allows."""
    shell = whole.shell
    x, factor, trust, iterations, steps = shell.rest_positions, 0.0, 1.0, 0, 0
    push = whole.load.ravel()[shell.free_unknowns]
    tangent: Array | None = None
    while True:
        steps += 1
        if steps > _LOAD_STEPS:
            trust = 0.0
        target, guess, stresses = factor, x, None
        try:
            if trust < _SMALLEST_TRUST:
                raise SolverError("the branch has ended")
            if tangent is None:  # at rest; later the factor that showed a minimum gives it
                tangent = whole.step(whole.factor(whole.linearise(x, EXACT)[1]), -push)
                iterations += 1
            guess, moved, share = warped_step(shell, x, (1.0 - factor) * tangent, trust * _STEP_TURN)
            target = factor + share * (1.0 - factor) if share < 0.999 else 1.0
            stresses = shell.predicted_stresses(x, moved)
        except SolverError:
            trust = 0.0
        last = target == 1.0
        problem = replace(whole, load=target * whole.load)
        if trust >= _SMALLEST_TRUST:
            goal = {} if last else {"goal": _LOOSE}
            result = mixed_newton(problem, guess, scale, limit=25, stresses=stresses, **goal)
            iterations += result.iterations
        if trust < _SMALLEST_TRUST or not is_minimum(problem, result):
            trust *= 0.25
            if trust >= _SMALLEST_TRUST:
                continue
            # The branch ends here: go downhill to wherever the shell comes to rest under the whole load.
            result = descend(whole, x, scale)
            result.iterations += iterations
            return result
        x, factor, trust = result.positions, target, min(1.0, 2.0 * trust)
        if last:
            return replace(result, iterations=iterations)
        if result.factor is not None:  # a dead load leaves the Hessian alone: the minimum's serves the next step
            tangent = whole.step(result.factor, -push)
