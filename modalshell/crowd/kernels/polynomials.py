"""The polynomials of :mod:`modalshell.kernels.frame` with fewer multiplications, for SIMD vectors.

With x = s - CENTRE and y = x^2 any polynomial is even(y) + x odd(y). Where odd has a root -r, an equal remainder of
even makes it (y + r) p + t, and p is of that form again [knuth1997, 4.6.4]: two degrees for one multiplication, and an
addition that others need not wait for. Two roots that are not real leave (y^2 + g y + h) p + (k y + l). The terms of
lowest degree stay as they are: there, r p would cancel t. With the centre at 3/4 of the interval of s the largest
errors are as small as those of the powers: rounding included 4e-16 (half) and 2e-16 (third) in float64, 9e-8 and 4e-8
in float32. Multiplications of both: 17 in float64 and 12 in float32, where Estrin's scheme took 23 and 16.

Where no vertex of a pack turns by more than half a turn, polynomials of lower degree are as accurate, about the middle
of that interval: 13 and 8 multiplications.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import types
from numba.extending import overload
from numpy.typing import NDArray

from modalshell.kernels.compiler import njit
from modalshell.kernels.packed import any_above, spread_from

HALF_TURN = math.pi**2
"""|w|^2 at half a turn."""
CENTRE, NEAR_CENTRE = 3.0 * math.pi**2, 0.5 * math.pi**2
# Every line: the terms of highest degree; g, h, k, l; every r with its t; the terms of lowest degree.
# fmt: off
HALF_DOUBLE = (
    -1.970995826023855e-23, 2.487927826159983e-20, 1190728.6839852226, 474660624840.7972, -1.1842896133514053e-14,
    -9.138051608559743e-09, 152721.78295420553, -0.00019853045436152745, -0.01269186292591025, 0.10618852731842242,
)
THIRD_DOUBLE = (
    -4.5933564584126315e-26, 2.1905035662213316e-23, 159674.37300638962, 16915488367.764915, -8.481070347472724e-19,
    -2.4620825985764774e-13, 54161.499117365165, -3.0726047638876182e-09, 20571.71661779963, -2.3978318800080234e-05,
    -0.0017551015365256924, 0.03840298347652367,
)
HALF_SINGLE = tuple(np.float32(c) for c in (
    -1.29012591e-11, 2.34981746e-14, 2.7844036e-09, 110748.922, -9.89555265e-05, -0.0126918629, 0.106188528,
))
THIRD_SINGLE = tuple(np.float32(c) for c in (
    3.36640546e-13, -1.76546294e-15, -1.81799697e-11, 19376.25, -1.01137779e-07, 7870.26465, 0.00181325572,
    0.0384029858,
))
NEAR_HALF_DOUBLE = (
    -3.18266565617596e-17, 2.660510550568733e-14, 312674.74998876284, -6.594071271957692e-09, 205606.3231568362,
    -1.768114904353311e-05, -0.025984502413242717, 0.570423371026766,
)
NEAR_THIRD_DOUBLE = (
    7.39441130690766e-18, -2.504505989072337e-15, 80257.16785879285, 2024849740.0063646, 8.861856354609866e-11,
    3.981859028544338e-06, 10758.994838184703, 0.0051559094429549845, 0.13005834639449498,
)
NEAR_HALF_SINGLE = tuple(np.float32(c) for c in (
    7.1956614e-09, -2.04657113e-06, 46823.0234, 0.0698421523, 0.570423365,
))
NEAR_THIRD_SINGLE = tuple(np.float32(c) for c in (
    2.13780371e-08, -2.30279284e-06, 7535.28906, 0.0107874116, 0.130058348,
))
# fmt: on

_inline = njit(error_model="numpy", fastmath=False, forceinline=True)


def powers(dtype: Any) -> NDArray[Any]:
    """The polynomials of the warp as one array: a centre, those of c2, those of c3; the same up to half a turn."""
    if np.dtype(dtype) == np.float32:
        single = (CENTRE, *HALF_SINGLE, *THIRD_SINGLE, NEAR_CENTRE, *NEAR_HALF_SINGLE, *NEAR_THIRD_SINGLE)
        return np.array(single, np.float32)
    return np.array([CENTRE, *HALF_DOUBLE, *THIRD_DOUBLE, NEAR_CENTRE, *NEAR_HALF_DOUBLE, *NEAR_THIRD_DOUBLE])


@_inline
def _sum(powers, at, x):  # type: ignore[no-untyped-def]
    """``c1 x + c0``, c1 at ``at`` in ``powers`` and c0 next."""
    return spread_from(powers, at) * x + spread_from(powers, at + 1)


@_inline
def _real(powers, at, p, y):  # type: ignore[no-untyped-def]
    """``(y + r) p + t``, r at ``at`` in ``powers`` and t next."""
    return p * (y + spread_from(powers, at)) + spread_from(powers, at + 1)


@_inline
def _not_real(powers, at, p, y):  # type: ignore[no-untyped-def]
    """``(y^2 + g y + h) p + (k y + l)``, g at ``at`` in ``powers`` and the others next."""
    return p * ((y + spread_from(powers, at)) * y + spread_from(powers, at + 1)) + _sum(powers, at + 2, y)


def packed_coefficients(squared: Any, powers: Any) -> Any:
    """c2 and c3 at packed |w|^2 in [0, (2 pi)^2]; for compiled code only."""
    raise NotImplementedError


@overload(packed_coefficients, jit_options={"forceinline": True})
def _coefficients_by_precision(squared, powers):  # type: ignore[no-untyped-def] # noqa: ARG001
    single = squared.scalar == types.float32
    limit: Any = (np.float32 if single else np.float64)(HALF_TURN)

    def in_double(squared, powers):  # type: ignore[no-untyped-def]
        if not any_above(squared, limit):
            x = squared - spread_from(powers, 23)
            y = x * x
            half = _real(powers, 28, _real(powers, 26, _sum(powers, 24, x), y), y) * y + _sum(powers, 30, x)
            third = _real(powers, 38, _not_real(powers, 34, _sum(powers, 32, x), y), y) * x + spread_from(powers, 40)
            return half * half, third
        x = squared - spread_from(powers, 0)
        y = x * x
        half = _not_real(powers, 3, _sum(powers, 1, x), y)
        half = _real(powers, 7, half, y) * y + _sum(powers, 9, x)
        third = _not_real(powers, 13, _sum(powers, 11, x), y)
        third = _real(powers, 19, _real(powers, 17, third, y), y) * y + _sum(powers, 21, x)
        return half * half, third

    def in_single(squared, powers):  # type: ignore[no-untyped-def]
        if not any_above(squared, limit):
            x = squared - spread_from(powers, 16)
            y = x * x
            half = _real(powers, 19, _sum(powers, 17, x), y) * x + spread_from(powers, 21)
            third = _real(powers, 24, _sum(powers, 22, x), y) * x + spread_from(powers, 26)
            return half * half, third
        x = squared - spread_from(powers, 0)
        y = x * x
        half = spread_from(powers, 1) * x + _sum(powers, 2, y)
        half = _real(powers, 4, half, y) * y + _sum(powers, 6, x)
        third = spread_from(powers, 8) * x + _sum(powers, 9, y)
        third = _real(powers, 13, _real(powers, 11, third, y), y) * x + spread_from(powers, 15)
        return half * half, third

    return in_single if single else in_double
