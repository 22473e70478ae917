"""Solves with SuperLU's factor of a symmetric matrix by columns, compiled: its own take two to three times as long."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from modalshell.core.typing import Array
from modalshell.kernels.compiler import njit

_options: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}}


class ColumnFactor(NamedTuple):
    """A factor ``A = P^T L D L^T P``."""

    starts: NDArray[np.int32]
    rows: NDArray[np.int32]
    values: Array
    """L below its unit diagonal, in compressed columns."""
    pivots: Array
    """Diagonal of D; shape (N,)."""
    order: NDArray[np.int32]
    """Unknown that each row of L stands for; shape (N,)."""


def column_factor(factor: Any) -> ColumnFactor | None:
    """The columns of SciPy's SuperLU of a symmetric matrix; None where it took pivots off the diagonal."""
    if not np.array_equal(factor.perm_r, factor.perm_c):
        return None
    lower = factor.L
    lower.sort_indices()
    below = np.ones(lower.nnz, np.bool_)
    below[lower.indptr[:-1]] = False  # the unit diagonal, which is first in its column
    starts = (lower.indptr - np.arange(lower.indptr.size)).astype(np.int32)
    order = np.argsort(factor.perm_c).astype(np.int32)
    return ColumnFactor(starts, lower.indices[below], lower.data[below], factor.U.diagonal(), order)


@njit(**_options)
def solve_rows(starts: Any, rows: Any, values: Any, pivots: Any, order: Any, right: Any, out: Any) -> None:
    """Solve with a :class:`ColumnFactor` for every row of ``right`` (k, N), into ``out``."""
    size = pivots.size
    work = np.empty(size)
    for column in range(right.shape[0]):
        for j in range(size):
            work[j] = right[column, order[j]]
        for j in range(size):
            y = work[j]
            for entry in range(starts[j], starts[j + 1]):
                work[rows[entry]] -= values[entry] * y
        for j in range(size - 1, -1, -1):
            y = work[j] / pivots[j]
            for entry in range(starts[j], starts[j + 1]):
                y -= values[entry] * work[rows[entry]]
            work[j] = y
            out[column, order[j]] = y


@njit(**_options)
def solve_local_rows(
    starts: Any, rows: Any, values: Any, pivots: Any, order: Any, right: Any, out: Any, quiet: Any
) -> None:
    """As :func:`solve_rows`, of rows of ``right`` with few entries and solutions that fall off away from these.

    Below 1e-18 of what the forward half leaves, solutions count as zero: an unknown that nothing drives, whose own and
    whose column's rows are so small, passes on nothing to those below it in the elimination tree, which ``quiet`` (N,)
    marks.
    """
    size = pivots.size
    work = np.empty(size)
    for column in range(right.shape[0]):
        for j in range(size):
            work[j] = right[column, order[j]]
        largest = 0.0
        for j in range(size):
            y = work[j]
            if y != 0.0:
                largest = max(largest, abs(y / pivots[j]))
                for entry in range(starts[j], starts[j + 1]):
                    work[rows[entry]] -= values[entry] * y
        least = 1e-18 * largest
        for j in range(size - 1, -1, -1):
            first, last = starts[j], starts[j + 1]
            quiet[j] = first < last and quiet[rows[first]]
            if not quiet[j]:
                y = work[j] / pivots[j]
                undriven = y == 0.0
                for entry in range(first, last):
                    y -= values[entry] * work[rows[entry]]
                if undriven and abs(y) <= least:
                    loudest = 0.0
                    for entry in range(first, last):
                        loudest = max(loudest, abs(work[rows[entry]]))
                    quiet[j] = loudest <= least
                work[j] = y
            if quiet[j]:
                work[j] = 0.0
            out[column, order[j]] = work[j]


@njit(**_options)
def solve_axes(starts: Any, rows: Any, values: Any, pivots: Any, order: Any, right: Any, out: Any) -> None:
    """Solve with a :class:`ColumnFactor` for the three columns of ``right`` (N, 3), into ``out``.

    What is read of the factor serves all three. Unsigned numbers are not looked at for negative ones.
    """
    size = pivots.size
    work = np.empty((size, 3))
    for j in range(size):
        at = np.uintp(order[j])
        work[j, 0], work[j, 1], work[j, 2] = right[at, 0], right[at, 1], right[at, 2]
    for j in range(size):
        x, y, z = work[j, 0], work[j, 1], work[j, 2]
        for entry in range(starts[j], starts[j + 1]):
            row, value = np.uintp(rows[entry]), values[entry]
            work[row, 0] -= value * x
            work[row, 1] -= value * y
            work[row, 2] -= value * z
    for j in range(size - 1, -1, -1):
        inverse, at = 1.0 / pivots[j], np.uintp(order[j])
        x, y, z = work[j, 0] * inverse, work[j, 1] * inverse, work[j, 2] * inverse
        for entry in range(starts[j], starts[j + 1]):
            row, value = np.uintp(rows[entry]), values[entry]
            x -= value * work[row, 0]
            y -= value * work[row, 1]
            z -= value * work[row, 2]
        work[j, 0], work[j, 1], work[j, 2] = x, y, z
        out[at, 0], out[at, 1], out[at, 2] = x, y, z
