"""Compiled: small complementarity problems, by an exact active set and projected Gauss-Seidel."""

from typing import Any

import numpy as np

from modalshell.kernels.compiler import UNCOUNTED, njit
from modalshell.kernels.packed import LANES, dot, load_first, spread, store_first

_SWEEPS = 30
"""Sweeps of Gauss-Seidel before sets are tried again."""
_SETS = 12
"""Exact sets at most from a guess, and after sweeps; where they cycle, Gauss-Seidel goes on."""
_LONG = 400

_kernel = njit(error_model="numpy", fastmath=False)
_options: dict[str, Any] = {"error_model": "numpy", "fastmath": False} | UNCOUNTED
_plain = njit(**_options)
_contracted = njit(**_options | {"fastmath": {"contract"}})


@_kernel
def _sweep(columns, gaps, forces, most, accuracy):  # type: ignore[no-untyped-def]
    """Sweeps of projected Gauss-Seidel from ``forces`` (k,), changed in place; rows are the matrix's columns."""
    count = gaps.size
    after = np.empty(count)
    for i in range(count):
        after[i] = gaps[i]
    for j in range(count):
        if forces[j] != 0.0:
            for i in range(count):
                after[i] += columns[j, i] * forces[j]
    for _ in range(most):
        change = 0.0
        for i in range(count):
            new = max(0.0, forces[i] - after[i] / columns[i, i])
            if new != forces[i]:
                step = new - forces[i]
                change = max(change, abs(step) * columns[i, i])
                for j in range(count):
                    after[j] += columns[i, j] * step
                forces[i] = new
        if change < accuracy:
            break


@_kernel
def _balanced(matrix, gaps, chosen, size, forces):  # type: ignore[no-untyped-def]
    """Forces (k,) that close the ``size`` chosen gaps, by Cholesky; False where the matrix is not definite."""
    upper, right = np.empty((size, size)), np.empty(size)
    for a in range(size):
        right[a] = -gaps[chosen[a]]
        for b in range(a, size):
            upper[a, b] = matrix[chosen[b], chosen[a]]
    if not factorise(upper):
        return False
    substitute(upper, right)
    forces[:] = 0.0
    for a in range(size):
        forces[chosen[a]] = right[a]
    return True


