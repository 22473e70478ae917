"""Refinement of static solutions with residuals in extended precision."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from modalshell.statics.mixed_newton import ACCEPTED
from modalshell.statics.newton import NewtonResult
from modalshell.statics.potential import Potential

_LIMIT = 10
"""Iterations at most."""


def refine(problem: Potential, result: NewtonResult, scale: float) -> NewtonResult:
    """Newton's steps on displacements in extended precision, from a minimum that double precision cannot balance.

    The factor of the minimum's Hessian serves all steps, which are of the size of rounding. The residual is that of the
    displacements before they are rounded to double precision. Where it stays above :data:`ACCEPTED` the result is
    limited by rounding, and not converged.
    """
    if result.residual <= ACCEPTED or not (result.converged and result.stable) or result.factor is None:
        return result
    shell = problem.shell
    unknowns = shell.unknowns
    moved = result.point.astype(np.longdouble) - shell.rest_positions
    best, residual = moved, np.inf
    for iteration in range(_LIMIT + 1):
        force = problem.force((shell.rest_positions + moved).astype(np.float64))
        gradient = unknowns.restrict((shell.extended_gradient(moved) - force).ravel())
        # Both in double precision and scaled: squares of the smallest loads would underflow.
        out = (gradient / scale).astype(np.float64)
        size = float(np.linalg.norm(out))
        if not size < 0.5 * residual:
            break
        best, residual = moved, size
        if size <= 0.01 * ACCEPTED or iteration == _LIMIT:
            break
        step = problem.step(result.factor, out) * np.longdouble(scale)
        moved = moved + unknowns.prolong(step).reshape(-1, 3)
    limited = not residual <= ACCEPTED
    return replace(
        result,
        point=(shell.rest_positions + best).astype(np.float64),
        residual=residual,
        iterations=result.iterations + iteration,
        converged=not limited,
        limited=limited,
    )
