"""Constraints in modal coordinates, met with the least modal work [choi2007, section 4.4]."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from modalshell.core.typing import Array

Evaluate = Callable[[Array], tuple[Array, Array]]
"""Residual (k,), target less value, and Jacobian (k, m) of the constrained values at q."""

_MET = 1e-8
"""Residual, lengths as shares of the shell's size and angles in radians, at which constraints count as met."""
_SOFTEST, _HARDER, _HARDEST = 1e-3, 0.01, 1e-14
"""First softness eps of the constraints, the factor from one to the next, and the last."""
_PASSES = 12
"""Gauss-Newton steps at one softness at most."""
_STAGE, _STAGE_SOFTNESS = 0.15, 1e-5
"""Largest residual met in one stage, and the softness of the constraints until the last stage."""
_MOST_STAGES = 200
"""Enough for 30 times the shell's size; modes do not reach farther targets."""
_STALLED = 0.7
"""Share of the residual that a harder constraint must beat, or the target counts as out of reach."""


def meet(evaluate: Evaluate, free: Array, compliance: Array, start: Array) -> tuple[Array, Array]:
    """Least ``(q - q_free)^T G^-1 (q - q_free) / 2`` among the q that meet the constraints.

    Solves ``q = q_free + G J^T mu`` with ``r = eps mu``, for eps from soft to hard: of the linearised constraints
    ``(J G J^T + eps I) mu = r + J (q - q_free)`` each pass is a Gauss-Newton step with a line search. A harder
    constraint that brings its target no nearer is not followed: the stiff modes would be shaken for nothing.

    Parameters
    ----------
    evaluate : callable
        Residual and Jacobian at q.
    free : ndarray, shape (m,)
        Coordinates without the constraints.
    compliance : ndarray, shape (m,)
        Diagonal of G: response of the coordinates to modal forces, by the time step or in statics.
    start : ndarray, shape (m,)
        Starting point, on the branch to be kept.

    Returns
    -------
    q : ndarray, shape (m,)
        Modal coordinates.
    residual : ndarray, shape (k,)
        What is left of target less value.
    """
    root = np.sqrt(compliance)
    z: Array = (start - free) / root
    residual, jacobian = evaluate(start)
    unit = float(np.sum((jacobian * root) ** 2)) / len(residual) or 1.0
    # Far targets are led there in stages: a single leap would land on another branch.
    first, stages = residual, int(min(np.ceil(np.abs(residual).max() / _STAGE), _MOST_STAGES))
    for stage in range(1, stages):

        def on_the_way(q: Array, offset: Array = first * (1.0 - stage / stages)) -> tuple[Array, Array]:
            residual, jacobian = evaluate(q)
            return residual - offset, jacobian

        known = on_the_way(free + root * z)
        z = _minimise(on_the_way, free, root, z, *known, _STAGE_SOFTNESS * unit)[0]
    residual, jacobian = evaluate(free + root * z)
    best, reached = z, residual
    softness = _SOFTEST
    stalls = 0
    while softness >= _HARDEST:
        z, residual, jacobian = _minimise(evaluate, free, root, z, residual, jacobian, softness * unit)
        size, before = float(np.abs(residual).max()), float(np.abs(reached).max())
        # The first answer is taken as it is: leading may have ended nearer, by more work.
        if softness == _SOFTEST or size <= _STALLED * before:
            best, reached, stalls = z, residual, 0
        else:
            stalls += 1
        if size <= _MET or stalls == 2:
            break
        softness *= _HARDER
    return free + root * best, reached


def _minimise(
    evaluate: Evaluate, free: Array, root: Array, z: Array, residual: Array, jacobian: Array, epsilon: float
) -> tuple[Array, Array, Array]:
    """Gauss-Newton on ``|z|^2 + |r|^2 / epsilon`` from z, where residual and Jacobian are known."""

    def merit(z: Array, residual: Array) -> float:
        return float(z @ z + residual @ residual / epsilon)

    value = merit(z, residual)
    for _ in range(_PASSES):
        scaled = jacobian * root
        try:
            mu = np.linalg.solve(scaled @ scaled.T + epsilon * np.eye(len(residual)), residual + scaled @ z)
        except np.linalg.LinAlgError:  # targets that no softness tells apart, under absurd loads
            break
        move = scaled.T @ mu - z
        length = 1.0
        while length > 1e-4:
            trial = z + length * move
            found, slope = evaluate(free + root * trial)
            lower = merit(trial, found)
            if lower < value:
                break
            length *= 0.5
        else:
            break
        gain, value = value - lower, lower
        z, residual, jacobian = trial, found, slope
        if gain <= 1e-12 * value or np.abs(residual).max() <= 0.1 * _MET:
            break
    return z, residual, jacobian