@_contracted
def factorise(upper):  # type: ignore[no-untyped-def]
    """Factorise ``upper`` (s, s), a symmetric matrix above its diagonal, in place; False where it is not definite.

    Rows of the factor's transpose are taken from all that follow; its diagonal holds reciprocals, and what is below it
    in the same register is overwritten.
    """
    size, flat = upper.shape[0], upper.reshape(-1)
    for a in range(size):
        # A register of the row after the other, and by all that precede.
        for b in range(a // LANES * LANES, size, LANES):
            left, at, c = min(size - b, LANES), a * size + b, 0
            one, two = load_first(flat, at, left), spread(0.0)
            while c + 2 <= a:  # two sums: neither waits for the other
                one = one - spread(upper[c, a]) * load_first(flat, c * size + b, left)
                two = two + spread(upper[c + 1, a]) * load_first(flat, (c + 1) * size + b, left)
                c += 2
            if c < a:
                one = one - spread(upper[c, a]) * load_first(flat, c * size + b, left)
            store_first(flat, at, one - two, left)
        if not upper[a, a] > 0.0:
            return False
        inverse, row = 1.0 / np.sqrt(upper[a, a]), upper[a, a + 1 :]
        for b in range(row.size):
            row[b] *= inverse
        upper[a, a] = inverse
    return True


@_contracted
def substitute(upper, right):  # type: ignore[no-untyped-def]
    """Solve for ``right`` (s,) by a factor of :func:`factorise`, in place."""
    size, flat = right.size, upper.reshape(-1)
    for a in range(size):
        value = right[a] * upper[a, a]
        right[a] = value
        for b in range(a + 1, size, LANES):
            left = min(size - b, LANES)
            lowered = load_first(right, b, left) - load_first(flat, a * size + b, left) * spread(value)
            store_first(right, b, lowered, left)
    for a in range(size - 1, -1, -1):
        known = size - a - 1
        right[a] = (right[a] - dot(flat, a * size + a + 1, right, a + 1, known)) * upper[a, a]


@_kernel
def _solved(columns, gaps, chosen, size, forces):  # type: ignore[no-untyped-def]
    """The same by elimination, of a matrix that is not symmetric; False where it is singular."""
    small, right = np.empty((size, size)), np.empty(size)
    for a in range(size):
        right[a] = -gaps[chosen[a]]
        for b in range(size):
            small[a, b] = columns[chosen[b], chosen[a]]
    if not _eliminated_by_rows(small, right):
        return False
    forces[:] = 0.0
    for a in range(size):
        forces[chosen[a]] = right[a]
    return True


@_plain
def _eliminated_by_rows(matrix, right):  # type: ignore[no-untyped-def]
    """Solve for ``right`` (s,) by the ``matrix`` (s, s), both in place; the largest pivot of each column is taken.

    NumPy's solver takes two seconds to compile.
    """
    for a in range(right.size):
        best = a
        for b in range(a + 1, right.size):
            if abs(matrix[b, a]) > abs(matrix[best, a]):
                best = b
        if not 0.0 < abs(matrix[best, a]) < np.inf:
            return False
        own, other = matrix[a, a:], matrix[best, a:]
        if best != a:
            right[a], right[best] = right[best], right[a]
            for c in range(own.size):
                own[c], other[c] = other[c], own[c]
        for b in range(a + 1, right.size):
            one = matrix[b, a:]
            factor = one[0] / own[0]
            for c in range(own.size):
                one[c] -= factor * own[c]
            right[b] -= factor * right[a]
    for a in range(right.size - 1, -1, -1):
        value = right[a]
        for b in range(a + 1, right.size):
            value -= matrix[a, b] * right[b]
        right[a] = value / matrix[a, a]
    return True


@_kernel
def _settled(columns, gaps, active, forces, accuracy, symmetric):  # type: ignore[no-untyped-def]
    """Exact sets from the ``active`` one (k,), in place, into ``forces`` (k,); whether one repeats."""
    count = gaps.size
    chosen, after = np.empty(count, np.int64), np.empty(count)
    for _ in range(_SETS):
        size = 0
        for i in range(count):
            if active[i]:
                chosen[size] = i
                size += 1
        if symmetric:
            definite = _balanced(columns, gaps, chosen, size, forces)
        else:
            definite = _solved(columns, gaps, chosen, size, forces)
        if not definite:
            return False
        for i in range(count):
            after[i] = gaps[i]
        for a in range(size):
            force = forces[chosen[a]]
            for i in range(count):
                after[i] += columns[chosen[a], i] * force
        same = True
        for i in range(count):
            now = forces[i] > 0.0 if active[i] else after[i] < -accuracy
            same = same and now == active[i]
            active[i] = now
        if same:
            return True
    return False


@_kernel
def complementary(columns, gaps, forces, accuracy, symmetric):  # type: ignore[no-untyped-def]
    """Forces f (k,) >= 0 with ``A f + gaps >= 0`` and one of both zero; in place, from a guess.

    The set of the guess is tried first: where A is positive definite there is one answer. Returns whether an exact set
    was found, else the forces are those of Gauss-Seidel.

    Parameters
    ----------
    columns : ndarray, shape (k, k)
        A transposed.
    gaps, forces : ndarray, shape (k,)
        Gaps without forces, and the guess.
    accuracy : float
        Gap that is none.
    symmetric : bool
        Whether A is symmetric and positive definite.
    """
    active, found = np.empty(forces.size, np.bool_), np.empty(forces.size)
    for turn in range(2):
        pushed = turn > 0
        for i in range(forces.size):
            active[i] = forces[i] > 0.0
            pushed = pushed or active[i]
        if pushed and _settled(columns, gaps, active, found, accuracy, symmetric):
            for i in range(forces.size):
                forces[i] = found[i]
            return True
        _sweep(columns, gaps, forces, _SWEEPS if turn == 0 else _LONG, accuracy)
    return False
