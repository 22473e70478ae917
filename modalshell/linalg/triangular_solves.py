"""Triangular solves with a multifrontal factor, compiled: of one right side, or of as many as a register holds.

A solve reads the factor twice and does little else: where it does not fit into a cache, memory sets the pace. Its
panels stand in the order in which they are read; see :mod:`modalshell.linalg.panel_layout`. Registers that reach beyond
the last row read what follows there: finite numbers, which meet zeros or are not kept. On the narrow panels of shells
this is faster than calls of the BLAS. Sums are chains of one order, which no compiler has a choice in.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from modalshell.kernels.compiler import njit
from modalshell.kernels.packed import lane_count, load, spread, store, total
from modalshell.linalg.analysis import Panels
from modalshell.linalg.many_right_sides import eliminate_many, substitute_many
from modalshell.linalg.panel_layout import begin_of

_options: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "nsz"}}


@njit(**_options)
def solve(values: Any, panels: Panels, x: Any, sides: int, work: Any, flips: Any) -> None:
    """Solve ``L S L^T x = b`` in place for permuted right sides, 1 or as many as a register holds.

    S is the identity but for the unknowns ``flips``, where it is -1.

    ``x`` (N sides,) has those of one unknown side by side; ``work`` has room for the rows of a panel, and a register.
    """
    block, first, row_starts, row_ends, rows, begins = panels
    size = block * sides  # numbers of a row
    count = len(first) - 1
    for s in range(count):
        own, height = first[s + 1] - first[s], row_ends[s] - row_starts[s]
        start = first[s] * size
        for i in range(own * size):
            work[i] = x[start + i]
        for i in range(own * size, height * size):
            work[i] = 0.0
        if sides == 1:
            _eliminate_one(values, begins[s], own * block, height * block, work)
        else:
            eliminate_many(values, begins[s], own * block, height * block, work)
        for i in range(own * size):
            x[start + i] = work[i]
        _scatter(x, rows, row_starts[s], own, height, size, work)
    _negate(x, flips, sides)
    for s in range(count - 1, -1, -1):
        own, height = first[s + 1] - first[s], row_ends[s] - row_starts[s]
        start = first[s] * size
        for i in range(own * size):
            work[i] = x[start + i]
        _gather(x, rows, row_starts[s], own, height, size, work)
        if sides == 1:
            _substitute_one(values, begins[s], own * block, height * block, work)
        else:
            substitute_many(values, begins[s], own * block, height * block, work)
        for i in range(own * size):
            x[start + i] = work[i]


@njit(**_options)
def _scatter(x: Any, rows: Any, begin: int, own: int, height: int, size: int, work: Any) -> None:
    """Add what a panel left in its rows below; unsigned numbers are not looked at for negative ones."""
    at = np.uintp(begin)
    if size == 1:
        for e in range(np.uintp(own), np.uintp(height)):
            x[np.uintp(rows[at + e])] += work[e]
        return
    for e in range(np.uintp(own), np.uintp(height)):
        row = np.uintp(rows[at + e] * size)
        for i in range(np.uintp(size)):
            x[row + i] += work[e * np.uintp(size) + i]


@njit(**_options)
def _gather(x: Any, rows: Any, begin: int, own: int, height: int, size: int, work: Any) -> None:
    """Take what is known of a panel's rows below."""
    at = np.uintp(begin)
    if size == 1:
        for e in range(np.uintp(own), np.uintp(height)):
            work[e] = x[np.uintp(rows[at + e])]
        return
    for e in range(np.uintp(own), np.uintp(height)):
        row = np.uintp(rows[at + e] * size)
        for i in range(np.uintp(size)):
            work[e * np.uintp(size) + i] = x[row + i]


@njit(**_options)
def _negate(x: Any, flips: Any, sides: int) -> None:
    """Change the sign of some unknowns."""
    for f in flips:
        for i in range(f * sides, (f + 1) * sides):
            x[i] = -x[i]


