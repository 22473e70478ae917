"""Exact flow of a damped mode, and its response to a force that is constant or grows linearly over a step.

See theory 12, eq. 5.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from modalshell.core.typing import Array, Mask

RESOLVED, FOLLOWED = 3.0, 4.0
"""Steps a period from which modes are followed under forces that turn, and from which a predicted force serves that."""
_SERIES = 0.5
"""``h^2 lambda + h c`` below which all coefficients are sums of a power series."""
_TERMS = 24
_PHI2_SERIES = [1.0 / math.factorial(k + 2) for k in range(10)]
_SLOW = 1e-2
"""``h lambda / c`` below which an overdamped mode is taken by its two rates: closed forms cancel there."""


class Flow(NamedTuple):
    """Coefficients of ``q'' + c q' + lambda q = p`` over a step, each of one number for every mode.

    ``q+ = e11 q + e12 v + a1 p_0 + a2 (p_1 - p_0)``, ``v+ = e21 q + e22 v + b1 p_0 + b2 (p_1 - p_0)`` for a force that
    goes straight from p_0 to p_1.
    """

    e11: Array
    e12: Array
    e21: Array
    e22: Array
    a1: Array
    a2: Array
    b1: Array
    b2: Array


def flow(stiffness: ArrayLike, damp: ArrayLike, h: ArrayLike) -> Flow:
    """Coefficients of modes of ``stiffness`` lambda [1/s^2] and ``damp`` c [1/s], at least 0, over ``h`` [s].

    They are to rounding for all of them, rigid and overdamped modes among these: with ``z`` the roots of
    ``z^2 + h c z + h^2 lambda``, e12 / h, a1 / h^2 and a2 / h^2 are divided differences of the exponential at the
    roots, and there with one and with two zeros [hochbruck2010, section 2].
    """
    stiff, drag, step = (np.asarray(part, dtype=np.float64) for part in np.broadcast_arrays(stiffness, damp, h))
    x, y = step**2 * stiff, step * drag
    series = x + y < _SERIES
    slow = ~series & (x < _SLOW * y)
    # Each part is found for all modes, of harmless numbers where it does not serve.
    first, second, third = np.where(
        series,
        _by_series(np.where(series, x, 0.0), np.where(series, y, 0.0)),
        np.where(slow, _by_rates(np.where(slow, x, 0.0), np.where(slow, y, 1.0)), _closed(x, y, ~(series | slow))),
    )
    # (1 - e11) = lambda a1, and e22 = e11 - c e12.
    e11, e12 = 1.0 - x * second, step * first
    a1, a2 = step**2 * second, step**2 * third
    return Flow(e11, e12, -stiff * e12, e11 - y * first, a1, a2, e12, step * second)


def outrun(stiffness: Array, h: ArrayLike, steps: float = RESOLVED) -> Mask:
    """Whether modes have fewer ``steps`` a period; just as many, but for rounding, are enough."""
    return np.asarray(np.square(h) * stiffness > (1.0 + 1e-6) * (2.0 * np.pi / steps) ** 2)


def hardly_followed(stiffness: Array, h: ArrayLike) -> float | None:
    """Least stiffness [1/s^2] of the modes that are followed with few steps a period; None without any."""
    few = stiffness[outrun(stiffness, h, FOLLOWED) & ~outrun(stiffness, h)]
    return float(few.min()) if few.size else None


def turning_flow(stiffness: ArrayLike, damp: ArrayLike, h: ArrayLike) -> Flow:
    """Coefficients under forces that turn with the shell: those of implicit Euler for modes that steps do not resolve.

    Such a mode, of fewer than :data:`RESOLVED` steps a period, would be fed by a force that follows it a step late. The
    force on it is that of the step's end where others are :func:`hardly_followed`, else the mean of the step's two.
    """
    exact = flow(stiffness, damp, h)
    stiff, drag, step = np.broadcast_arrays(*(np.asarray(part, dtype=np.float64) for part in (stiffness, damp, h)))
    fast = outrun(stiff, step)
    if not fast.any():
        return exact
    whole = 1.0 + step * drag + step**2 * stiff
    moved, pushed, share = step**2 / whole, step / whole, 0.5 if hardly_followed(stiff, step) is None else 1.0
    euler = (
        (1.0 + step * drag) / whole, pushed, -stiff * pushed, 1.0 / whole, moved, share * moved, pushed, share * pushed
    )  # fmt: skip
    return Flow(*(np.where(fast, slow, known) for slow, known in zip(euler, exact, strict=True)))


@lru_cache(maxsize=64)
def free_flow(damp: float, h: float) -> Flow:
    """The coefficients of a mode without stiffness, as numbers; kept, as every free part takes the same."""
    return Flow(*(float(part) for part in flow(0.0, damp, h)))  # type: ignore[arg-type]


def _by_series(x: Array, y: Array) -> Array:
    """Divided differences of exp at both roots, and with one and two zeros, by ``w'' + y w' + x w = 0``'s series."""
    # Complete homogeneous sums h_k of the roots, over factorials: h_k = -y h_{k-1} - x h_{k-2}.
    before, term, factorial = np.zeros_like(x), np.ones_like(x), 1.0
    sums = np.zeros((3, *x.shape))
    for k in range(_TERMS):
        sums[0] += term / factorial
        sums[1] += term / (factorial * (k + 2))
        sums[2] += term / (factorial * (k + 2) * (k + 3))
        before, term = term, -y * term - x * before
        factorial *= k + 2
    return sums


def _by_rates(x: Array, y: Array) -> Array:
    """The same by the slow and the fast rate of an overdamped mode, which lie far apart."""
    root = np.sqrt(np.maximum(0.25 * y**2 - x, 0.0))
    fast = -(0.5 * y + root)
    slow = x / fast
    gap = slow - fast
    return np.stack([(f(slow) - f(fast)) / gap for f in (np.exp, _phi1, _phi2)])


def _phi1(z: Array) -> Array:
    """``(e^z - 1) / z``."""
    return np.where(z == 0.0, 1.0, np.expm1(z) / np.where(z == 0.0, 1.0, z))


def _phi2(z: Array) -> Array:
    """``(e^z - 1 - z) / z^2``."""
    near = np.abs(z) < 0.1
    series = np.polynomial.polynomial.polyval(np.where(near, z, 0.0), _PHI2_SERIES)
    return np.where(near, series, (_phi1(z) - 1.0) / np.where(near, 1.0, z))


def _closed(x: Array, y: Array, chosen: np.ndarray) -> Array:
    """The same in closed form, for modes that are neither slow nor slack."""
    x, y = np.where(chosen, x, 1.0), np.where(chosen, y, 0.0)
    half = 0.5 * y
    squared = x - half**2
    root = np.sqrt(np.abs(squared))
    # sin(r) / r and sinh(r) / r without cancellation or overflow.
    small = root < 1e-3
    safe = np.where(small, 1.0, root)
    turning = np.exp(-half) * np.where(small, 1.0 - squared / 6.0, np.sin(root) / safe)
    slow, fast = np.exp(-x / (half + root)), np.exp(-(half + root))
    creeping = np.where(small, np.exp(-half) * (1.0 - squared / 6.0), (slow - fast) / (2.0 * safe))
    first = np.where(squared > 0.0, turning, creeping)
    cosine = np.where(squared > 0.0, np.exp(-half) * np.cos(root), 0.5 * (slow + fast))
    second = (1.0 - cosine - half * first) / x
    return np.stack([first, second, (1.0 - first - y * second) / x])
