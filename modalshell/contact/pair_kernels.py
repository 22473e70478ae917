"""Compiled: nearest points of a vertex and a triangle, or of two edges, and the barrier of their distance.

A pair has four vertices: a vertex and the corners of a triangle, or the ends of two edges. With their weights c at the
nearest points, the distance is the length of ``r = sum_i c_i x_i``. Within a triangle or an edge the nearest point may
move, which changes the weights along ``directions`` d_a; at a corner or an end it may not. As the points are nearest,
the square ``u = r.r`` has the gradient ``2 c_i r``, and the second derivatives
``2 c_i c_j I - 2 sum_a q_ai q_aj^T / t_a.t_a`` with ``t_a = sum_i d_ai x_i`` and ``q_ai = c_i t_a + d_ai r``, for
directions whose t are at right angles.
"""

import math

import numpy as np

from modalshell.kernels.compiler import njit

_kernel = njit(error_model="numpy", fastmath=False)
_inline = njit(error_model="numpy", fastmath=False, forceinline=True)

_PARALLEL = 1e-12
"""Square of the sine of the angle of two edges below which they are taken as parallel."""


@_inline
def _dot(x, i, j, k, m):  # type: ignore[no-untyped-def]
    """``(x_i - x_j).(x_k - x_m)``."""
    return (
        (x[i, 0] - x[j, 0]) * (x[k, 0] - x[m, 0])
        + (x[i, 1] - x[j, 1]) * (x[k, 1] - x[m, 1])
        + (x[i, 2] - x[j, 2]) * (x[k, 2] - x[m, 2])
    )