@njit(inline="always", **_options)
def _solve_four(values: Any, at: int, stride: int, x: Any) -> Any:
    """Solve for four unknowns, the triangle of whose columns begins at ``at``."""
    one, (x0, x1, x2, x3) = values.dtype.type(1.0), x
    c1, c2, c3 = at + stride, at + 2 * stride, at + 3 * stride
    x0 = x0 * (one / values[at])
    x1 = (x1 - values[at + 1] * x0) * (one / values[c1 + 1])
    x2 = (x2 - values[at + 2] * x0 - values[c1 + 2] * x1) * (one / values[c2 + 2])
    x3 = (x3 - values[at + 3] * x0 - values[c1 + 3] * x1 - values[c2 + 3] * x2) * (one / values[c3 + 3])
    return x0, x1, x2, x3


@njit(inline="always", **_options)
def _solve_four_back(values: Any, at: int, stride: int, x: Any) -> Any:
    """As :func:`_solve_four`, by the transpose."""
    one, (x0, x1, x2, x3) = values.dtype.type(1.0), x
    c1, c2, c3 = at + stride, at + 2 * stride, at + 3 * stride
    x3 = x3 * (one / values[c3 + 3])
    x2 = (x2 - values[c2 + 3] * x3) * (one / values[c2 + 2])
    x1 = (x1 - values[c1 + 3] * x3 - values[c1 + 2] * x2) * (one / values[c1 + 1])
    x0 = (x0 - values[at + 3] * x3 - values[at + 2] * x2 - values[at + 1] * x1) * (one / values[at])
    return x0, x1, x2, x3


@njit(inline="always", **_options)
def _subtracted(values: Any, at: int, stride: int, start: Any, x: Any) -> Any:
    """``start`` less the products of four numbers, ``stride`` apart, with x."""
    left = start - values[at] * x[0] - values[at + stride] * x[1]
    return left - values[at + 2 * stride] * x[2] - values[at + 3 * stride] * x[3]


@njit(inline="always", **_options)
def _rows_less(values: Any, at: int, stride: int, start: Any, x: Any) -> Any:
    """:func:`_subtracted` for as many rows as a register holds."""
    left = start - load(values, at) * x[0] - load(values, at + stride) * x[1]
    return left - load(values, at + 2 * stride) * x[2] - load(values, at + 3 * stride) * x[3]


@njit(inline="always", **_options)
def _four_sums(values: Any, at: int, stride: int, known: Any, s: Any) -> Any:
    """Sums of four columns, and the products of as many rows as a register holds with what is ``known`` of these."""
    s0, s1 = s[0] + load(values, at) * known, s[1] + load(values, at + stride) * known
    return s0, s1, s[2] + load(values, at + 2 * stride) * known, s[3] + load(values, at + 3 * stride) * known


@njit(**_options)
def _eliminate_one(values: Any, begin: int, width: int, height: int, work: Any) -> None:
    """Solve for the columns of a panel, and subtract their products from the rows below."""
    k, at, lanes = 0, begin, lane_count(values)
    while k + 8 <= width:
        x = _solve_four(values, at, 8, (work[k], work[k + 1], work[k + 2], work[k + 3]))
        for j in range(4, 8):
            work[k + j] = _subtracted(values, at + j, 8, work[k + j], x)
        y = _solve_four(values, at + 36, 8, (work[k + 4], work[k + 5], work[k + 6], work[k + 7]))
        work[k], work[k + 1], work[k + 2], work[k + 3] = x
        work[k + 4], work[k + 5], work[k + 6], work[k + 7] = y
        f = (spread(x[0]), spread(x[1]), spread(x[2]), spread(x[3]))
        g = (spread(y[0]), spread(y[1]), spread(y[2]), spread(y[3]))
        at += 64
        rest = (height - k - 8) % lanes
        for i in range(k + 8, height - rest, lanes):
            left = _rows_less(values, at, lanes, load(work, i), f)
            store(work, i, _rows_less(values, at + 4 * lanes, lanes, left, g))
            at += 8 * lanes
        if rest > 0:
            left = _rows_less(values, at, rest, load(work, height - rest), f)
            store(work, height - rest, _rows_less(values, at + 4 * rest, rest, left, g))
            at += 8 * rest
        k += 8
    if k + 4 <= width:
        x = _solve_four(values, at, 4, (work[k], work[k + 1], work[k + 2], work[k + 3]))
        work[k], work[k + 1], work[k + 2], work[k + 3] = x
        f = (spread(x[0]), spread(x[1]), spread(x[2]), spread(x[3]))
        at, rest = at + 16, (height - k - 4) % lanes
        for i in range(k + 4, height - rest, lanes):
            store(work, i, _rows_less(values, at, lanes, load(work, i), f))
            at += 4 * lanes
        if rest > 0:
            store(work, height - rest, _rows_less(values, at, rest, load(work, height - rest), f))
            at += 4 * rest
        k += 4
    for last in range(k, width):
        x0 = work[last] / values[at]
        work[last] = x0
        f0 = spread(x0)
        for i in range(1, height - last, lanes):
            store(work, last + i, load(work, last + i) - load(values, at + i) * f0)
        at += height - last


