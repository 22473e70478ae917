"""Compiled: how far pairs of a vertex and a triangle, or of two edges, may move; and their friction."""

import math

import numpy as np

from modalshell.contact.pair_kernels import nearest, relative
from modalshell.kernels.compiler import njit

_kernel = njit(error_model="numpy", fastmath=False)

_LEFT = 0.1
"""Part of its distance that a pair keeps at least."""


@_kernel
def _passes(place, move, ends):  # type: ignore[no-untyped-def]
    """Whether the boxes around the ways of a pair's first ``ends`` vertices and of its others are apart."""
    for axis in range(3):
        low, high, lower, higher = np.inf, -np.inf, np.inf, -np.inf
        for i in range(4):
            one, other = place[i, axis], place[i, axis] + move[i, axis]
            if i < ends:
                low, high = min(low, one, other), max(high, one, other)
            else:
                lower, higher = min(lower, one, other), max(higher, one, other)
        if low > higher or lower > high:
            return True
    return False


@_kernel
def free_part(x, moved, pairs, faced):  # type: ignore[no-untyped-def]
    """Part of the straight way from x to ``moved``, both (n, 3), on which no pair meets [li2021].

    Each pair moves on by what it would take at least to lose nine tenths of its distance, until a tenth of that at the
    start is left. Pairs whose boxes stay apart, less what all four vertices move by, do not meet.
    """
    weights, directions, way = np.empty(4), np.empty((2, 4)), np.empty(3)
    place, move, own = np.empty((4, 3)), np.empty((4, 3)), np.empty(4, np.int64)
    free = 1.0
    for i in range(4):
        own[i] = i
    for p in range(len(pairs)):
        is_faced = p < faced
        speed = relative(x, moved, pairs[p], is_faced, move)
        for i in range(4):
            for axis in range(3):
                place[i, axis] = x[pairs[p, i], axis]
        if speed == 0.0 or _passes(place, move, 1 if is_faced else 2):
            continue
        _, square = nearest(place, own, is_faced, weights, directions, way)
        distance = math.sqrt(square)
        if distance == 0.0:
            return 0.0
        least, done = _LEFT * distance, 0.0
        while True:
            step = (1.0 - _LEFT) * distance / speed
            for i in range(4):
                for axis in range(3):
                    place[i, axis] += step * move[i, axis]
            distance = math.sqrt(nearest(place, own, is_faced, weights, directions, way)[1])
            if done > 0.0 and distance < least:
                free = done
                break
            done += step
            if done > free:
                break
    return free


@_kernel
def slid(x, begin, pairs, weights, normals, strengths, limit, gradient):  # type: ignore[no-untyped-def]
    """Energy of the friction of pairs (a, 4) that moved from ``begin`` to x, both (n, 3); adds to its gradient (n, 3).

    Its slope by the slip is ``strengths`` (a,) [N] from the slip ``limit`` [m] on, and less below it.
    """
    total, slip = 0.0, np.empty(3)
    for p in range(len(pairs)):
        share = _slip(x, begin, pairs[p], weights[p], normals[p], slip) / limit
        if share < 1.0:
            total += strengths[p] * limit * (share * share - share * share * share / 3.0 + 1.0 / 3.0)
            along = strengths[p] * (2.0 - share) / limit
        else:
            total += strengths[p] * limit * share
            along = strengths[p] / (share * limit)
        for i in range(4):
            for axis in range(3):
                gradient[pairs[p, i], axis] += along * weights[p, i] * slip[axis]
    return total


@_kernel
def _slip(x, begin, pair, weights, normal, slip):  # type: ignore[no-untyped-def]
    """Slip (3,) of a pair across its normal; its length."""
    out = 0.0
    for axis in range(3):
        slip[axis] = 0.0
        for i in range(4):
            slip[axis] += weights[i] * (x[pair[i], axis] - begin[pair[i], axis])
        out += slip[axis] * normal[axis]
    square = 0.0
    for axis in range(3):
        slip[axis] -= out * normal[axis]
        square += slip[axis] * slip[axis]
    return math.sqrt(square)


@_kernel
def add_sliding(  # type: ignore[no-untyped-def]
    x, begin, pairs, weights, normals, strengths, limit, slots, strides, data
):
    """Add the second derivatives of friction's energy to a pattern's entries; see :func:`slid` and ``add_hessian``."""
    slip, own = np.empty(3), np.empty((3, 3))
    for p in range(len(pairs)):
        length = _slip(x, begin, pairs[p], weights[p], normals[p], slip)
        share = length / limit
        across = strengths[p] * ((2.0 - share) / limit if share < 1.0 else 1.0 / length)
        along = strengths[p] * (2.0 - 2.0 * share) / limit if share < 1.0 else 0.0
        turn = (along - across) / (length * length) if length > 0.0 else 0.0
        for row in range(3):
            for column in range(3):
                own[row, column] = -across * normals[p, row] * normals[p, column] + turn * slip[row] * slip[column]
            own[row, row] += across
        for i in range(4):
            for j in range(4):
                both = weights[p, i] * weights[p, j]
                for row in range(3):
                    at = slots[p, i, j] + row * strides[pairs[p, i]]
                    for column in range(3):
                        data[at + column] += both * own[row, column]
