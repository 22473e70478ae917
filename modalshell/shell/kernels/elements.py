"""Shared by the kernels of all elements: vertex forces, 3 x 3 matrix blocks, and positive parts.

Everything is inlined where it is called, so that loops over an element's vertices have constant bounds.
"""

from __future__ import annotations

import math
from typing import Any

from modalshell.kernels.compiler import njit

OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}}
_inlined = njit(inline="always", **OPTIONS)


@_inlined
def principal(angle):  # type: ignore[no-untyped-def]
    """The angle in (-pi, pi] of one that is at most a turn off."""
    if angle > math.pi:
        angle -= 2.0 * math.pi
    elif angle <= -math.pi:
        angle += 2.0 * math.pi
    return angle


@_inlined
def add_forces(stencils, element, vertices, factor, slopes, forces):  # type: ignore[no-untyped-def]
    """Add ``factor slopes`` (unknowns,) to ``forces`` (n, 3), with the reaction on the first vertex."""
    first = stencils[element, 0]
    for vertex in range(1, vertices):
        for axis in range(3):
            entry = factor * slopes[3 * (vertex - 1) + axis]
            forces[stencils[element, vertex], axis] += entry
            forces[first, axis] -= entry


@_inlined
def add_change(stencils, element, vertices, value, slopes, step):  # type: ignore[no-untyped-def]
    """``value + slopes . step``, the step (n, 3) taken against that of the first vertex."""
    first = stencils[element, 0]
    for vertex in range(1, vertices):
        for axis in range(3):
            difference = step[stencils[element, vertex], axis] - step[first, axis]
            value += slopes[3 * (vertex - 1) + axis] * difference
    return value


@_inlined
def keep_rows(sign, counts, factors, squares, firsts, seconds, rows):  # type: ignore[no-untyped-def]
    """Rows r whose ``sum r r^T`` is the part to keep of ``sign`` times ``counts`` (squares, products) of forms.

    Squares are kept where ``sign`` is positive. A product ``m n^T + n m^T`` of orthogonal forms is
    ``((p m + n / p)^2 - (p m - n / p)^2) / 2`` for any p; its projection takes ``p = sqrt(|n| / |m|)``.
    """
    for form in range(counts[0]):
        for k in range(rows.shape[1]):
            rows[form, k] = math.sqrt(factors[form]) * squares[form, k] if sign > 0.0 else 0.0
    for form in range(counts[1]):
        first_size = 0.0
        second_size = 0.0
        for k in range(rows.shape[1]):
            first_size += firsts[form, k] * firsts[form, k]
            second_size += seconds[form, k] * seconds[form, k]
        balance = math.sqrt(0.5 * math.sqrt(second_size / first_size))
        for k in range(rows.shape[1]):
            rows[counts[0] + form, k] = balance * firsts[form, k] + 0.5 * sign / balance * seconds[form, k]


@_inlined
def pack_products(rows, count, unknowns, packed):  # type: ignore[no-untyped-def]
    """Write the lower triangle of ``sum r r^T`` of the first ``count`` rows into ``packed``, row by row."""
    for entry in range(unknowns * (unknowns + 1) // 2):
        packed[entry] = 0.0
    for form in range(count):
        entry = 0
        for row in range(unknowns):
            for column in range(row + 1):
                packed[entry] += rows[form, row] * rows[form, column]
                entry += 1


@_inlined
def add_block(stencils, element, vertices, block, slots, strides, data):  # type: ignore[no-untyped-def]
    """Add an element's matrix to the CSR values ``data``; see ``add_stiffness`` of the generated kernels."""
    for first in range(vertices):
        for second in range(vertices):
            slot = slots[element, first, second]
            if slot < 0:
                continue
            stride = strides[stencils[element, first]]
            for row in range(3):
                for axis in range(3):
                    data[slot + row * stride + axis] += block[3 * first + row, 3 * second + axis]


@_inlined
def fill_block(vertices, stiffness, slopes, tension, packed, block):  # type: ignore[no-untyped-def]
    """Write ``stiffness slopes slopes^T + tension packed``, of unknowns against the first vertex, into ``block``."""
    entry = 0
    for row in range(3 * vertices - 3):
        for column in range(row + 1):
            value = stiffness * slopes[row] * slopes[column] + tension * packed[entry]
            block[3 + row, 3 + column] = value
            block[3 + column, 3 + row] = value
            entry += 1
    # Translation invariance gives the rows and columns of the first vertex.
    for row in range(3, 3 * vertices):
        for axis in range(3):
            value = 0.0
            for vertex in range(1, vertices):
                value -= block[row, 3 * vertex + axis]
            block[row, axis] = value
            block[axis, row] = value
    for row in range(3):
        for axis in range(3):
            value = 0.0
            for vertex in range(1, vertices):
                value -= block[row, 3 * vertex + axis]
            block[row, axis] = value