@njit(**_options)
def _substitute_one(values: Any, begin: int, width: int, height: int, work: Any) -> None:
    """Solve for the columns of a panel by the transpose, with what is known of the rows below."""
    zero, lanes = spread(values.dtype.type(0.0)), lane_count(values)
    store(work, height, zero)
    k = width // 8 * 8
    at, first = begin_of(begin, k, height), k + (width - k) // 4 * 4
    single = at + (first - k) * (height - k)
    for last in range(width - 1, first - 1, -1):
        c0 = single + (last - first) * (height - first) - (last - first) * (last - first - 1) // 2
        s0 = zero
        for i in range(1, height - last, lanes):
            s0 = s0 + load(values, c0 + i) * load(work, last + i)
        work[last] = (work[last] - total(s0)) / values[c0]
    if first > k:
        s = (zero, zero, zero, zero)
        c0, rest = at + 16, (height - k - 4) % lanes
        for i in range(k + 4, height - rest, lanes):
            s = _four_sums(values, c0, lanes, load(work, i), s)
            c0 += 4 * lanes
        if rest > 0:
            s = _four_sums(values, c0, rest, load(work, height - rest), s)
        x = (work[k] - total(s[0]), work[k + 1] - total(s[1]), work[k + 2] - total(s[2]), work[k + 3] - total(s[3]))
        work[k], work[k + 1], work[k + 2], work[k + 3] = _solve_four_back(values, at, 4, x)
    while k > 0:
        k -= 8
        at = begin_of(begin, k, height)
        s, t = (zero, zero, zero, zero), (zero, zero, zero, zero)
        c0, rest = at + 64, (height - k - 8) % lanes
        for i in range(k + 8, height - rest, lanes):
            known = load(work, i)
            s, t = _four_sums(values, c0, lanes, known, s), _four_sums(values, c0 + 4 * lanes, lanes, known, t)
            c0 += 8 * lanes
        if rest > 0:
            known = load(work, height - rest)
            s, t = _four_sums(values, c0, rest, known, s), _four_sums(values, c0 + 4 * rest, rest, known, t)
        y = (work[k + 4] - total(t[0]), work[k + 5] - total(t[1]), work[k + 6] - total(t[2]), work[k + 7] - total(t[3]))
        y = _solve_four_back(values, at + 36, 8, y)
        x0 = _subtracted(values, at + 4, 1, work[k] - total(s[0]), y)
        x1 = _subtracted(values, at + 12, 1, work[k + 1] - total(s[1]), y)
        x2 = _subtracted(values, at + 20, 1, work[k + 2] - total(s[2]), y)
        x3 = _subtracted(values, at + 28, 1, work[k + 3] - total(s[3]), y)
        work[k], work[k + 1], work[k + 2], work[k + 3] = _solve_four_back(values, at, 8, (x0, x1, x2, x3))
        work[k + 4], work[k + 5], work[k + 6], work[k + 7] = y
