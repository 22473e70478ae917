"""Inverses of many small matrices, by the operations of NumPy's LAPACK in their order, with its bits in less time.

One call of LAPACK takes far longer than the arithmetic of a matrix of 3 x 3. OpenBLAS factorises one by columns, each
less the products of those before, and multiplies it by the pivot's reciprocal; then it solves for the permuted identity
in a block of n - 1 unknowns and one of 1. Whether products and sums are rounded once or twice depends on the processor
that it was made for. Which of both NumPy does here is asked once, and where it does neither, NumPy is called.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from modalshell.core.typing import Array
from modalshell.kernels.compiler import njit
from modalshell.kernels.packed import fused

_MANY = 200_000
"""Matrices in all from which the kernel is worth being compiled."""
_SIZES = 3, 5
"""Sizes that the kernel knows."""
_SAMPLES = 64
"""Matrices at which NumPy's bits are asked for."""
_SMALLEST, _LARGEST = 1e-300, 1e300
"""Pivots within which LAPACK multiplies by their reciprocals."""


@njit(error_model="numpy", fastmath=False, forceinline=True)
def _factorise(size, a, swaps, reciprocals, once):  # type: ignore[no-untyped-def]
    """LU factors of ``a`` (n, n) in place, row ``swaps`` (n,), pivots' ``reciprocals``; whether these are ordinary."""
    for j in range(size):
        for i in range(j):
            a[i, j], a[swaps[i], j] = a[swaps[i], j], a[i, j]
        for i in range(1, size):
            value = 0.0
            for k in range(min(i, j)):
                value = fused(a[i, k], a[k, j], value) if once else value + a[i, k] * a[k, j]
            a[i, j] -= value
        pivot = j
        for i in range(j + 1, size):
            if abs(a[i, j]) > abs(a[pivot, j]):
                pivot = i
        swaps[j] = pivot
        for k in range(j + 1):
            a[j, k], a[pivot, k] = a[pivot, k], a[j, k]
        if not _SMALLEST < abs(a[j, j]) < _LARGEST:
            return False
        reciprocals[j] = 1.0 / a[j, j]
        for i in range(j + 1, size):
            a[i, j] *= reciprocals[j]
    return True


@njit(error_model="numpy", fastmath=False, forceinline=True)
def _solve(size, a, reciprocals, x, once):  # type: ignore[no-untyped-def]
    """Solve with LU factors ``a`` (n, n) for x (n, n), in place."""
    last = size - 1
    block = size if once else last
    for i in range(block):
        for k in range(i + 1, block):
            for c in range(size):
                x[k, c] = fused(-x[i, c], a[k, i], x[k, c]) if once else x[k, c] - x[i, c] * a[k, i]
    if not once:
        for c in range(size):
            value = 0.0
            for k in range(last):
                value = fused(a[last, k], x[k, c], value)
            x[last, c] -= value
    for i in range(last, -1, -1):
        for c in range(size):
            x[i, c] *= reciprocals[i]
        for k in range(i):
            for c in range(size):
                if once and i < last:
                    x[k, c] = fused(-x[i, c], a[k, i], x[k, c])
                else:
                    x[k, c] -= x[i, c] * a[k, i]


@njit(error_model="numpy", fastmath=False, forceinline=True)
def _inverses(size, matrices, once, out):  # type: ignore[no-untyped-def]
    """As :func:`small_inverses`, of a size that the compiler knows."""
    a, swaps, reciprocals = np.empty((size, size)), np.empty(size, np.int64), np.empty(size)
    for place in range(len(matrices)):
        x = out[place]
        for i in range(size):
            for j in range(size):
                a[i, j], x[i, j] = matrices[place, i, j], 1.0 if i == j else 0.0
        if not _factorise(size, a, swaps, reciprocals, once):
            return False
        for i in range(size):
            for c in range(size):
                x[i, c], x[swaps[i], c] = x[swaps[i], c], x[i, c]
        _solve(size, a, reciprocals, x, once)
    return True


@njit(error_model="numpy", fastmath=False)
def small_inverses(matrices, once, out):  # type: ignore[no-untyped-def]
    """Inverses ``out`` (k, n, n) of matrices (k, n, n), n = 3 or 5; whether all pivots are ordinary numbers.

    Products and sums are rounded ``once``, or each.
    """
    return _inverses(3, matrices, once, out) if matrices.shape[1] == 3 else _inverses(5, matrices, once, out)


@cache
def _rounds_once(size: int) -> bool | None:
    """Whether NumPy rounds products and sums once in inverses (size, size); None where it does something else."""
    matrices = np.random.default_rng(0).standard_normal((_SAMPLES, size, size))
    expected, found = np.linalg.inv(matrices), np.empty(matrices.shape)
    for once in (True, False):
        small_inverses(matrices, once, found)
        if (found == expected).all():
            return once
    return None


def inverses(matrices: Array, of: int) -> Array:
    """Inverses (k, n, n) of matrices (k, n, n), with the bits of ``np.linalg.inv``; LinAlgError of a singular one.

    They are some ``of`` how many there are to be inverted.
    """
    if of >= _MANY and matrices.shape[1] in _SIZES and matrices.dtype == np.float64:
        once, found = _rounds_once(matrices.shape[1]), np.empty(matrices.shape)
        if once is not None and small_inverses(np.ascontiguousarray(matrices), once, found):
            return found
    return np.asarray(np.linalg.inv(matrices))