@_kernel
def _of_triangle(x, p, a, b, c, weights, directions):  # type: ignore[no-untyped-def]
    """Of a vertex and a triangle [ericson2005, section 5.1.5]; the number of directions."""
    d1, d2 = _dot(x, b, a, p, a), _dot(x, c, a, p, a)
    d3, d4 = _dot(x, b, a, p, b), _dot(x, c, a, p, b)
    d5, d6 = _dot(x, b, a, p, c), _dot(x, c, a, p, c)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    along_a, along_b = -1, -1
    u, v, w = 0.0, 0.0, 0.0
    if d1 <= 0.0 and d2 <= 0.0:
        u = 1.0
    elif d3 >= 0.0 and d4 <= d3:
        v = 1.0
    elif d6 >= 0.0 and d5 <= d6:
        w = 1.0
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        along_a, along_b, v = 1, 2, d1 / (d1 - d3)
        u = 1.0 - v
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        along_a, along_b, w = 1, 3, d2 / (d2 - d6)
        u = 1.0 - w
    elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        along_a, along_b, w = 2, 3, (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v = 1.0 - w
    else:
        total = va + vb + vc
        v, w = vb / total, vc / total
        u = 1.0 - v - w
    weights[0], weights[1], weights[2], weights[3] = 1.0, -u, -v, -w
    directions[:] = 0.0
    if along_a > 0:
        directions[0, along_a], directions[0, along_b] = 1.0, -1.0
        return 1
    if u == 1.0 or v == 1.0 or w == 1.0:
        return 0
    # The second side less its part along the first.
    part = _dot(x, c, a, b, a) / _dot(x, b, a, b, a)
    directions[0, 1], directions[0, 2] = 1.0, -1.0
    directions[1, 1], directions[1, 2], directions[1, 3] = 1.0 - part, part, -1.0
    return 2


@_inline
def _within(value):  # type: ignore[no-untyped-def]
    return min(max(value, 0.0), 1.0)


@_kernel
def _of_edges(x, a, b, c, d, weights, directions):  # type: ignore[no-untyped-def]
    """Of two edges [ericson2005, section 5.1.9]; the number of directions."""
    aa, bb, ab = _dot(x, b, a, b, a), _dot(x, d, c, d, c), _dot(x, b, a, d, c)
    first, second = _dot(x, b, a, a, c), _dot(x, d, c, a, c)
    across = aa * bb - ab * ab
    skew = across > _PARALLEL * aa * bb
    s = _within((ab * second - first * bb) / across) if across > 0.0 else 0.0
    t = (ab * s + second) / bb
    if t < 0.0:
        t, s = 0.0, _within(-first / aa)
    elif t > 1.0:
        t, s = 1.0, _within((ab - first) / aa)
    weights[0], weights[1], weights[2], weights[3] = 1.0 - s, s, t - 1.0, -t
    directions[:] = 0.0
    count = 0
    if 0.0 < t < 1.0:
        directions[0, 2], directions[0, 3] = 1.0, -1.0
        count = 1
        if skew and 0.0 < s < 1.0:
            part = ab / bb
            directions[1, 0], directions[1, 1] = -1.0, 1.0
            directions[1, 2], directions[1, 3] = part, -part
            count = 2
    elif 0.0 < s < 1.0:
        directions[0, 0], directions[0, 1] = -1.0, 1.0
        count = 1
    return count


@_kernel
def nearest(x, pair, faced, weights, directions, way):  # type: ignore[no-untyped-def]
    """Weights (4,), directions (2, 4) and way r (3,) of a pair at x (n, 3), ``faced`` if of a vertex and a triangle.

    Returns the number of directions, and ``r.r``.
    """
    i, j, k, m = pair[0], pair[1], pair[2], pair[3]
    if faced:
        count = _of_triangle(x, i, j, k, m, weights, directions)
    else:
        count = _of_edges(x, i, j, k, m, weights, directions)
    square = 0.0
    for axis in range(3):
        # Differences before weights: those of a vertex far from the origin lose digits.
        if faced:
            own = x[i, axis]
            r = weights[1] * (x[j, axis] - own) + weights[2] * (x[k, axis] - own) + weights[3] * (x[m, axis] - own)
        else:
            r = (x[i, axis] - x[k, axis]) + weights[1] * (x[j, axis] - x[i, axis])
            r += weights[3] * (x[m, axis] - x[k, axis])
        way[axis] = r
        square += r * r
    return count, square


@_inline
def _length(move, i):  # type: ignore[no-untyped-def]
    return move[i, 0] * move[i, 0] + move[i, 1] * move[i, 1] + move[i, 2] * move[i, 2]


@_kernel
def relative(x, moved, pair, faced, move):  # type: ignore[no-untyped-def]
    """How much distance a pair loses at most from x to ``moved``, both (n, 3); the ``move`` (4, 3) less its mean."""
    for axis in range(3):
        mean = 0.0
        for i in range(4):
            move[i, axis] = moved[pair[i], axis] - x[pair[i], axis]
            mean += 0.25 * move[i, axis]
        for i in range(4):
            move[i, axis] -= mean
    other = max(_length(move, 2), _length(move, 3))
    if faced:
        return math.sqrt(_length(move, 0)) + math.sqrt(max(_length(move, 1), other))
    return math.sqrt(max(_length(move, 0), _length(move, 1))) + math.sqrt(other)


@_inline
def _mollifier(x, pair, limit):  # type: ignore[no-untyped-def]
    """Factor on the barrier of two edges that are nearly parallel [li2020], its derivatives by q, and q."""
    aa, bb = _dot(x, pair[1], pair[0], pair[1], pair[0]), _dot(x, pair[3], pair[2], pair[3], pair[2])
    ab = _dot(x, pair[1], pair[0], pair[3], pair[2])
    share = max(aa * bb - ab * ab, 0.0) / limit
    if share >= 1.0:
        return 1.0, 0.0, 0.0, aa, bb, ab
    return (2.0 - share) * share, 2.0 * (1.0 - share) / limit, -2.0 / (limit * limit), aa, bb, ab


@_inline
def _barrier(square, gap):  # type: ignore[no-untyped-def]
    """The barrier ``-gap (u / gap^2 - 1)^2 ln(u / gap^2)`` of a squared distance u, and its derivatives by u."""
    end = gap * gap
    ratio = square / end
    log, left = math.log(ratio), ratio - 1.0
    value = -gap * left * left * log
    slope = -gap * (2.0 * left * log + left * left / ratio) / end
    curvature = -gap * (2.0 * log + 4.0 * left / ratio - left * left / (ratio * ratio)) / (end * end)
    return value, slope, curvature


@_kernel
def _crossed(x, pair, aa, bb, ab, slopes):  # type: ignore[no-untyped-def]
    """Gradients ``slopes`` (4, 3) of the square q of the cross product of two edges."""
    for axis in range(3):
        a, b = x[pair[1], axis] - x[pair[0], axis], x[pair[3], axis] - x[pair[2], axis]
        slopes[1, axis] = 2.0 * (bb * a - ab * b)
        slopes[3, axis] = 2.0 * (aa * b - ab * a)
        slopes[0, axis], slopes[2, axis] = -slopes[1, axis], -slopes[3, axis]


@_kernel
def energy_gradient(x, pairs, faced, areas, limits, gap, gradient, active):  # type: ignore[no-untyped-def]
    """Barrier energy over its stiffness, of pairs nearer than the gap.

    The first ``faced`` of pairs (p, 4) are those of vertices and triangles. The ``gradient`` (n, 3) is added to, and
    the pairs are written into ``active`` (p,). Returns the energy, their number, and the least squared distance.
    """
    weights, directions, way, slopes = np.empty(4), np.empty((2, 4)), np.empty(3), np.empty((4, 3))
    end, total, found, least = gap * gap, 0.0, 0, np.inf
    for p in range(len(pairs)):
        pair = pairs[p]
        _, square = nearest(x, pair, p < faced, weights, directions, way)
        if not square < end:
            continue
        active[found] = p
        found += 1
        least = min(least, square)
        value, slope, _ = _barrier(square, gap)
        factor, turned = 1.0, 0.0
        if p >= faced:
            factor, turned, _, aa, bb, ab = _mollifier(x, pair, limits[p])
            if turned > 0.0:
                _crossed(x, pair, aa, bb, ab, slopes)
        total += areas[p] * factor * value
        along = 2.0 * areas[p] * factor * slope
        for i in range(4):
            for axis in range(3):
                part = along * weights[i] * way[axis]
                if turned > 0.0:
                    part += areas[p] * turned * value * slopes[i, axis]
                gradient[pair[i], axis] += part
    return total, found, least


@_kernel
def _place(data, slots, strides, pair, blocks):  # type: ignore[no-untyped-def]
    """Add blocks (4, 4, 3, 3), those below the diagonal left out, to the entries of a pattern."""
    for i in range(4):
        for j in range(i, 4):
            low, high = slots[i, j], slots[j, i]
            for row in range(3):
                at = low + row * strides[pair[i]]
                for column in range(3):
                    data[at + column] += blocks[i, j, row, column]
            if i != j:
                for row in range(3):
                    at = high + row * strides[pair[j]]
                    for column in range(3):
                        data[at + column] += blocks[i, j, column, row]


@_kernel
def _add_turned(x, pair, terms, slopes, pull, blocks):  # type: ignore[no-untyped-def]
    """Add to a pair's blocks what the mollifier adds to the second derivatives."""
    value, slope, turned, bent, aa, bb, ab = terms
    for i in range(4):
        for j in range(i, 4):
            sign = 1.0 if (i + j) % 2 == 0 else -1.0
            for row in range(3):
                a, b = x[pair[1], row] - x[pair[0], row], x[pair[3], row] - x[pair[2], row]
                for column in range(3):
                    unit = 1.0 if row == column else 0.0
                    c, d = x[pair[1], column] - x[pair[0], column], x[pair[3], column] - x[pair[2], column]
                    if j < 2:
                        second = bb * unit - b * d
                    elif i > 1:
                        second = aa * unit - a * c
                    else:
                        second = 2.0 * a * d - b * c - ab * unit
                    part = 2.0 * sign * turned * value * second
                    part += bent * value * slopes[i, row] * slopes[j, column]
                    part += turned * slope * (pull[i, row] * slopes[j, column] + slopes[i, row] * pull[j, column])
                    blocks[i, j, row, column] += part


@_inline
def _add_square(factor, vector, blocks):  # type: ignore[no-untyped-def]
    """Add a factor times the square of a vector (4, 3) to blocks, those below the diagonal left out."""
    for i in range(4):
        for j in range(i, 4):
            for row in range(3):
                part = factor * vector[i, row]
                for column in range(3):
                    blocks[i, j, row, column] += part * vector[j, column]


@_kernel
def _add_across(across, count, own, room, blocks):  # type: ignore[no-untyped-def]
    """Add ``across (c c^T I - sum_a q_a q_a^T / t_a.t_a)`` of a pair at ``own`` (4, 3) to its blocks."""
    weights, directions, way = room
    vector, side = np.empty((4, 3)), np.empty(3)
    for i in range(4):
        for j in range(i, 4):
            for axis in range(3):
                blocks[i, j, axis, axis] += across * weights[i] * weights[j]
    for a in range(count):
        length = 0.0
        for axis in range(3):
            side[axis] = 0.0
            for i in range(4):
                side[axis] += directions[a, i] * own[i, axis]
            length += side[axis] * side[axis]
        for i in range(4):
            for axis in range(3):
                vector[i, axis] = weights[i] * side[axis] + directions[a, i] * way[axis]
        _add_square(-across / length, vector, blocks)


@_kernel
def add_hessian(  # type: ignore[no-untyped-def]
    x, pairs, faced, areas, limits, gap, active, exactly, slots, strides, data
):
    """Add the second derivatives of the ``active`` (a,) pairs' energies, times ``areas`` (p,), to a pattern's entries.

    Unless ``exactly``, those of each pair are the part ``b'' grad d grad d^T`` by its distance d, which is positive.
    ``slots`` (a, 4, 4) say where its blocks begin, ``strides`` (n,) how long rows are.
    """
    room = weights, directions, way = np.empty(4), np.empty((2, 4)), np.empty(3)
    own, slopes, pull, blocks = np.empty((4, 3)), np.empty((4, 3)), np.empty((4, 3)), np.empty((4, 4, 3, 3))
    for index in range(active.size):
        p = active[index]
        pair, area = pairs[p], areas[p]
        count, square = nearest(x, pair, p < faced, weights, directions, way)
        value, slope, curvature = _barrier(square, gap)
        factor, turned, bent, aa, bb, ab = 1.0, 0.0, 0.0, 0.0, 0.0, 0.0
        if p >= faced:
            factor, turned, bent, aa, bb, ab = _mollifier(x, pair, limits[p])
        for i in range(4):
            for axis in range(3):
                own[i, axis] = x[pair[i], axis]
                pull[i, axis] = 2.0 * weights[i] * way[axis]
        blocks[:] = 0.0
        _add_square(area * factor * (curvature + (0.0 if exactly else 0.5 * slope / square)), pull, blocks)
        if exactly:
            _add_across(2.0 * area * factor * slope, count, own, room, blocks)
            if turned > 0.0:
                _crossed(x, pair, aa, bb, ab, slopes)
                terms = area * value, area * slope, turned, bent, aa, bb, ab
                _add_turned(x, pair, terms, slopes, pull, blocks)
        _place(data, slots[index], strides, pair, blocks)


@_kernel
def rubbing(x, pairs, active, faced, areas, limits, gap, weights, normals, forces):  # type: ignore[no-untyped-def]
    """Weights (a, 4), normals (a, 3) and forces (a,) of the ``active`` pairs at x (n, 3), by which they will rub.

    Forces are the barrier's slopes by the distance times ``areas`` (p,); none between edges that are nearly parallel.
    """
    directions = np.empty((2, 4))
    for index in range(active.size):
        p = active[index]
        pair = pairs[p]
        _, square = nearest(x, pair, p < faced, weights[index], directions, normals[index])
        distance = math.sqrt(square)
        normals[index] /= distance
        forces[index] = -2.0 * areas[p] * distance * _barrier(square, gap)[1]
        if p >= faced and _mollifier(x, pair, limits[p])[0] < 1.0:
            forces[index] = 0.0
