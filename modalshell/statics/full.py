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
_BEYOND = 1.02
"""Load under which a shell comes to rest after a snap, over the last one that its branch could carry."""
_SMALLEST_LOAD = 1e-3
_SNAPS = 3
"""Ends of branches after which the potential is minimised under the whole load at once."""
_SMALLEST_TRUST = 1.0 / 300.0
"""Trust below which the load path is given up."""


def scale_of(problem: Potential, start: Array | None) -> float:
    """Force [N] that residuals are held against: the load's norm, or without a load that of the start's own forces."""
    if problem.scale or start is None:
        return problem.scale or 1.0
    return float(np.linalg.norm(problem.residual(start))) or 1.0


def equilibrium(problem: Potential, start: Array | None) -> NewtonResult:
    """Minimum of the potential: near ``start`` (n, 3) [m], held vertices in place, or where that fails from rest."""
    iterations = 0
    if start is not None:
        scale = scale_of(problem, start)
        result = mixed_newton(problem, start, scale)
        if is_minimum(problem, result):
            return result
        iterations = result.iterations
        if problem.scale == 0.0 or not np.array_equal(start, problem.shell.rest_positions):
            result = descend(problem, start, scale)
            result.iterations = iterations = iterations + result.iterations
            if result.converged or problem.scale == 0.0:
                return result
    followed = follow(problem, problem.scale or 1.0)
    followed.iterations += iterations
    return followed


def follow(whole: Potential, scale: float) -> NewtonResult:
    """Load continuation from rest along tangents, each step as long as :data:`_STEP_TURN` allows.

    Where the branch ends, the potential is minimised under a little more load, and the continuation goes on from there:
    the answer is that of a load that grows slowly, snaps included.
    """
    shell = whole.shell
    x, factor, trust, iterations, steps, snaps, left = shell.rest_positions, 0.0, 1.0, 0, 0, 0, False
    push = whole.load.ravel()[shell.free_unknowns]
    tangent: Array | None = None
    while True:
        steps += 1
        result = None
        if trust >= _SMALLEST_TRUST and steps <= _LOAD_STEPS:
            try:
                if tangent is None:  # at rest; later the factor that showed a minimum gives it
                    tangent = whole.step(whole.factor(whole.linearise(x, EXACT)[1]), -push)
                    iterations += 1
                guess, moved, share = warped_step(shell, x, (1.0 - factor) * tangent, trust * _STEP_TURN)
                stresses = shell.predicted_stresses(x, moved)
                target = factor + share * (1.0 - factor) if share < 0.999 else 1.0
            except SolverError:
                trust = 0.0
                continue
            problem = replace(whole, load=target * whole.load)
            goal = {} if target == 1.0 else {"goal": _LOOSE}
            result = mixed_newton(problem, guess, scale, limit=25, stresses=stresses, **goal)
            iterations += result.iterations
            if not is_minimum(problem, result):
                trust *= 0.25
                continue
            trust = min(1.0, 2.0 * trust)
        else:
            snaps += 1
            stop = snaps > _SNAPS or steps > _LOAD_STEPS
            target = 1.0 if stop else min(1.0, max(_BEYOND * factor, _SMALLEST_LOAD))
            result = descend(replace(whole, load=target * whole.load), x, scale)
            iterations += result.iterations
            left = left or result.left_saddle
            if not result.converged:
                if target == 1.0:
                    return replace(result, iterations=iterations)
                snaps = _SNAPS
                continue
            trust = 1.0
        x, factor = result.positions, target
        if target == 1.0:
            return replace(result, iterations=iterations, left_saddle=left)
        if result.factor is not None:  # a dead load leaves the Hessian alone: the minimum's serves the next step
            tangent = whole.step(result.factor, -push)
