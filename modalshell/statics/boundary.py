"""Statics of discrete shells under constraints, by continuation of the patches to their targets."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from modalshell.constraints.constraints import HeldPatch
from modalshell.core.errors import SolverError
from modalshell.core.timings import Timings
from modalshell.core.typing import Array
from modalshell.modes import Factoriser
from modalshell.shell import EXACT, Shell
from modalshell.statics.live_loads import LiveLoads
from modalshell.statics.newton import NewtonResult, is_minimum, mixed_newton
from modalshell.statics.potential import Potential, warped_step
from modalshell.statics.refine import refine

_FIRST_STEP, _SMALLEST_STEP = 0.25, 1.0 / 256.0
"""First and smallest share of a motion of the boundary taken in one step."""
_STEP_TURN = 0.6
"""Largest predicted rotation [rad] of a vertex per step."""


def lead(
    shell: Shell,
    load: Array,
    start: Array | None,
    patches: Sequence[HeldPatch],
    origin: Array,
    factoriser: Factoriser,
    costs: Timings,
    live: LiveLoads | None = None,
) -> NewtonResult:
    """Equilibrium with the patches at their targets, moved there from ``start`` (n, 3), or rest, in steps that adapt.

    Targets are in the world's frame, where the shell's origin is at ``origin`` (3,).

    Each step is predicted along the tangent, warped, and solved by mixed Newton; where that ends at no minimum the step
    is shortened, and at last the potential is minimised.
    """
    held = shell.holding(np.concatenate([patch.vertices for patch in patches]))
    problem = Potential(load, shell.rest_positions, held, factoriser, costs, live)
    x = shell.rest_positions if start is None else start
    origins = [x[patch.vertices] for patch in patches]
    goals = [patch.at(0.0) - origin for patch in patches]

    def placed(share: float) -> Array:
        return np.concatenate([a + share * (b - a) for a, b in zip(origins, goals, strict=True)])

    if any(patch.orientation is not None for patch in patches):
        # Turn rigidly on the way: straight paths would crush the patch. From rest, that is; a start is left behind.
        def placed(share: float) -> Array:
            return np.concatenate([patch.at(0.0, share) - origin for patch in patches])

    vertices = np.concatenate([patch.vertices for patch in patches])
    share, step, iterations = 0.0, _FIRST_STEP, 0
    size = problem.measure(problem.push)
    scale = max(size, 1e-300)
    while share < 1.0:
        step = min(step, 1.0 - share)
        target = placed(share + step)
        moved = np.zeros_like(x)
        moved[vertices] = target - x[vertices]
        try:
            gradient, hessian = problem.linearise(x, EXACT)
            tangent = held.energy_gradient_hessian(x, EXACT)[2]
            pull = held.pattern.product(tangent, moved.ravel())
            direction = problem.step(problem.factor(hessian), gradient + held.unknowns.restrict(pull))
            iterations += 1
            moved += held.unknowns.prolong(direction).reshape(-1, 3)
            reaction = float(np.linalg.norm(held.pattern.product(tangent, moved.ravel()).reshape(-1, 3)[vertices]))
            scale = max(size, reaction, 1e-300)
            guess, _, fraction = warped_step(shell, x, shell.unknowns.values(moved.ravel()), _STEP_TURN)
            guess[vertices] = target
            result = mixed_newton(problem, guess, scale, limit=25, stresses=held.predicted_stresses(x, moved))
            iterations += result.iterations
            solved = fraction > 0.999 and is_minimum(problem, result)
        except SolverError:
            solved = False
        if not solved and step > _SMALLEST_STEP:
            step *= 0.5
            continue
        if not solved:
            guess = x.copy()
            guess[vertices] = target
            scale = max(size, float(np.linalg.norm(problem.residual(guess))), 1e-300)
            result = problem.descend(guess, scale)
            iterations += result.iterations
            if not result.converged:
                result.iterations = iterations
                return result
        x, share, step = result.point, share + step, 2.0 * step
    result.iterations = iterations
    return refine(problem, result, scale)
