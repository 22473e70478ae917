"""Equilibria of modal coordinates under forces without a potential."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from modalshell.outcome import Outcome
from modalshell.statics.least_potential import WOUND_UP, Statics
from modalshell.typing import Array

_TOLERANCE = 1e-9
"""Relative residual at which an equilibrium has converged."""
_NEWTON_LIMIT = 20
"""Newton iterations at one share of the load at most."""
_SMALLEST_STEP = 1.0 / 1024.0
"""Smallest load step, relative to the load."""
_LOAD_TURN = 0.5
"""Largest predicted rotation [rad] of a part of the shell per load step."""
_DIFFERENCE = 1e-5
"""Turn [rad] over which a force is differenced."""

Force = Callable[[Array], Array]
"""Modal force (m,) of the whole load at coordinates (m,)."""


def balance(
    force: Force,
    eigenvalues: Array,
    rigid: int,
    turn: Callable[[Array], float],
    turns: Array,
    start: Array | None,
) -> Statics:
    """Solve ``Lambda q = p(q)`` for the elastic modes by Newton, from a start or along a load that grows from rest.

    Parameters
    ----------
    force : callable
        p.
    eigenvalues : ndarray, shape (m,)
        Lambda; the first ``rigid`` modes stay at zero.
    rigid : int
        Number of rigid modes.
    turn : callable
        Largest rotation [rad] at given coordinates.
    turns : ndarray, shape (m,)
        Largest rotation [rad] in each mode, by which steps of differences are chosen.
    start : ndarray, shape (m,), optional
        Where to begin.

    Returns
    -------
    Statics
        Its residual is ``|Lambda q - p| / |p(0)|`` in the norm of ``Lambda^-1``.
    """
    root = np.sqrt(eigenvalues[rigid:])
    if not root.size:
        return Statics(np.zeros(rigid), 0.0, 0, stable=True)

    def whole(y: Array) -> Array:
        return np.concatenate([np.zeros(rigid), y / root])

    def pushed(y: Array) -> Array:
        return np.asarray(force(whole(y))[rigid:] / root)

    def slope(y: Array) -> Array:
        columns = []
        for k in range(root.size):
            unit = np.zeros(root.size)
            unit[k] = 1.0
            change = _DIFFERENCE * root[k] / max(turns[rigid + k], 1e-300)
            columns.append((pushed(y + change * unit) - pushed(y - change * unit)) / (2.0 * change))
        return np.stack(columns, axis=1)

    def newton(y: Array, share: float) -> tuple[Array, float, int, Array | None]:
        last, growths, matrix = np.inf, 0, None
        for iteration in range(_NEWTON_LIMIT + 1):
            out = y - share * pushed(y)
            residual = float(np.linalg.norm(out)) / scale
            if residual <= _TOLERANCE:
                return y, residual, iteration, np.eye(y.size) - share * slope(y) if matrix is None else matrix
            growths = growths + 1 if residual >= last else 0
            last = residual
            if not np.isfinite(residual) or iteration == _NEWTON_LIMIT or growths == 2:
                break
            matrix = np.eye(y.size) - share * slope(y)
            if not np.linalg.cond(matrix) < 1e12:
                break
            y = y - np.linalg.solve(matrix, out)
        return y, residual, iteration, None

    rest = np.zeros(root.size)
    scale = float(np.linalg.norm(pushed(rest))) or 1.0
    iterations, residual, matrix = 0, np.inf, None
    if start is not None:
        y, residual, iterations, matrix = newton(root * start[rigid:], 1.0)
    if matrix is None:
        y, share, step = rest, 0.0, 1.0
        matrix = np.eye(y.size)
        while share < 1.0:
            step = min(step, 1.0 - share)
            tangent = np.asarray(np.linalg.solve(matrix, pushed(y)))
            step = min(step, _LOAD_TURN / max(turn(whole(tangent)), 1e-300))
            trial, residual, used, found = newton(y + step * tangent, share + step)
            iterations += used
            near = np.linalg.norm(trial - y - step * tangent) <= 2.0 * step * np.linalg.norm(tangent)
            if found is not None and near:
                y, matrix, share, step = trial, found, share + step, 2.0 * step
                continue
            step *= 0.5
            if step < _SMALLEST_STEP:
                message = "the branch from rest ends before this load"
                return Statics(whole(y), max(residual, _TOLERANCE), iterations, Outcome.NO_FIXED_POINT, message)
    q = whole(y)
    stable = bool(np.linalg.eigvals(np.eye(y.size) - slope(y)).real.min() > 0.0)
    if turn(q) > WOUND_UP:
        return Statics(q, residual, iterations, Outcome.WOUND_UP, "a part has turned by more than 2 pi", stable)
    if not stable:
        message = "a fixed point that even heavily damped motion leaves"
        return Statics(q, residual, iterations, Outcome.UNSTABLE, message, stable)
    return Statics(q, residual, iterations, stable=True)
