"""Compiled: small linear complementarity problems, by projected Gauss-Seidel and then an exact active set."""

from __future__ import annotations

import numpy as np

from modalshell.kernels.compiler import njit

SWEEPS = 30
"""Sweeps of Gauss-Seidel before the exact sets."""
_SETS = 30
"""Exact sets at most; where they cycle, Gauss-Seidel goes on."""
_LONG = 400


@njit
def _sweep(matrix, gaps, forces, most, accuracy):  # type: ignore[no-untyped-def]
    """Sweeps of projected Gauss-Seidel from ``forces`` (k,), changed in place."""
    count = gaps.size
    for _ in range(most):
        change = 0.0
        for i in range(count):
            rest = gaps[i]
            for j in range(count):
                rest += matrix[i, j] * forces[j]
            new = max(0.0, forces[i] - rest / matrix[i, i])
            change = max(change, abs(new - forces[i]) * matrix[i, i])
            forces[i] = new
        if change < accuracy:
            break


@njit
def complementary(matrix, gaps, forces, accuracy):  # type: ignore[no-untyped-def]
    """Forces f (k,) >= 0 with ``matrix f + gaps >= 0`` and one of both zero; in place, from a guess.

    Returns
    -------
    bool
        Whether an exact set was found, else the forces are those of Gauss-Seidel.
    """
    count = gaps.size
    _sweep(matrix, gaps, forces, SWEEPS, accuracy)
    active = forces > 0.0
    for _ in range(_SETS):
        size = 0
        for i in range(count):
            size += active[i]
        trial = np.zeros(count)
        if size:
            chosen = np.empty(size, np.int64)
            place = 0
            for i in range(count):
                if active[i]:
                    chosen[place] = i
                    place += 1
            small, right = np.empty((size, size)), np.empty(size)
            for a in range(size):
                right[a] = -gaps[chosen[a]]
                for b in range(size):
                    small[a, b] = matrix[chosen[a], chosen[b]]
            found = np.linalg.solve(small, right)
            for a in range(size):
                trial[chosen[a]] = found[a]
        same = True
        for i in range(count):
            rest = gaps[i]
            for j in range(count):
                rest += matrix[i, j] * trial[j]
            now = trial[i] > 0.0 if active[i] else rest < -accuracy
            same = same and now == active[i]
            active[i] = now
        if same:
            forces[:] = trial
            return True
    _sweep(matrix, gaps, forces, _LONG, accuracy)
    return False
