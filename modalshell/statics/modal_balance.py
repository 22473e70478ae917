"""Equilibria of modal coordinates under forces without a potential."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.linalg

from modalshell.core.outcome import Outcome
from modalshell.core.typing import Array
from modalshell.statics.least_potential import WOUND_UP, Statics

_TOLERANCE = 1e-9
"""Relative residual at which an equilibrium has converged."""
_NEWTON_LIMIT = 12
"""Newton iterations at one share of the load at most."""
_SMALLEST_STEP = 1.0 / 1024.0
"""Smallest load step, relative to the load."""
_LOAD_TURN = 0.5
"""Largest predicted rotation [rad] of a part of the shell per load step."""
_DIFFERENCE = 1e-5
"""Turn [rad] over which a force is differenced."""

Force = Callable[[Array, float], Array]
"""Modal force (m,), or its derivatives (m, m), at coordinates (m,) under a share of the load."""


def balance(
    force: Force,
    slope: Force,
    eigenvalues: Array,
    rigid: int,
    turn: Callable[[Array], float],
    start: Array | None,
    *,
    first_step: float = 0.25,
    retry: bool = False,
) -> Statics:
    """Solve ``Lambda q = p(q)`` for the elastic modes by Newton, from a start or along a load that grows from rest.

    Load steps halve where Newton fails and double where it does not. A step is also refused if it moves farther than
    twice what the tangent at its beginning says, or turns a part far: Newton would jump to another branch. The Jacobian
    is not symmetric, so that neither mixed Newton's minimum nor its symmetric factors serve here.

    Parameters
    ----------
    force, slope : callable
        p, and its derivatives.
    eigenvalues : ndarray, shape (m,)
        Lambda; the first ``rigid`` modes stay at zero.
    rigid : int
        Number of rigid modes.
    turn : callable
        Largest rotation [rad] at given coordinates.
    start : ndarray, shape (m,), optional
        Where to begin.
    first_step : float
        Share of the load that is tried first.
    retry : bool
        Whether to follow the load from rest where Newton fails from the start.

    Returns
    -------
    Statics
        Its residual is ``|Lambda q - p| / |p(0)|`` in the norm of ``Lambda^-1``.
    """
    # Unknowns y = sqrt(lambda) q: their squared length is twice the elastic energy.
    root = np.sqrt(eigenvalues[rigid:])
    rest = np.zeros(root.size)
    if not root.size:
        return Statics(np.zeros(rigid), 0.0, 0, stable=True)

    def whole(y: Array) -> Array:
        return np.concatenate([np.zeros(rigid), y / root])

    def left(y: Array, share: float) -> Array:
        return np.asarray(y - force(whole(y), share)[rigid:] / root)

    def jacobian(y: Array, share: float) -> Array:
        if share == 0.0:
            return np.eye(root.size)
        return np.eye(root.size) - slope(whole(y), share)[rigid:, rigid:] / root[:, None] / root

    scale = float(np.linalg.norm(left(rest, 1.0))) or 1.0

    def newton(y: Array, share: float) -> tuple[Array, float, int, bool]:
        """At one share of the load; gives up when the residual grows twice in a row."""
        residual, growths = np.inf, 0
        for iteration in range(_NEWTON_LIMIT + 1):
            out_of_balance = left(y, share)
            previous, residual = residual, float(np.linalg.norm(out_of_balance)) / scale
            if residual <= _TOLERANCE:
                return y, residual, iteration, True
            growths = growths + 1 if residual >= previous else 0
            if not np.isfinite(residual) or iteration == _NEWTON_LIMIT or growths == 2:
                break
            matrix = jacobian(y, share)
            if not np.linalg.cond(matrix) <= 1e12:
                break
            y = y - np.linalg.solve(matrix, out_of_balance)
        return y, residual, iteration, False

    iterations, solved = 0, False
    if start is not None:
        y, residual, iterations, solved = newton(root * start[rigid:], 1.0)
    if start is None or (retry and not solved):
        y, share, step = rest, 0.0, first_step
        while share < 1.0:
            step = min(step, 1.0 - share)
            # dy/dshare = J^-1 p / sqrt(lambda), and p / sqrt(lambda) = y / share on the branch.
            tangent = np.asarray(np.linalg.solve(jacobian(y, share), y / share if share > 0.0 else -left(y, 1.0)))
            step = min(step, _LOAD_TURN / max(turn(whole(tangent)), 1e-300))
            trial, _, used, solved = newton(y + step * tangent, share + step)
            iterations += used
            near = np.linalg.norm(trial - y - step * tangent) <= step * float(np.linalg.norm(tangent))
            if solved and near and turn(whole(trial - y)) <= 2.0 * _LOAD_TURN:
                y, share, step = np.asarray(trial), share + step, 2.0 * step
                continue
            step *= 0.5
            if step < _SMALLEST_STEP:
                break
        residual, solved = float(np.linalg.norm(left(y, 1.0))) / scale, share >= 1.0
    q = whole(y)
    if not solved:
        message = "the branch from rest ends before this load"
        return Statics(q, residual, iterations, Outcome.NO_FIXED_POINT, message)
    stable = bool(scipy.linalg.eigvals(jacobian(y, 1.0)).real.min() > 0.0)
    if turn(q) > WOUND_UP:
        message = "a part of the shell has turned by more than 2 pi"
        return Statics(q, residual, iterations, Outcome.WOUND_UP, message, stable)
    if not stable:
        message = "a fixed point that even heavily damped motion leaves"
        return Statics(q, residual, iterations, Outcome.UNSTABLE, message, stable)
    return Statics(q, residual, iterations, stable=True)


def differences(force: Callable[[Array], Array], q: Array, rotations: Array) -> Array:
    """Derivatives (m, m) of a modal force at q (m,) by central differences.

    Each is taken over a small turn of the vertices, whose rotations in the modes are ``rotations`` (3n, m).
    """
    slope = np.empty((q.size, q.size))
    turns = np.maximum(np.abs(rotations).max(axis=0), 1e-300)
    for k in range(q.size):
        change = np.zeros_like(q)
        change[k] = _DIFFERENCE / turns[k]
        slope[:, k] = (force(q + change) - force(q - change)) / (2.0 * change[k])
    return slope
