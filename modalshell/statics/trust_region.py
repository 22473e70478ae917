"""Trust-region minimisation of a smooth function of few unknowns, for the statics of reduced models."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.linalg

from modalshell.core.typing import Array
from modalshell.statics.newton import NewtonResult

_ITERATIONS = 500
"""Iterations at most."""
_ROUNDING = 1e-13
"""Share of the function's size below which its changes are rounding, and the gradient alone is followed."""
_FLAT = 1e-9
"""Negative curvature, as a share of the largest, that counts as none."""


def minimise(
    value_gradient: Callable[[Array], tuple[float, Array]],
    hessian: Callable[[Array], Array],
    start: Array,
    tolerance: float,
    *,
    scale: float = 1.0,
    radius: float = 1.0,
) -> NewtonResult:
    """Local minimum by Newton in a trust region, with exact steps from the Hessian's eigenvectors.

    A stationary point with negative curvature is left along it, so what is found is a minimum. Unknowns should be
    scaled so that the region, a ball, makes sense. ``value_gradient`` and ``hessian`` give these at a point (r,), the
    latter symmetric. It stops where the length of the gradient is ``tolerance`` times its size ``scale``; ``radius`` is
    the length of the first step at most. ``converged`` says whether it stopped at a point without negative curvature.
    """
    point = np.array(start, dtype=np.float64)
    value, gradient = value_gradient(point)
    iterations = 0
    while True:
        residual = float(np.linalg.norm(gradient)) / scale
        curvatures, axes = scipy.linalg.eigh(hessian(point))
        minimum = curvatures[0] >= -_FLAT * abs(curvatures).max()
        if residual <= tolerance and minimum:
            return NewtonResult(point, residual, iterations, True)
        slopes = axes.T @ gradient
        while True:  # shrink the region until a step succeeds
            if iterations == _ITERATIONS or radius < 1e-300:  # no step, however short, leads to finite values
                return NewtonResult(point, residual, iterations, False)
            iterations += 1
            along = _step(slopes, curvatures, radius)
            length = float(np.linalg.norm(along))
            promised = -float(slopes @ along + 0.5 * along @ (curvatures * along))
            trial = point + axes @ along
            trial_value, trial_gradient = value_gradient(trial)
            if not np.isfinite(trial_value):
                radius = 0.25 * length
                continue
            if promised <= _ROUNDING * max(abs(value), abs(trial_value)):
                if float(np.linalg.norm(trial_gradient)) < scale * residual:
                    break
                return NewtonResult(point, residual, iterations, False)
            ratio = (value - trial_value) / promised
            if ratio < 0.25:
                radius = 0.25 * length
            elif ratio > 0.75 and length > 0.9 * radius:
                radius *= 2.0
            if ratio > 0.05:
                break
        point, value, gradient = trial, trial_value, trial_gradient


def _step(slopes: Array, curvatures: Array, radius: float) -> Array:
    """Minimum of ``slopes . p + p . curvatures p / 2`` in the ball ``|p| <= radius`` [conn2000, algorithm 7.3.1]."""
    lowest = float(curvatures[0])
    if lowest > 0.0:
        newton = -slopes / curvatures
        if np.linalg.norm(newton) <= radius:
            return newton
    # p(shift) = -slopes / (curvatures + shift) shrinks as the shift grows from -lowest on: bisect |p| = radius.
    floor = max(0.0, -lowest)
    low, high = floor, floor + float(np.linalg.norm(slopes)) / radius
    for _ in range(100):
        shift = 0.5 * (low + high)
        if shift in (low, high):
            break
        shifted = curvatures + shift
        if shifted[0] <= 0.0 or np.linalg.norm(slopes / shifted) > radius:
            low = shift
        else:
            high = shift
    shifted = curvatures + high
    step = np.divide(-slopes, shifted, out=np.zeros_like(slopes), where=shifted > 0.0)
    missing = radius**2 - float(step @ step)
    if lowest <= 0.0 and missing > 1e-6 * radius**2:
        # The slope has no part along the lowest curvature: fill the ball along it, towards either side.
        step[0] += np.copysign(np.sqrt(step[0] ** 2 + missing) - abs(step[0]), step[0])
    return step
