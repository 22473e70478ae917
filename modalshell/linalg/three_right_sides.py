"""Triangular solves with a multifrontal factor for three right sides at once: the coordinates of a surface.

A surface's Laplacian has narrow supernodes, for which calls of the BLAS cost more than their arithmetic.
"""

from __future__ import annotations

from modalshell.core.typing import Array
from modalshell.kernels.compiler import njit
from modalshell.linalg.analysis import Panels


@njit(error_model="numpy", fastmath={"contract", "reassoc", "nsz"})
def solve_three(values: Array, panels: Panels, x: Array, work: Array) -> None:
    """Solve ``L L^T x = b`` in place for permuted right sides (3, N); ``work`` has room for (3, rows)."""
    block, first, row_starts, row_ends, rows, begins = panels
    count = len(first) - 1
    for s in range(count):
        width, height = (first[s + 1] - first[s]) * block, (row_ends[s] - row_starts[s]) * block
        below, start, entries = height - width, first[s] * block, row_starts[s] + first[s + 1] - first[s]
        work[:, :below] = 0.0
        for k in range(width):
            column = begins[s] + k * height
            inverse = 1.0 / values[column + k]
            a, b, c = x[0, start + k] * inverse, x[1, start + k] * inverse, x[2, start + k] * inverse
            x[0, start + k], x[1, start + k], x[2, start + k] = a, b, c
            for i in range(k + 1, width):
                entry = values[column + i]
                x[0, start + i] -= entry * a
                x[1, start + i] -= entry * b
                x[2, start + i] -= entry * c
            column += width
            for i in range(below):
                entry = values[column + i]
                work[0, i] += entry * a
                work[1, i] += entry * b
                work[2, i] += entry * c
        for ib in range(below // block):
            row = rows[entries + ib] * block
            for di in range(block):
                i = ib * block + di
                x[0, row + di] -= work[0, i]
                x[1, row + di] -= work[1, i]
                x[2, row + di] -= work[2, i]
    for s in range(count - 1, -1, -1):
        width, height = (first[s + 1] - first[s]) * block, (row_ends[s] - row_starts[s]) * block
        below, start, entries = height - width, first[s] * block, row_starts[s] + first[s + 1] - first[s]
        for ib in range(below // block):
            row = rows[entries + ib] * block
            for di in range(block):
                i = ib * block + di
                work[0, i], work[1, i], work[2, i] = x[0, row + di], x[1, row + di], x[2, row + di]
        for k in range(width - 1, -1, -1):
            column = begins[s] + k * height
            a, b, c = x[0, start + k], x[1, start + k], x[2, start + k]
            for i in range(k + 1, width):
                entry = values[column + i]
                a -= entry * x[0, start + i]
                b -= entry * x[1, start + i]
                c -= entry * x[2, start + i]
            inverse = 1.0 / values[column + k]
            column += width
            for i in range(below):
                entry = values[column + i]
                a -= entry * work[0, i]
                b -= entry * work[1, i]
                c -= entry * work[2, i]
            x[0, start + k], x[1, start + k], x[2, start + k] = a * inverse, b * inverse, c * inverse
