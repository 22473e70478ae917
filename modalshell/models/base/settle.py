"""Statics under configuration-dependent loads, for models whose solvers take dead loads."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from modalshell.core.outcome import Outcome
from modalshell.core.typing import Array
from modalshell.loads import Loading
from modalshell.models.base.equilibrium import Equilibrium
from modalshell.statics.continuation import Steps
from modalshell.statics.verdict import verdict

_TOLERANCE = 1e-9
"""Change of the positions, as a share of the shell's size, at which the loads have settled."""
_PATIENCE = 12
"""Answers without halving the change after which the iteration gives up."""
_KEPT = 6
"""Earlier answers that the next one is extrapolated from."""

Solve = Callable[[Array, Array | None], Equilibrium]
"""Answer to a dead load (n, 3) [N] from positions (n, 3) [m], or from rest."""


def self_consistent(solve: Solve, loading: Loading, start: Array | None) -> Equilibrium:
    """Equilibrium under loads that are, at the answer, those of the answer.

    The map from positions to the answer under the dead loads there is iterated with Anderson's extrapolation
    [anderson1965]; where it does not converge, under loads that grow in steps.
    """
    steps, x, iterations = Steps(), start, 0
    while True:
        found = _fixed_point(solve, loading, steps.target, x)
        iterations += found.iterations
        if found.converged:
            x = found.positions
            steps.accept()
            if steps.fraction == 1.0:
                return replace(found, iterations=iterations, stable=None)
        elif found.outcome is Outcome.NO_EQUILIBRIUM or not steps.refuse():
            return replace(found, iterations=iterations)


def judged(found: Equilibrium, loading: Loading, lowest: Callable[[Equilibrium, Array], float | None]) -> Equilibrium:
    """An answer under loads that follow, with what the ``lowest`` eigenvalue of its tangent says of its stability.

    Dead loads as they are there know nothing of how they change: beyond a speed at which a turning frame, or a follower
    that buckles the shell, leaves its branch, what is in balance is a saddle, on the other side of the load.
    """
    if not found.converged:
        return found
    seen = lowest(replace(found, loading=loading, conservative=loading.conservative), loading.force(found.positions))
    if seen is None or seen > 0.0:
        return replace(found, stable=None if seen is None else True)
    outcome, message = verdict(0.0, False, follows=not loading.conservative)
    return replace(found, outcome=outcome, message="; ".join(filter(None, [message, found.message])), stable=False)


def _fixed_point(solve: Solve, loading: Loading, fraction: float, start: Array | None) -> Equilibrium:
    """The iteration under a fraction of the loads."""
    size = float(np.ptp(loading.rest, axis=0).max())
    x, begin = (loading.rest if start is None else start), start
    points: list[Array] = []
    misses: list[Array] = []
    iterations, least, stalled = 0, np.inf, 0
    while stalled < _PATIENCE:
        found = solve(fraction * loading.force(x), begin)
        iterations += found.iterations
        if not found.converged:
            return replace(found, iterations=iterations)
        miss = found.positions - x
        change = float(np.abs(miss).max()) / size
        if change <= _TOLERANCE:
            return replace(found, iterations=iterations)
        stalled = 0 if change <= 0.5 * least else stalled + 1
        least = min(least, change)
        points, misses = [*points[-_KEPT:], x], [*misses[-_KEPT:], miss]
        x, begin = extrapolated(points, misses), found.positions
    message = f"loads that follow the shell do not settle: positions still change by {change:.1e} of its size"
    return replace(
        found, outcome=Outcome.NO_FIXED_POINT, message=message, iterations=iterations, residual=change, stable=None
    )


def extrapolated(points: list[Array], misses: list[Array]) -> Array:
    """Where the linear model of the last answers has no miss, in least squares."""
    x, miss = points[-1], misses[-1]
    if len(points) == 1:
        return x + miss
    changes = np.stack([(miss - one).ravel() for one in misses[:-1]], axis=1)
    moves = np.stack([(x - one).ravel() for one in points[:-1]], axis=1)
    weights = np.linalg.lstsq(changes, miss.ravel(), rcond=1e-12)[0]
    return np.asarray(x + miss - ((moves + changes) @ weights).reshape(x.shape))
