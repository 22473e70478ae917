"""Warp kernels of flocks and crowds: sums over neighbours, positions and modal forces.

The same rules as :mod:`modalshell.crowd.kernels.flock` and :mod:`modalshell.crowd.kernels.instances`, one thread to a
boid and one to a vertex of an instance. Imported only where a device is asked for: Warp is an optional dependency. No
``from __future__ import annotations`` here, since Warp reads the annotations.
"""

from typing import Any

import warp as wp

from modalshell.crowd.kernels.instances import LINEAR, RIGID
from modalshell.kernels.rotations import _EVEN, _ODD

_TERMS = len(_EVEN)
_SERIES = wp.types.vector(2 * _TERMS, wp.float64)
_POWERS = wp.constant(_SERIES(*_EVEN, *_ODD))
_RIGID, _LINEAR = wp.constant(RIGID), wp.constant(LINEAR)


@wp.kernel(enable_backward=False)
def gather_places(
    bits: int,
    keys: wp.array[int],
    starts: wp.array[int],
    order: wp.array[int],
    positions: wp.array[Any],
    directions: wp.array[Any],
    reach: Any,
    cosine: Any,
    sums: wp.array2d[Any],
) -> None:
    """Sums (N, 10) of every boid; ``positions`` and ``directions`` are vectors (N,) in the order of the places.

    ``keys``, ``starts`` and ``order`` are those of :func:`modalshell.crowd.kernels.flock.sort_by_cell`. Threads that
    follow each other look at the same cells.
    """
    place = wp.tid()
    boid = order[place]
    here = positions[place]
    heading = directions[place]
    key = keys[boid]
    mask = (1 << bits) - 1
    a = key >> (2 * bits)
    b = (key >> bits) & mask
    c = key & mask
    zero = reach - reach
    one = reach / reach
    separation = zero * heading
    alignment = zero * heading
    middle = zero * heading
    neighbours = zero + zero
    for around in range(27):  # one loop, since Warp would unroll three of three turns
        da = around // 9 - 1
        db = (around // 3) % 3 - 1
        dc = around % 3 - 1
        cell = (((((a + da) & mask) << bits) | ((b + db) & mask)) << bits) | ((c + dc) & mask)
        for other in range(starts[cell], starts[cell + 1]):
            offset = positions[other] - here
            squared = wp.dot(offset, offset)
            if not squared >= reach * reach and squared != zero:  # so that NaN goes on and shows
                distance = wp.sqrt(squared)
                if not wp.dot(heading, offset) < cosine * distance:
                    separation += (one / reach - one / distance) * offset
                    alignment += directions[other]
                    middle += positions[other]
                    neighbours += one
    for axis in range(3):
        sums[boid, axis] = separation[axis]
        sums[boid, 3 + axis] = alignment[axis]
        sums[boid, 6 + axis] = middle[axis]
    sums[boid, 9] = neighbours


@wp.func
def coefficients(squared: Any) -> Any:
    """c2 and c3 of a rotation vector of length squared: by their series below a radian, in closed form above."""
    second = type(squared)(_POWERS[0])
    third = type(squared)(_POWERS[_TERMS])
    if squared < type(squared)(1.0):
        for k in range(1, _TERMS):
            second = second * squared + type(squared)(_POWERS[k])
            third = third * squared + type(squared)(_POWERS[_TERMS + k])
    else:
        half = type(squared)(0.5)
        angle = wp.sqrt(squared)
        sine = wp.sin(half * angle)
        second = sine * sine / (half * squared)
        third = (angle - wp.sin(angle)) / (squared * angle)
    return second, third


@wp.func
def modal_sum(q: wp.array2d[Any], b: int, shape: wp.array2d[Any], i: int) -> Any:
    """``sum_k q_k shape_k`` of instance b at vertex i, for ``shape`` vectors (m, n)."""
    total = q[b, 0] * shape[0, i]
    for k in range(1, q.shape[1]):
        total += q[b, k] * shape[k, i]
    return total


@wp.kernel(enable_backward=False)
def crowd_positions(
    levels: wp.array[int],
    modes: wp.array2d[Any],
    rotations: wp.array2d[Any],
    rest: wp.array[Any],
    q: wp.array2d[Any],
    turns: wp.array2d[Any],
    moves: wp.array[Any],
    out: wp.array2d[Any],
) -> None:
    """``out_b = R_b (rest + u_b) + t_b``, vectors (B, n), of all instances b, each with u at its level, at q (B, m).

    ``modes`` and ``rotations`` are vectors (m, n); ``turns`` (B, 3) are the rows of R and ``moves`` (B,) are t.
    """
    b, i = wp.tid()
    level = levels[b]
    place = rest[i]
    if level != _RIGID:
        u = modal_sum(q, b, modes, i)
        if level != _LINEAR:
            w = modal_sum(q, b, rotations, i)
            second, third = coefficients(wp.dot(w, w))
            across = wp.cross(w, u)
            u = u + second * across + third * wp.cross(w, across)
        place = place + u
    turned = moves[b]
    for axis in range(3):
        turned[axis] = turned[axis] + wp.dot(turns[b, axis], place)
    out[b, i] = turned


@wp.kernel(enable_backward=False)
def part_means(labels: wp.array[int], shares: wp.array[Any], places: wp.array2d[Any], means: wp.array2d[Any]) -> None:
    """Means (B, P) of the vertices of each part, by shares (n,) of its mass; ``places`` are vectors (B, n)."""
    b, part = wp.tid()
    total = shares[0] * (places[b, 0] - places[b, 0])
    for i in range(places.shape[1]):
        if labels[i] == part:
            total += shares[i] * places[b, i]
    means[b, part] = total


@wp.kernel(enable_backward=False)
def place_parts(
    labels: wp.array[int],
    means: wp.array2d[Any],
    turns: wp.array3d[Any],
    moves: wp.array2d[Any],
    places: wp.array2d[Any],
) -> None:
    """``R (x - mean) + t`` in the place of each x (B, n), with R (B, P + 1, 3), by rows, and t (B, P + 1) of its part.

    Vertices of the last have no mean.
    """
    b, i = wp.tid()
    part = labels[i]
    place = places[b, i]
    if part < means.shape[1]:
        place = place - means[b, part]
    turned = moves[b, part]
    for axis in range(3):
        turned[axis] = turned[axis] + wp.dot(turns[b, part, axis], place)
    places[b, i] = turned


@wp.kernel(enable_backward=False)
def turned_back(
    levels: wp.array[int],
    rotations: wp.array2d[Any],
    mass: wp.array[Any],
    q: wp.array2d[Any],
    felt: wp.array2d[Any],
    out: wp.array2d[Any],
) -> None:
    """``mass_i R(w)^T felt_b``, vectors (B, n), of all instances b: with no turn where the level is below MWTS.

    ``felt`` are vectors (B, 1), or (B, n), one for each vertex.
    """
    b, i = wp.tid()
    force = mass[i] * felt[b, i % felt.shape[1]]
    if levels[b] > _LINEAR:
        w = modal_sum(q, b, rotations, i)
        squared = wp.dot(w, w)
        second, third = coefficients(squared)
        across = wp.cross(w, force)
        first = type(squared)(1.0) - squared * third
        force = force - first * across + second * wp.cross(w, across)
    out[b, i] = force


@wp.kernel(enable_backward=False)
def modal_forces(modes: wp.array2d[Any], forces: wp.array2d[Any], out: wp.array2d[Any]) -> None:
    """``Phi^T f_b`` (B, m) of forces (B, n): always summed in the same order."""
    b, k = wp.tid()
    total = wp.dot(modes[k, 0], forces[b, 0])
    for i in range(1, forces.shape[1]):
        total += wp.dot(modes[k, i], forces[b, i])
    out[b, k] = total


# Both precisions at once: Warp would compile the whole file anew for each that it comes across.
for _real in (wp.float64, wp.float32):
    _vector = wp.types.vector(3, _real)
    _list, _table = wp.array(dtype=_vector), wp.array(dtype=_vector, ndim=2)
    _row, _numbers = wp.array(dtype=_real), wp.array(dtype=_real, ndim=2)
    wp.overload(
        gather_places, {"positions": _list, "directions": _list, "reach": _real, "cosine": _real, "sums": _numbers}
    )
    wp.overload(
        crowd_positions,
        {
            "modes": _table,
            "rotations": _table,
            "rest": _list,
            "q": _numbers,
            "turns": _table,
            "moves": _list,
            "out": _table,
        },
    )
    wp.overload(part_means, {"shares": _row, "places": _table, "means": _table})
    _rows = wp.array(dtype=_vector, ndim=3)
    wp.overload(place_parts, {"means": _table, "turns": _rows, "moves": _table, "places": _table})
    if _real == wp.float64:  # coordinates are stepped in no other
        _back = {"rotations": _table, "mass": _row, "q": _numbers, "felt": _table, "out": _table}
        wp.overload(turned_back, _back)
        wp.overload(modal_forces, {"modes": _table, "forces": _table, "out": _numbers})
