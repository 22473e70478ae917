"""Compiled: small complementarity problems, by projected Gauss-Seidel and an exact active set; local shapes."""

from __future__ import annotations

import math

import numpy as np

from modalshell.kernels.compiler import njit

SWEEPS = 30
"""Sweeps of Gauss-Seidel before the exact sets."""
_SETS = 30
"""Exact sets at most; where they cycle, Gauss-Seidel goes on."""
_LONG = 400


@njit(fastmath=False)
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


@njit(fastmath=False)
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


@njit(fastmath=False)
def residual_compliance(store, slots, vertices, own, out):  # type: ignore[no-untyped-def]
    """Give way ``out`` (k, k) [m/N] along directions ``own`` (k, 3) at vertices under forces along them.

    ``store[slot]`` (n, 3, 3) is the shape under unit forces on the vertex of a slot; all in the axes at rest.
    """
    for a in range(slots.size):
        for b in range(a, slots.size):
            value = 0.0
            for i in range(3):
                for j in range(3):
                    value += own[a, i] * store[slots[b], vertices[a], i, j] * own[b, j]
            out[a, b] = out[b, a] = value


@njit(fastmath=False)
def local_shape(store, slots, pushes, turns, out):  # type: ignore[no-untyped-def]
    """Displacements ``out`` (n, 3) under ``pushes`` (k, 3) [N] in the axes at rest, turned by vectors (n, 3) [rad]."""
    for v in range(out.shape[0]):
        x, y, z = 0.0, 0.0, 0.0
        for k in range(slots.size):
            shape = store[slots[k], v]
            x += shape[0, 0] * pushes[k, 0] + shape[0, 1] * pushes[k, 1] + shape[0, 2] * pushes[k, 2]
            y += shape[1, 0] * pushes[k, 0] + shape[1, 1] * pushes[k, 1] + shape[1, 2] * pushes[k, 2]
            z += shape[2, 0] * pushes[k, 0] + shape[2, 1] * pushes[k, 1] + shape[2, 2] * pushes[k, 2]
        a, b, c = turns[v, 0], turns[v, 1], turns[v, 2]
        angle = math.sqrt(a * a + b * b + c * c)
        cosine = math.cos(angle)
        sine = math.sin(angle) / angle if angle > 0.0 else 1.0
        rest = (1.0 - cosine) / (angle * angle) * (a * x + b * y + c * z) if angle > 0.0 else 0.0
        out[v, 0] = cosine * x + sine * (b * z - c * y) + rest * a
        out[v, 1] = cosine * y + sine * (c * x - a * z) + rest * b
        out[v, 2] = cosine * z + sine * (a * y - b * x) + rest * c
