"""Triangular solves with a multifrontal factor, compiled: of one right side, or of as many as a register holds.

A solve reads the factor twice and does little else: where it does not fit into a cache, memory sets the pace. Four
columns are read at once, by whole registers. Those that reach beyond a column's end read what follows there: finite
numbers, which meet zeros or are not kept. On the narrow panels of shells this is faster than calls of the BLAS.
"""

from __future__ import annotations

from typing import Any

from modalshell.kernels.compiler import njit
from modalshell.kernels.packed import lane_count, load, spread, spread_from, store, total
from modalshell.linalg.analysis import Panels

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
            _eliminate_many(values, begins[s], own * block, height * block, work)
        for i in range(own * size):
            x[start + i] = work[i]
        for e in range(own, height):
            row = rows[row_starts[s] + e] * size
            for i in range(size):
                x[row + i] += work[e * size + i]
    _negate(x, flips, sides)
    for s in range(count - 1, -1, -1):
        own, height = first[s + 1] - first[s], row_ends[s] - row_starts[s]
        start = first[s] * size
        for i in range(own * size):
            work[i] = x[start + i]
        for e in range(own, height):
            row = rows[row_starts[s] + e] * size
            for i in range(size):
                work[e * size + i] = x[row + i]
        if sides == 1:
            _substitute_one(values, begins[s], own * block, height * block, work)
        else:
            _substitute_many(values, begins[s], own * block, height * block, work)
        for i in range(own * size):
            x[start + i] = work[i]


@njit(**_options)
def _negate(x: Any, flips: Any, sides: int) -> None:
    """Change the sign of some unknowns."""
    for f in flips:
        for i in range(f * sides, (f + 1) * sides):
            x[i] = -x[i]


@njit(**_options)
def _eliminate_one(values: Any, begin: int, width: int, height: int, work: Any) -> None:
    """Solve for the columns of a panel, and subtract their products from the rows below."""
    k, lanes = 0, lane_count(values)
    while k + 4 <= width:
        c0 = begin + k * height
        c1, c2, c3 = c0 + height, c0 + 2 * height, c0 + 3 * height
        x0 = work[k] / values[c0 + k]
        x1 = (work[k + 1] - values[c0 + k + 1] * x0) / values[c1 + k + 1]
        x2 = (work[k + 2] - values[c0 + k + 2] * x0 - values[c1 + k + 2] * x1) / values[c2 + k + 2]
        x3 = work[k + 3] - values[c0 + k + 3] * x0 - values[c1 + k + 3] * x1 - values[c2 + k + 3] * x2
        x3 /= values[c3 + k + 3]
        work[k], work[k + 1], work[k + 2], work[k + 3] = x0, x1, x2, x3
        f0, f1, f2, f3 = spread(x0), spread(x1), spread(x2), spread(x3)
        for i in range(k + 4, height, lanes):
            two = load(values, c0 + i) * f0 + load(values, c1 + i) * f1
            more = load(values, c2 + i) * f2 + load(values, c3 + i) * f3
            store(work, i, load(work, i) - (two + more))
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
    while k > 0:
        k -= 4
        c0 = begin + k * height
        c1, c2, c3 = c0 + height, c0 + 2 * height, c0 + 3 * height
        s0, s1, s2, s3 = zero, zero, zero, zero
        for i in range(k + 4, height, lanes):
            known = load(work, i)
            s0, s1 = s0 + load(values, c0 + i) * known, s1 + load(values, c1 + i) * known
            s2, s3 = s2 + load(values, c2 + i) * known, s3 + load(values, c3 + i) * known
        x3 = (work[k + 3] - total(s3)) / values[c3 + k + 3]
        x2 = (work[k + 2] - total(s2) - values[c2 + k + 3] * x3) / values[c2 + k + 2]
        x1 = work[k + 1] - total(s1) - values[c1 + k + 2] * x2 - values[c1 + k + 3] * x3
        x1 /= values[c1 + k + 1]
        x0 = work[k] - total(s0) - values[c0 + k + 1] * x1 - values[c0 + k + 2] * x2 - values[c0 + k + 3] * x3
        work[k], work[k + 1], work[k + 2], work[k + 3] = x0 / values[c0 + k], x1, x2, x3


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
