"""Refinement of static solutions with residuals in extended precision."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple, final

import numpy as np

from modalshell.core.typing import Array
from modalshell.statics.mixed_newton import ACCEPTED
from modalshell.statics.newton import NewtonResult
from modalshell.statics.potential import Potential

_LIMIT = 10
"""Iterations at most."""


@final
class Refined(NamedTuple):
    """Positions (n, 3) [m], the residual before they were rounded, the gradient (N,) there, and the iterations."""

    point: Array
    residual: float
    gradient: Array
    iterations: int

    @property
    def limited(self) -> bool:
        """Whether rounding keeps the residual above :data:`ACCEPTED`."""
        return not self.residual <= ACCEPTED


def refined(
    problem: Potential,
    x: Array,
    scale: float,
    unbalanced: Callable[[Any], Any],
    newton: Callable[[Array], Array],
) -> Refined:
    """Newton's steps on displacements in extended precision, from x (n, 3) that double precision cannot balance.

    ``unbalanced`` gives what counts of a gradient (N,) on the free unknowns, ``newton`` the step (N,) against that over
    the ``scale`` of forces, by one factor: steps are of the size of rounding.
    """
    shell = problem.shell
    unknowns = shell.unknowns
    moved = x.astype(np.longdouble) - shell.rest_positions
    best, residual, kept = moved, np.inf, np.zeros(0)
    for iteration in range(_LIMIT + 1):
        force = problem.force((shell.rest_positions + moved).astype(np.float64))
        gradient = unknowns.restrict((shell.extended_gradient(moved) - force).ravel())
        # Both in double precision and scaled: squares of the smallest loads would underflow.
        out = (unbalanced(gradient) / scale).astype(np.float64)
        size = float(np.linalg.norm(out))
        if not size < 0.5 * residual:
            break
        best, residual, kept = moved, size, gradient.astype(np.float64)
        if size <= 0.01 * ACCEPTED or iteration == _LIMIT:
            break
        moved = moved + unknowns.prolong(newton(out) * np.longdouble(scale)).reshape(-1, 3)
    return Refined((shell.rest_positions + best).astype(np.float64), residual, kept, iteration)


def refine(problem: Potential, result: NewtonResult, scale: float) -> NewtonResult:
    """A minimum that double precision cannot balance, refined by the factor of its Hessian.

    One that rounding still limits is not converged.
    """
    factor = result.factor
    if result.residual <= ACCEPTED or not (result.converged and result.stable) or factor is None:
        return result
    found = refined(problem, result.point, scale, lambda gradient: gradient, lambda out: problem.step(factor, out))
    return replace(
        result,
        point=found.point,
        residual=found.residual,
        iterations=result.iterations + found.iterations,
        converged=not found.limited,
        limited=found.limited,
    )
