"""Statics under configuration-dependent loads, for models whose solvers take dead loads."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from modalshell.core.outcome import Outcome
from modalshell.core.typing import Array
from modalshell.loads import Loading
from modalshell.models.base.equilibrium import Equilibrium

_TOLERANCE = 1e-9
"""Change of the positions, as a share of the shell's size, at which the loads have settled."""
_LIMIT = 60
"""Answers to dead loads at one share of the loads at most."""
_KEPT = 6
"""Earlier answers that the next one is extrapolated from."""
_SMALLEST_STEP = 1.0 / 64.0

Solve = Callable[[Array, Array | None], Equilibrium]
"""Answer to a dead load (n, 3) [N] from positions (n, 3) [m], or from rest."""


def settled(solve: Solve, loading: Loading, start: Array | None) -> Equilibrium:
    """Equilibrium under loads that are, at the answer, those of the answer.

    The map from positions to the answer under the dead loads there is iterated with Anderson's extrapolation
    [anderson1965]; where it does not settle, under loads that grow in steps.
    """
    found, share, step, x, iterations = None, 0.0, 1.0, start, 0
    while share < 1.0:
        target = min(1.0, share + step)
        trial = _settle_at(solve, loading, target, x)
        iterations += trial.iterations
        if trial.converged:
            found, x, share, step = trial, trial.positions, target, 2.0 * step
            continue
        step *= 0.5
        if step < _SMALLEST_STEP or trial.outcome is Outcome.NO_EQUILIBRIUM:
            return replace(trial, iterations=iterations)
    assert found is not None
    return replace(found, iterations=iterations, stable=None)


def _settle_at(solve: Solve, loading: Loading, share: float, start: Array | None) -> Equilibrium:
    """The iteration under a share of the loads."""
    size = float(np.ptp(loading.rest, axis=0).max())
    x, begin = (loading.rest if start is None else start), start
    points: list[Array] = []
    misses: list[Array] = []
    iterations, change = 0, np.inf
    for _ in range(_LIMIT):
        found = solve(share * loading.force(x), begin)
        iterations += found.iterations
        if not found.converged:
            return replace(found, iterations=iterations)
        miss = found.positions - x
        change = float(np.abs(miss).max()) / size
        if change <= _TOLERANCE:
            return replace(found, iterations=iterations)
        points, misses = [*points[-_KEPT:], x], [*misses[-_KEPT:], miss]
        x, begin = _extrapolated(points, misses), found.positions
    message = f"loads that follow the shell do not settle: positions still change by {change:.1e} of its size"
    return replace(
        found, outcome=Outcome.NO_FIXED_POINT, message=message, iterations=iterations, residual=change, stable=None
    )


def _extrapolated(points: list[Array], misses: list[Array]) -> Array:
    """Where the linear model of the last answers has no miss, in least squares."""
    x, miss = points[-1], misses[-1]
    if len(points) == 1:
        return x + miss
    changes = np.stack([(miss - one).ravel() for one in misses[:-1]], axis=1)
    moves = np.stack([(x - one).ravel() for one in points[:-1]], axis=1)
    weights = np.linalg.lstsq(changes, miss.ravel(), rcond=1e-12)[0]
    return np.asarray(x + miss - ((moves + changes) @ weights).reshape(x.shape))
