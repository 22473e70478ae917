"""The polynomials of the crowd's kernels: fitted and taken apart anew, and against what they stand for."""

import mpmath
import numpy as np
import pytest
from mpmath import mpf
from numba import njit

from modalshell.crowd.kernels import polynomials as kernels
from modalshell.kernels.packed import BYTES, load, store


@njit(error_model="numpy")
def tabulate(squared, powers, lanes, second, third):
    for at in range(0, squared.size, lanes):
        c2, c3 = kernels.packed_coefficients(load(squared, at), powers)
        store(second, at, c2)
        store(third, at, c3)


def half(s):
    root = mpmath.sqrt(s)
    return mpmath.sin(root / 2) / root * mpmath.sqrt(2) if s else mpmath.sqrt(0.5)


def third(s):
    root = mpmath.sqrt(s)
    return (root - mpmath.sin(root)) / root**3 if s else mpf(1) / 6


def powers_about_the_centre(function, count, end, centre):
    """Of the best polynomial over [0, end pi^2] about centre pi^2, that of degree 0 first."""
    middle = end * mpmath.pi**2 / 2
    fit = mpmath.chebyfit(lambda t: function(t + middle), [-middle, middle], count)[::-1]
    shift = centre * mpmath.pi**2 - middle
    return [sum(fit[j] * mpmath.binomial(j, k) * shift ** (j - k) for j in range(k, count)) for k in range(count)]


def divided(powers, divisor):
    """Quotient and remainder by a polynomial of leading power 1."""
    rest, size = list(powers), len(divisor) - 1
    quotient = []
    for top in range(len(rest) - 1, size - 1, -1):
        quotient.insert(0, rest[top])
        for k in range(size):
            rest[top - size + k] -= rest[top] * divisor[k]
    return quotient, rest[:size]


def taken_apart(powers, kept):
    """A line of constants as the module describes it, with ``kept`` terms of lowest degree."""
    even, odd = powers[kept::2], powers[kept + 1 :: 2]
    roots = mpmath.polyroots(odd[::-1], maxsteps=500, extraprec=500)
    nodes, inner = [], []
    for r in sorted(-mpmath.re(root) for root in roots if abs(mpmath.im(root)) < 1e-30 * abs(root)):
        even, (t,) = divided(even, [r, mpf(1)])
        nodes = [r, t, *nodes]
    for root in roots:
        if mpmath.im(root) > 1e-30 * abs(root):
            g, h = -2 * mpmath.re(root), abs(root) ** 2
            even, (low, high) = divided(even, [h, g, mpf(1)])
            inner = [g, h, high, low]
    return [odd[-1], *even[::-1], *inner, *nodes, *powers[:kept][::-1]]


@pytest.mark.by_default("line1-third-interval1-12-2", "line4-half-interval4-8-2", "line6-half-interval6-5-1")
@pytest.mark.parametrize(
    ("line", "function", "interval", "count", "kept"),
    [
        (kernels.HALF_DOUBLE, half, (4, 3), 10, 2),
        (kernels.THIRD_DOUBLE, third, (4, 3), 12, 2),
        (kernels.HALF_SINGLE, half, (4, 3), 7, 2),
        (kernels.THIRD_SINGLE, third, (4, 3), 8, 1),
        (kernels.NEAR_HALF_DOUBLE, half, (1, 0.5), 8, 2),
        (kernels.NEAR_THIRD_DOUBLE, third, (1, 0.5), 9, 1),
        (kernels.NEAR_HALF_SINGLE, half, (1, 0.5), 5, 1),
        (kernels.NEAR_THIRD_SINGLE, third, (1, 0.5), 5, 1),
    ],
)
def test_the_constants_are_the_fit_taken_apart(line, function, interval, count, kept):
    precision = 2e-16 if isinstance(line[0], float) else 6e-8
    with mpmath.workdps(60):
        exact = taken_apart(powers_about_the_centre(function, count, *interval), kept)
        assert all(abs(mpf(float(a)) / b - 1) < precision for a, b in zip(line, exact, strict=True))


@pytest.mark.by_default("float64-1e-15")
@pytest.mark.parametrize(("dtype", "bound"), [(np.float64, 1e-15), (np.float32, 1.5e-7)])
def test_they_hold_over_the_interval(dtype, bound):
    squared = np.linspace(0.0, 4 * np.pi**2, 3008).astype(dtype)
    found = np.empty((2, squared.size), dtype)
    tabulate(squared, kernels.powers(dtype), BYTES // squared.itemsize, *found)
    with mpmath.workdps(40):
        exact = [(half(mpf(float(s))) ** 2, third(mpf(float(s)))) for s in squared]
        errors = np.abs(
            [
                [float(mpf(float(a)) - b) for a, b in zip(*pair, strict=True)]
                for pair in zip(found.T, exact, strict=True)
            ]
        )
    assert (errors.max(axis=0) < [bound, 0.3 * bound]).all()
