"""The rotation between two shapes that keeps an angular momentum, and the sums over vertices that it takes."""

import math

import numpy as np

from modalshell.kernels.compiler import njit
from modalshell.kernels.rotations import coefficients

_kernel = njit(error_model="numpy", fastmath=False)

_NEWTON_LIMIT = 40
"""Newton's iterations at most."""
_ROUNDING = 4e-16
"""Residual, as a share of the shape's second moments, that is rounding."""
_ACCEPTED = 1e-12
"""Residual, as a share of these, at which the momentum counts as kept."""


@_kernel
def exponential(vector, out):  # type: ignore[no-untyped-def]
    """Write the rotation (3, 3) of a rotation vector (3,) into ``out``."""
    x, y, z = vector[0], vector[1], vector[2]
    first, second, _ = coefficients(x, y, z)
    squared = x * x + y * y + z * z
    for i in range(3):
        for j in range(3):
            out[i, j] = second * vector[i] * vector[j]
        out[i, i] += 1.0 - second * squared
    out[0, 1] -= first * z
    out[1, 0] += first * z
    out[0, 2] += first * y
    out[2, 0] -= first * y
    out[1, 2] -= first * x
    out[2, 1] += first * x


@_kernel
def rotation_vector(turn, out):  # type: ignore[no-untyped-def]
    """Write the rotation vector (3,) of a rotation (3, 3), of at most half a turn, into ``out``; by its quaternion."""
    # Four times the square of each part of the quaternion: the largest is divided by.
    trace = turn[0, 0] + turn[1, 1] + turn[2, 2]
    largest, squared = 3, 1.0 + trace
    for i in range(3):
        if 1.0 + 2.0 * turn[i, i] - trace > squared:
            largest, squared = i, 1.0 + 2.0 * turn[i, i] - trace
    scale = 0.5 / math.sqrt(squared)
    scalar = 0.5 * math.sqrt(squared)
    if largest == 3:
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            out[i] = scale * (turn[k, j] - turn[j, k])
    else:
        j, k = (largest + 1) % 3, (largest + 2) % 3
        out[largest] = scalar
        out[j] = scale * (turn[j, largest] + turn[largest, j])
        out[k] = scale * (turn[k, largest] + turn[largest, k])
        scalar = scale * (turn[k, j] - turn[j, k])
    length = math.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2)
    factor = 2.0 * math.atan2(length, abs(scalar)) / length if length > 1e-12 else 2.0
    out *= factor if scalar >= 0.0 else -factor


@_kernel
def _multiply(one, other, out):  # type: ignore[no-untyped-def]
    """Write the product of two matrices (3, 3), by loops: numba's operator brings checks that take long to compile."""
    for i in range(3):
        for j in range(3):
            out[i, j] = one[i, 0] * other[0, j] + one[i, 1] * other[1, j] + one[i, 2] * other[2, j]


@_kernel
def keeping_turn(moments, impulse, guess, turn):  # type: ignore[no-untyped-def]
    """Write into ``turn`` (3, 3) the rotation F with ``sum m a x F b = impulse``; whether there is one, by Newton.

    ``moments`` (3, 3) is ``sum m b a^T``, ``guess`` (3,) a rotation vector near that of F.
    """
    size = 0.0
    for i in range(3):
        for j in range(3):
            size += moments[i, j] ** 2
    size = math.sqrt(size)
    turned, slope, product, change = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    residual, step = np.empty(3), np.empty(3)
    exponential(guess, turn)
    last = math.inf
    for _ in range(_NEWTON_LIMIT):
        _multiply(turn, moments, turned)
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            residual[i] = turned[k, j] - turned[j, k] - impulse[i]
        missed = math.sqrt(residual[0] ** 2 + residual[1] ** 2 + residual[2] ** 2)
        if missed <= _ROUNDING * size or (missed <= _ACCEPTED * size and missed >= 0.5 * last):
            return True
        last = missed
        # A further small turn d changes the sum by (tr(T) I - T) d, T = F moments.
        trace = turned[0, 0] + turned[1, 1] + turned[2, 2]
        for i in range(3):
            for j in range(3):
                slope[i, j] = -turned[i, j]
            slope[i, i] += trace
        # Cramer's rule: a singular matrix gives no finite turn, and no answer.
        determinant, squared = 0.0, 0.0
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            a = slope[1, j] * slope[2, k] - slope[1, k] * slope[2, j]
            b = slope[2, j] * slope[0, k] - slope[2, k] * slope[0, j]
            c = slope[0, j] * slope[1, k] - slope[0, k] * slope[1, j]
            determinant += slope[0, i] * a
            step[i] = -(a * residual[0] + b * residual[1] + c * residual[2])
        if not abs(determinant) > 1e-15 * size**3:
            return False
        for i in range(3):
            step[i] /= determinant
            squared += step[i] ** 2
        if not squared < 1.0:
            return False
        exponential(step, change)
        _multiply(change, turn, product)
        for i in range(3):
            for j in range(3):
                turn[i, j] = product[i, j]
    return last <= _ACCEPTED * size


@_kernel
def keeping_turns(moments, impulses, guesses, turns):  # type: ignore[no-untyped-def]
    """:func:`keeping_turn` of many (B, 3, 3); the guess in place of one that fails."""
    for b in range(moments.shape[0]):
        if not keeping_turn(moments[b], impulses[b], guesses[b], turns[b]):
            exponential(guesses[b], turns[b])
