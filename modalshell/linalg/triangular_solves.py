"""Triangular solves with a multifrontal factor, compiled: of one right side, or of as many as a register holds.

A solve reads the factor twice and does little else: where it does not fit into a cache, memory sets the pace. Eight
columns of one right side are read at once, or four of many, by whole registers. Those that reach beyond a column's end
read what follows there: finite numbers, which meet zeros or are not kept. On the narrow panels of shells this is faster
than calls of the BLAS. Sums are chains of one order, which no compiler has a choice in.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from modalshell.kernels.compiler import njit
from modalshell.kernels.packed import lane_count, load, spread, spread_from, store, total
from modalshell.linalg.analysis import Panels

_options: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "nsz"}}
_CACHED = 2**25
"""Bytes of a factor that stays in a third cache; of larger ones a panel is read ahead of its use."""


@njit(**_options)
def solve(values: Any, panels: Panels, x: Any, sides: int, work: Any, flips: Any) -> None:
    """Solve ``L S L^T x = b`` in place for permuted right sides, 1 or as many as a register holds.

    S is the identity but for the unknowns ``flips``, where it is -1.

    ``x`` (N sides,) has those of one unknown side by side; ``work`` has room for the rows of a panel, and a register.
    """
    block, first, row_starts, row_ends, rows, begins = panels
    size = block * sides  # numbers of a row
    count = len(first) - 1
    large = begins[count] * values.itemsize > _CACHED
    for s in range(count):
        own, height = first[s + 1] - first[s], row_ends[s] - row_starts[s]
        start = first[s] * size
        if large:
            _fetch(values, begins[s], begins[s + 1], work, height * size)
        for i in range(own * size):
            work[i] = x[start + i]
        for i in range(own * size, height * size):
            work[i] = 0.0
        if sides == 1:
            _eliminate_one(values, begins[s], own * block, height * block, work)
        else:
            _eliminate_many(values, begins[s], own * block, height * block, work)
        for i in range(own * size):
            x[start + i] = work[i]
        _scatter(x, rows, row_starts[s], own, height, size, work)
    _negate(x, flips, sides)
    for s in range(count - 1, -1, -1):
        own, height = first[s + 1] - first[s], row_ends[s] - row_starts[s]
        start = first[s] * size
        if large:
            _fetch(values, begins[s], begins[s + 1], work, height * size)
        for i in range(own * size):
            work[i] = x[start + i]
        _gather(x, rows, row_starts[s], own, height, size, work)
        if sides == 1:
            _substitute_one(values, begins[s], own * block, height * block, work)
        else:
            _substitute_many(values, begins[s], own * block, height * block, work)
        for i in range(own * size):
            x[start + i] = work[i]


@njit(**_options)
def _fetch(values: Any, begin: int, end: int, work: Any, place: int) -> None:
    """Read a panel in the order of memory, as caches foresee, which columns side by side are not; the sum is not used.

    It goes to a ``place`` in ``work`` that is written to before it is read.
    """
    read = spread(values.dtype.type(0.0))
    for i in range(begin, end, lane_count(values)):
        read = read + load(values, i)
    work[place] = total(read)


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
def _down(values: Any, at: int, height: int, x: Any) -> Any:
    """Solve for four unknowns, the triangle of whose columns begins at ``at``."""
    one, (x0, x1, x2, x3) = values.dtype.type(1.0), x
    c1, c2, c3 = at + height, at + 2 * height, at + 3 * height
    x0 = x0 * (one / values[at])
    x1 = (x1 - values[at + 1] * x0) * (one / values[c1 + 1])
    x2 = (x2 - values[at + 2] * x0 - values[c1 + 2] * x1) * (one / values[c2 + 2])
    x3 = (x3 - values[at + 3] * x0 - values[c1 + 3] * x1 - values[c2 + 3] * x2) * (one / values[c3 + 3])
    return x0, x1, x2, x3


@njit(inline="always", **_options)
def _up(values: Any, at: int, height: int, x: Any) -> Any:
    """As :func:`_down`, by the transpose."""
    one, (x0, x1, x2, x3) = values.dtype.type(1.0), x
    c1, c2, c3 = at + height, at + 2 * height, at + 3 * height
    x3 = x3 * (one / values[c3 + 3])
    x2 = (x2 - values[c2 + 3] * x3) * (one / values[c2 + 2])
    x1 = (x1 - values[c1 + 3] * x3 - values[c1 + 2] * x2) * (one / values[c1 + 1])
    x0 = (x0 - values[at + 3] * x3 - values[at + 2] * x2 - values[at + 1] * x1) * (one / values[at])
    return x0, x1, x2, x3


@njit(inline="always", **_options)
def _less(values: Any, at: int, stride: int, start: Any, x: Any) -> Any:
    """``start`` less the products of four numbers, ``stride`` apart, with x."""
    left = start - values[at] * x[0] - values[at + stride] * x[1]
    return left - values[at + 2 * stride] * x[2] - values[at + 3 * stride] * x[3]


@njit(**_options)
def _eliminate_one(values: Any, begin: int, width: int, height: int, work: Any) -> None:
    """Solve for the columns of a panel, and subtract their products from the rows below."""
    k, lanes = 0, lane_count(values)
    while k + 8 <= width:
        c0 = begin + k * height
        c1, c2, c3, c4 = c0 + height, c0 + 2 * height, c0 + 3 * height, c0 + 4 * height
        c5, c6, c7 = c4 + height, c4 + 2 * height, c4 + 3 * height
        x = _down(values, c0 + k, height, (work[k], work[k + 1], work[k + 2], work[k + 3]))
        for j in range(4, 8):
            work[k + j] = _less(values, c0 + k + j, height, work[k + j], x)
        y = _down(values, c4 + k + 4, height, (work[k + 4], work[k + 5], work[k + 6], work[k + 7]))
        work[k], work[k + 1], work[k + 2], work[k + 3] = x
        work[k + 4], work[k + 5], work[k + 6], work[k + 7] = y
        f0, f1, f2, f3 = spread(x[0]), spread(x[1]), spread(x[2]), spread(x[3])
        f4, f5, f6, f7 = spread(y[0]), spread(y[1]), spread(y[2]), spread(y[3])
        for i in range(k + 8, height, lanes):
            left = load(work, i) - load(values, c0 + i) * f0 - load(values, c1 + i) * f1 - load(values, c2 + i) * f2
            left = left - load(values, c3 + i) * f3 - load(values, c4 + i) * f4 - load(values, c5 + i) * f5
            store(work, i, left - load(values, c6 + i) * f6 - load(values, c7 + i) * f7)
        k += 8
    if k + 4 <= width:
        c0 = begin + k * height
        c1, c2, c3 = c0 + height, c0 + 2 * height, c0 + 3 * height
        x = _down(values, c0 + k, height, (work[k], work[k + 1], work[k + 2], work[k + 3]))
        work[k], work[k + 1], work[k + 2], work[k + 3] = x
        f0, f1, f2, f3 = spread(x[0]), spread(x[1]), spread(x[2]), spread(x[3])
        for i in range(k + 4, height, lanes):
            left = load(work, i) - load(values, c0 + i) * f0 - load(values, c1 + i) * f1
            store(work, i, left - load(values, c2 + i) * f2 - load(values, c3 + i) * f3)
        k += 4
    for last in range(k, width):
        c0 = begin + last * height
        x0 = work[last] / values[c0 + last]
        work[last] = x0
        f0 = spread(x0)
        for i in range(last + 1, height, lanes):
            store(work, i, load(work, i) - load(values, c0 + i) * f0)


@njit(**_options)
def _substitute_one(values: Any, begin: int, width: int, height: int, work: Any) -> None:
    """Solve for the columns of a panel by the transpose, with what is known of the rows below."""
    zero, lanes = spread(values.dtype.type(0.0)), lane_count(values)
    store(work, height, zero)
    k = width
    while k % 4 > 0:
        k -= 1
        c0 = begin + k * height
        s0 = zero
        for i in range(k + 1, height, lanes):
            s0 = s0 + load(values, c0 + i) * load(work, i)
        work[k] = (work[k] - total(s0)) / values[c0 + k]
    if k % 8 > 0:
        k -= 4
        c0 = begin + k * height
        c1, c2, c3 = c0 + height, c0 + 2 * height, c0 + 3 * height
        s0, s1, s2, s3 = zero, zero, zero, zero
        for i in range(k + 4, height, lanes):
            known = load(work, i)
            s0, s1 = s0 + load(values, c0 + i) * known, s1 + load(values, c1 + i) * known
            s2, s3 = s2 + load(values, c2 + i) * known, s3 + load(values, c3 + i) * known
        x = (work[k] - total(s0), work[k + 1] - total(s1), work[k + 2] - total(s2), work[k + 3] - total(s3))
        work[k], work[k + 1], work[k + 2], work[k + 3] = _up(values, c0 + k, height, x)
    while k > 0:
        k -= 8
        c0 = begin + k * height
        c1, c2, c3, c4 = c0 + height, c0 + 2 * height, c0 + 3 * height, c0 + 4 * height
        c5, c6, c7 = c4 + height, c4 + 2 * height, c4 + 3 * height
        s0, s1, s2, s3, s4, s5, s6, s7 = zero, zero, zero, zero, zero, zero, zero, zero
        for i in range(k + 8, height, lanes):
            known = load(work, i)
            s0, s1 = s0 + load(values, c0 + i) * known, s1 + load(values, c1 + i) * known
            s2, s3 = s2 + load(values, c2 + i) * known, s3 + load(values, c3 + i) * known
            s4, s5 = s4 + load(values, c4 + i) * known, s5 + load(values, c5 + i) * known
            s6, s7 = s6 + load(values, c6 + i) * known, s7 + load(values, c7 + i) * known
        y = (work[k + 4] - total(s4), work[k + 5] - total(s5), work[k + 6] - total(s6), work[k + 7] - total(s7))
        y = _up(values, c4 + k + 4, height, y)
        x0 = _less(values, c0 + k + 4, 1, work[k] - total(s0), y)
        x1 = _less(values, c1 + k + 4, 1, work[k + 1] - total(s1), y)
        x2 = _less(values, c2 + k + 4, 1, work[k + 2] - total(s2), y)
        x3 = _less(values, c3 + k + 4, 1, work[k + 3] - total(s3), y)
        work[k], work[k + 1], work[k + 2], work[k + 3] = _up(values, c0 + k, height, (x0, x1, x2, x3))
        work[k + 4], work[k + 5], work[k + 6], work[k + 7] = y


@njit(**_options)
def _eliminate_many(values: Any, begin: int, width: int, height: int, work: Any) -> None:
    """As :func:`_eliminate_one`, a register of right sides in every row."""
    k, one, lanes = 0, values.dtype.type(1.0), lane_count(values)
    while k + 4 <= width:
        c0 = begin + k * height
        c1, c2, c3 = c0 + height, c0 + 2 * height, c0 + 3 * height
        at = k * lanes
        x0 = load(work, at) * spread(one / values[c0 + k])
        x1 = load(work, at + lanes) - spread_from(values, c0 + k + 1) * x0
        x1 = x1 * spread(one / values[c1 + k + 1])
        x2 = load(work, at + 2 * lanes) - spread_from(values, c0 + k + 2) * x0 - spread_from(values, c1 + k + 2) * x1
        x2 = x2 * spread(one / values[c2 + k + 2])
        x3 = load(work, at + 3 * lanes) - spread_from(values, c0 + k + 3) * x0 - spread_from(values, c1 + k + 3) * x1
        x3 = (x3 - spread_from(values, c2 + k + 3) * x2) * spread(one / values[c3 + k + 3])
        store(work, at, x0)
        store(work, at + lanes, x1)
        store(work, at + 2 * lanes, x2)
        store(work, at + 3 * lanes, x3)
        for i in range(k + 4, height):
            two = spread_from(values, c0 + i) * x0 + spread_from(values, c1 + i) * x1
            more = spread_from(values, c2 + i) * x2 + spread_from(values, c3 + i) * x3
            store(work, i * lanes, load(work, i * lanes) - (two + more))
        k += 4
    for last in range(k, width):
        c0 = begin + last * height
        x0 = load(work, last * lanes) * spread(one / values[c0 + last])
        store(work, last * lanes, x0)
        for i in range(last + 1, height):
            store(work, i * lanes, load(work, i * lanes) - spread_from(values, c0 + i) * x0)


@njit(**_options)
def _substitute_many(values: Any, begin: int, width: int, height: int, work: Any) -> None:
    """As :func:`_substitute_one`, a register of right sides in every row."""
    k, one, lanes = width, values.dtype.type(1.0), lane_count(values)
    while k % 4 > 0:
        k -= 1
        c0 = begin + k * height
        x0 = load(work, k * lanes)
        for i in range(k + 1, height):
            x0 = x0 - spread_from(values, c0 + i) * load(work, i * lanes)
        store(work, k * lanes, x0 * spread(one / values[c0 + k]))
    while k > 0:
        k -= 4
        c0 = begin + k * height
        c1, c2, c3 = c0 + height, c0 + 2 * height, c0 + 3 * height
        at = k * lanes
        x0, x1 = load(work, at), load(work, at + lanes)
        x2, x3 = load(work, at + 2 * lanes), load(work, at + 3 * lanes)
        for i in range(k + 4, height):
            known = load(work, i * lanes)
            x0, x1 = x0 - spread_from(values, c0 + i) * known, x1 - spread_from(values, c1 + i) * known
            x2, x3 = x2 - spread_from(values, c2 + i) * known, x3 - spread_from(values, c3 + i) * known
        x3 = x3 * spread(one / values[c3 + k + 3])
        x2 = (x2 - spread_from(values, c2 + k + 3) * x3) * spread(one / values[c2 + k + 2])
        x1 = x1 - spread_from(values, c1 + k + 2) * x2 - spread_from(values, c1 + k + 3) * x3
        x1 = x1 * spread(one / values[c1 + k + 1])
        x0 = x0 - spread_from(values, c0 + k + 1) * x1 - spread_from(values, c0 + k + 2) * x2
        x0 = (x0 - spread_from(values, c0 + k + 3) * x3) * spread(one / values[c0 + k])
        store(work, at, x0)
        store(work, at + lanes, x1)
        store(work, at + 2 * lanes, x2)
        store(work, at + 3 * lanes, x3)
