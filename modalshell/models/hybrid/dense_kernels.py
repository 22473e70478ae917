"""Compiled dense algebra of a reduced energy: rows over its coordinates, their products, and a factor.

Vectors over coordinates are rows of a whole number of packed registers, ``width`` long and padded with zeros.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from modalshell.kernels.compiler import UNCOUNTED, njit
from modalshell.kernels.packed import LANES, load, spread, spread_from, store, total, transpose

_options: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "nsz"}, "nogil": True} | UNCOUNTED

_TILE = 4
"""Rows that are eliminated together: a whole number of such tiles is a register, or the other way round."""


@njit(**_options)
def width_of(count):  # type: ignore[no-untyped-def]
    """Length of a row of ``count`` numbers: a whole number of packed registers."""
    return -(-count // LANES) * LANES


@njit(**_options)
def multiply(rows, z, out):  # type: ignore[no-untyped-def]
    """Write the products of rows, of the length of ``z`` (width,), with it into ``out``."""
    width, place, whole = z.size, 0, out.size // 4 * 4
    for k in range(0, whole, 4):
        a, b, c, d = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
        for i in range(0, width, LANES):
            here, at = load(z, i), place + i
            a = a + load(rows, at) * here
            b = b + load(rows, at + width) * here
            c = c + load(rows, at + 2 * width) * here
            d = d + load(rows, at + 3 * width) * here
        out[k], out[k + 1], out[k + 2], out[k + 3] = total(a), total(b), total(c), total(d)
        place += 4 * width
    for k in range(whole, out.size):
        a = spread(0.0)
        for i in range(0, width, LANES):
            a = a + load(rows, place + i) * load(z, i)
        out[k] = total(a)
        place += width


@njit(entry=False, **_options)
def add_rows(rows, factors, first, count, out):  # type: ignore[no-untyped-def]
    """Add the first ``count`` rows, as long as ``out``, times the factors from ``first`` on."""
    width, whole = out.size, out.size // (4 * LANES) * (4 * LANES)
    for i in range(0, whole, 4 * LANES):
        a, b, c, d = load(out, i), load(out, i + LANES), load(out, i + 2 * LANES), load(out, i + 3 * LANES)
        at = i
        for k in range(first, first + count):
            factor = spread_from(factors, k)
            a = a + factor * load(rows, at)
            b = b + factor * load(rows, at + LANES)
            c = c + factor * load(rows, at + 2 * LANES)
            d = d + factor * load(rows, at + 3 * LANES)
            at += width
        store(out, i, a)
        store(out, i + LANES, b)
        store(out, i + 2 * LANES, c)
        store(out, i + 3 * LANES, d)
    for i in range(whole, width, LANES):
        a, b, at, paired = load(out, i), spread(0.0), i, first + count // 2 * 2
        for k in range(first, paired, 2):  # two sums, as each waits for its last term
            a = a + spread_from(factors, k) * load(rows, at)
            b = b + spread_from(factors, k + 1) * load(rows, at + width)
            at += 2 * width
        if paired < first + count:
            a = a + spread_from(factors, paired) * load(rows, at)
        store(out, i, a + b)


@njit(entry=False, **_options)
def write_products(known, left, right, count, width, matrix):  # type: ignore[no-untyped-def]
    """Write the sum of ``known`` and products of the first ``count`` rows of ``left`` and of ``right``.

    Of ``known`` and ``matrix`` (width, width), which are flat and may be one, the lower triangle counts: what the
    matrix has above its diagonal is lost.
    """
    last = count * width
    for i in range(0, width, 4):
        most, j = i + 4, 0
        while j + LANES < most:
            at, other = i * width + j, j
            a, e = load(known, at), load(known, at + LANES)
            b, f = load(known, at + width), load(known, at + width + LANES)
            c, g = load(known, at + 2 * width), load(known, at + 2 * width + LANES)
            d, h = load(known, at + 3 * width), load(known, at + 3 * width + LANES)
            for k in range(i, last + i, width):
                row, more = load(right, other), load(right, other + LANES)
                factor = spread_from(left, k)
                a, e = a + factor * row, e + factor * more
                factor = spread_from(left, k + 1)
                b, f = b + factor * row, f + factor * more
                factor = spread_from(left, k + 2)
                c, g = c + factor * row, g + factor * more
                factor = spread_from(left, k + 3)
                d, h = d + factor * row, h + factor * more
                other += width
            store(matrix, at, a)
            store(matrix, at + LANES, e)
            store(matrix, at + width, b)
            store(matrix, at + width + LANES, f)
            store(matrix, at + 2 * width, c)
            store(matrix, at + 2 * width + LANES, g)
            store(matrix, at + 3 * width, d)
            store(matrix, at + 3 * width + LANES, h)
            j += 2 * LANES
        if j < most:
            _write_tile(known, left, right, count, width, i, j, matrix)


@njit(**_options)
def _write_tile(known, left, right, count, width, i, j, matrix):  # type: ignore[no-untyped-def]
    """The same of four rows from ``i`` and a register from ``j`` on; two sums each, as one waits for its last term."""
    at, other = i * width + j, j
    a, b = load(known, at), load(known, at + width)
    c, d = load(known, at + 2 * width), load(known, at + 3 * width)
    e, f, g, h = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    paired = count // 2 * 2
    for k in range(i, paired * width + i, 2 * width):
        row, more = load(right, other), load(right, other + width)
        a, e = a + spread_from(left, k) * row, e + spread_from(left, k + width) * more
        b, f = b + spread_from(left, k + 1) * row, f + spread_from(left, k + width + 1) * more
        c, g = c + spread_from(left, k + 2) * row, g + spread_from(left, k + width + 2) * more
        d, h = d + spread_from(left, k + 3) * row, h + spread_from(left, k + width + 3) * more
        other += 2 * width
    if paired < count:
        row, k = load(right, other), paired * width + i
        a, b = a + spread_from(left, k) * row, b + spread_from(left, k + 1) * row
        c, d = c + spread_from(left, k + 2) * row, d + spread_from(left, k + 3) * row
    store(matrix, at, a + e)
    store(matrix, at + width, b + f)
    store(matrix, at + 2 * width, c + g)
    store(matrix, at + 3 * width, d + h)


@njit(entry=False, **_options)
def mirror(matrix, width):  # type: ignore[no-untyped-def]
    """Write what ``matrix`` (width, width), which is flat, has below its diagonal above it."""
    for i in range(0, width, LANES):
        for j in range(0, i, LANES):
            transpose(matrix, i * width + j, width, matrix, j * width + i, width)
        for k in range(i, i + LANES):
            for j in range(i, k):
                matrix[j * width + k] = matrix[k * width + j]


@njit(entry=False, **_options)
def factorise(matrix, width, count):  # type: ignore[no-untyped-def]
    """Factorise in place by ``L D L^T``, no pivots exchanged: rows of ``D L^T`` stay, with zeros before the diagonal.

    Of ``matrix`` (width, width), which is flat, the lower triangle of ``count`` rows is read. Returns the number of
    negative pivots, or -1 where one is zero.
    """
    negative = 0
    for i in range(count, width):  # what is beyond the unknowns stays zero
        for j in range(i):
            matrix[i * width + j] = 0.0
        matrix[i * width + i] = 1.0
    mirror(matrix, width)
    for k in range(0, width, _TILE):
        below = _eliminate(matrix, k, width)
        if below < 0:
            return -1
        negative += below
        _update(matrix, k, width)
    return negative


@njit(**_options)
def _eliminate(matrix, k, width):  # type: ignore[no-untyped-def]
    """Eliminate among four rows from ``k`` on; the number of their negative pivots, or -1 where one is zero."""
    begin, a = k // LANES * LANES, k * width
    b, c, d = a + width, a + 2 * width, a + 3 * width
    first, ab, ac, ad = matrix[a + k], matrix[a + k + 1], matrix[a + k + 2], matrix[a + k + 3]
    to_b, to_c, to_d = ab / first, ac / first, ad / first
    second = matrix[b + k + 1] - to_b * ab
    bc, bd = matrix[b + k + 2] - to_b * ac, matrix[b + k + 3] - to_b * ad
    more_c, more_d = bc / second, bd / second
    third = matrix[c + k + 2] - to_c * ac - more_c * bc
    cd = matrix[c + k + 3] - to_c * ad - more_c * bd
    last_d = cd / third
    fourth = matrix[d + k + 3] - to_d * ad - more_d * bd - last_d * cd
    size = abs(first) + abs(second) + abs(third) + abs(fourth)
    if not (min(abs(first), abs(second), abs(third), abs(fourth)) > 0.0 and size < np.inf):
        return -1
    b_a, c_a, d_a = spread(-to_b), spread(-to_c), spread(-to_d)
    c_b, d_b, d_c = spread(-more_c), spread(-more_d), spread(-last_d)
    for j in range(begin, width, LANES):
        one = load(matrix, a + j)
        two = load(matrix, b + j) + b_a * one
        three = load(matrix, c + j) + c_a * one + c_b * two
        four = load(matrix, d + j) + d_a * one + d_b * two + d_c * three
        store(matrix, b + j, two)
        store(matrix, c + j, three)
        store(matrix, d + j, four)
    for i in range(_TILE):
        for j in range(begin, k + i):
            matrix[a + i * width + j] = 0.0
    return int(first < 0.0) + int(second < 0.0) + int(third < 0.0) + int(fourth < 0.0)


@njit(**_options)
def _update(matrix, k, width):  # type: ignore[no-untyped-def]
    """Take the four rows from ``k`` on, eliminated, from the rows below."""
    a = k * width
    b, c, d = a + width, a + 2 * width, a + 3 * width
    over_a, over_b = -1.0 / matrix[a + k], -1.0 / matrix[b + k + 1]
    over_c, over_d = -1.0 / matrix[c + k + 2], -1.0 / matrix[d + k + 3]
    for i in range(k + _TILE, width, 2):
        one, other = i * width, (i + 1) * width
        e, f = spread(over_a * matrix[a + i]), spread(over_b * matrix[b + i])
        g, h = spread(over_c * matrix[c + i]), spread(over_d * matrix[d + i])
        w, x = spread(over_a * matrix[a + i + 1]), spread(over_b * matrix[b + i + 1])
        y, z = spread(over_c * matrix[c + i + 1]), spread(over_d * matrix[d + i + 1])
        for j in range(i // LANES * LANES, width, LANES):
            p, q, r, s = load(matrix, a + j), load(matrix, b + j), load(matrix, c + j), load(matrix, d + j)
            store(matrix, one + j, (load(matrix, one + j) + e * p + f * q) + (g * r + h * s))
            store(matrix, other + j, (load(matrix, other + j) + w * p + x * q) + (y * r + z * s))


@njit(entry=False, **_options)
def solve(factor, vector):  # type: ignore[no-untyped-def]
    """Solve in place, ``vector`` (width,), by the rows that :func:`factorise` has left of a matrix."""
    width = vector.size
    for k in range(0, width, _TILE):
        a = k * width
        b, c, d = a + width, a + 2 * width, a + 3 * width
        over_a, over_b = 1.0 / factor[a + k], 1.0 / factor[b + k + 1]
        over_c, over_d = 1.0 / factor[c + k + 2], 1.0 / factor[d + k + 3]
        one = vector[k]
        scaled = over_a * one
        two = vector[k + 1] - scaled * factor[a + k + 1]
        more = over_b * two
        three = vector[k + 2] - scaled * factor[a + k + 2] - more * factor[b + k + 2]
        further = over_c * three
        four = vector[k + 3] - scaled * factor[a + k + 3] - more * factor[b + k + 3] - further * factor[c + k + 3]
        p, q, r, s = spread(-scaled), spread(-more), spread(-further), spread(-over_d * four)
        for j in range(k // LANES * LANES, width, LANES):
            far = load(vector, j) + p * load(factor, a + j) + q * load(factor, b + j)
            store(vector, j, far + (r * load(factor, c + j) + s * load(factor, d + j)))
        vector[k], vector[k + 1], vector[k + 2], vector[k + 3] = one, two, three, four
    for k in range(width - _TILE, -1, -_TILE):
        a = k * width
        b, c, d = a + width, a + 2 * width, a + 3 * width
        one, two, three, four = vector[k], vector[k + 1], vector[k + 2], vector[k + 3]
        vector[k] = vector[k + 1] = vector[k + 2] = vector[k + 3] = 0.0
        p, q, r, s = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
        for j in range(k // LANES * LANES, width, LANES):
            known = load(vector, j)
            p, q = p + known * load(factor, a + j), q + known * load(factor, b + j)
            r, s = r + known * load(factor, c + j), s + known * load(factor, d + j)
        four = (four - total(s)) / factor[d + k + 3]
        three = (three - total(r) - factor[c + k + 3] * four) / factor[c + k + 2]
        two = (two - total(q) - factor[b + k + 2] * three - factor[b + k + 3] * four) / factor[b + k + 1]
        one = one - total(p) - factor[a + k + 1] * two - factor[a + k + 2] * three - factor[a + k + 3] * four
        vector[k], vector[k + 1], vector[k + 2], vector[k + 3] = one / factor[a + k], two, three, four
