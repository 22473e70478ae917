"""Triangular solves with a panel of a multifrontal factor, compiled: a register of right sides in every row."""

from __future__ import annotations

from typing import Any

from modalshell.kernels.compiler import njit
from modalshell.kernels.packed import lane_count, load, spread, spread_from, store
from modalshell.linalg.panel_layout import begin_of

_options: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "nsz"}}


@njit(inline="always", **_options)
def _four(work: Any, at: int, lanes: int) -> Any:
    """Four registers one after the other."""
    return load(work, at), load(work, at + lanes), load(work, at + 2 * lanes), load(work, at + 3 * lanes)


@njit(inline="always", **_options)
def _keep(work: Any, at: int, lanes: int, x: Any) -> None:
    """Write four registers one after the other."""
    store(work, at, x[0])
    store(work, at + lanes, x[1])
    store(work, at + 2 * lanes, x[2])
    store(work, at + 3 * lanes, x[3])


@njit(inline="always", **_options)
def _down_many(values: Any, at: int, stride: int, x: Any) -> Any:
    """Solve for four unknowns, the triangle of whose columns begins at ``at``, a register of right sides each."""
    one, (x0, x1, x2, x3) = values.dtype.type(1.0), x
    c1, c2, c3 = at + stride, at + 2 * stride, at + 3 * stride
    x0 = x0 * spread(one / values[at])
    x1 = (x1 - spread_from(values, at + 1) * x0) * spread(one / values[c1 + 1])
    x2 = x2 - spread_from(values, at + 2) * x0 - spread_from(values, c1 + 2) * x1
    x2 = x2 * spread(one / values[c2 + 2])
    x3 = x3 - spread_from(values, at + 3) * x0 - spread_from(values, c1 + 3) * x1 - spread_from(values, c2 + 3) * x2
    return x0, x1, x2, x3 * spread(one / values[c3 + 3])


@njit(inline="always", **_options)
def _up_many(values: Any, at: int, stride: int, x: Any) -> Any:
    """As :func:`_down_many`, by the transpose."""
    one, (x0, x1, x2, x3) = values.dtype.type(1.0), x
    c1, c2, c3 = at + stride, at + 2 * stride, at + 3 * stride
    x3 = x3 * spread(one / values[c3 + 3])
    x2 = (x2 - spread_from(values, c2 + 3) * x3) * spread(one / values[c2 + 2])
    x1 = x1 - spread_from(values, c1 + 3) * x3 - spread_from(values, c1 + 2) * x2
    x1 = x1 * spread(one / values[c1 + 1])
    x0 = x0 - spread_from(values, at + 3) * x3 - spread_from(values, at + 2) * x2 - spread_from(values, at + 1) * x1
    return x0 * spread(one / values[at]), x1, x2, x3


@njit(inline="always", **_options)
def _less_many(values: Any, at: int, stride: int, start: Any, x: Any) -> Any:
    """``start`` less the products of four numbers, ``stride`` apart, with x."""
    left = start - spread_from(values, at) * x[0] - spread_from(values, at + stride) * x[1]
    return left - spread_from(values, at + 2 * stride) * x[2] - spread_from(values, at + 3 * stride) * x[3]


@njit(inline="always", **_options)
def _each_less(values: Any, at: int, stride: int, known: Any, x: Any) -> Any:
    """Four numbers of right sides, less the products of what is ``known`` of one row with its entries."""
    x0, x1 = x[0] - spread_from(values, at) * known, x[1] - spread_from(values, at + stride) * known
    return (
        x0,
        x1,
        x[2] - spread_from(values, at + 2 * stride) * known,
        x[3] - spread_from(values, at + 3 * stride) * known,
    )


@njit(entry=False, **_options)
def eliminate_many(values: Any, begin: int, width: int, height: int, work: Any) -> None:
    """Solve for the columns of a panel, and subtract their products from the rows below."""
    k, at, lanes = 0, begin, lane_count(values)
    while k + 8 <= width:
        top = k * lanes
        x = _down_many(values, at, 8, _four(work, top, lanes))
        _keep(work, top, lanes, x)
        for j in range(4, 8):
            row = top + j * lanes
            store(work, row, _less_many(values, at + j, 8, load(work, row), x))
        y = _down_many(values, at + 36, 8, _four(work, top + 4 * lanes, lanes))
        _keep(work, top + 4 * lanes, lanes, y)
        at += 64
        for i in range(k + 8, height, lanes):
            step = min(lanes, height - i)
            for r in range(step):
                row = (i + r) * lanes
                left = _less_many(values, at + r, step, load(work, row), x)
                store(work, row, _less_many(values, at + 4 * step + r, step, left, y))
            at += 8 * step
        k += 8
    if k + 4 <= width:
        x = _down_many(values, at, 4, _four(work, k * lanes, lanes))
        _keep(work, k * lanes, lanes, x)
        at += 16
        for i in range(k + 4, height, lanes):
            step = min(lanes, height - i)
            for r in range(step):
                row = (i + r) * lanes
                store(work, row, _less_many(values, at + r, step, load(work, row), x))
            at += 4 * step
        k += 4
    for last in range(k, width):
        x0 = load(work, last * lanes) * spread(values.dtype.type(1.0) / values[at])
        store(work, last * lanes, x0)
        for i in range(1, height - last):
            row = (last + i) * lanes
            store(work, row, load(work, row) - spread_from(values, at + i) * x0)
        at += height - last


@njit(entry=False, **_options)
def substitute_many(values: Any, begin: int, width: int, height: int, work: Any) -> None:
    """Solve for the columns of a panel by the transpose, with what is known of the rows below."""
    k, lanes = width // 8 * 8, lane_count(values)
    at, first = begin_of(begin, k, height), k + (width - k) // 4 * 4
    single = at + (first - k) * (height - k)
    for last in range(width - 1, first - 1, -1):
        c0 = single + (last - first) * (height - first) - (last - first) * (last - first - 1) // 2
        x0 = load(work, last * lanes)
        for i in range(1, height - last):
            x0 = x0 - spread_from(values, c0 + i) * load(work, (last + i) * lanes)
        store(work, last * lanes, x0 * spread(values.dtype.type(1.0) / values[c0]))
    if first > k:
        c0, x = at + 16, _four(work, k * lanes, lanes)
        for i in range(k + 4, height, lanes):
            step = min(lanes, height - i)
            for r in range(step):
                x = _each_less(values, c0 + r, step, load(work, (i + r) * lanes), x)
            c0 += 4 * step
        _keep(work, k * lanes, lanes, _up_many(values, at, 4, x))
    while k > 0:
        k -= 8
        at, top = begin_of(begin, k, height), k * lanes
        c0, x, y = at + 64, _four(work, top, lanes), _four(work, top + 4 * lanes, lanes)
        for i in range(k + 8, height, lanes):
            step = min(lanes, height - i)
            for r in range(step):
                known = load(work, (i + r) * lanes)
                x, y = _each_less(values, c0 + r, step, known, x), _each_less(values, c0 + 4 * step + r, step, known, y)
            c0 += 8 * step
        y = _up_many(values, at + 36, 8, y)
        _keep(work, top + 4 * lanes, lanes, y)
        x0, x1 = _less_many(values, at + 4, 1, x[0], y), _less_many(values, at + 12, 1, x[1], y)
        x2, x3 = _less_many(values, at + 20, 1, x[2], y), _less_many(values, at + 28, 1, x[3], y)
        _keep(work, top, lanes, _up_many(values, at, 8, (x0, x1, x2, x3)))
