"""Compiled bending of a reduced energy: angles of hinges that are bent at rest, and what couples them.

Vectors over coordinates are rows of a whole number of packed registers, ``width`` long and padded with zeros.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from modalshell.core.typing import Array
from modalshell.kernels.compiler import COUNTED, UNCOUNTED, njit
from modalshell.kernels.packed import LANES, load, spread, spread_from, store, total
from modalshell.shell.kernels.generated.flexure import first_derivatives

_options: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "nsz"}, "nogil": True} | UNCOUNTED


class Room(NamedTuple):
    """What kernels write to on their way: sums over the numbers of quadratic forms, and of bent hinges.

    Of these the positions of their vertices (3 S,) and forces there, the slopes of an angle, and the constant vectors
    ``P_h z`` (3 H,).
    """

    products: Array
    values: Array
    points: Array
    forces: Array
    local: Array
    pulls: Array


@njit(**_options | COUNTED)
def make_room(count, modes, vertices, hinges):  # type: ignore[no-untyped-def]
    """Room for ``count`` coordinates, rows of ``modes`` numbers, and ``hinges`` bent ones on ``vertices``."""
    return Room(
        np.empty(count * modes), np.empty(modes), np.empty(3 * vertices), np.empty(3 * vertices), np.empty(9),
        np.empty(3 * hinges),
    )  # fmt: skip


@njit(**_options)
def multiply(rows, z, out):  # type: ignore[no-untyped-def]
    """Write the products of rows, of the length of ``z`` (width,), with it into ``out``."""
    width, place, whole = z.size, 0, out.size // 3 * 3
    for k in range(0, whole, 3):
        here = load(z, 0)
        a, b, c = load(rows, place) * here, load(rows, place + width) * here, load(rows, place + 2 * width) * here
        for i in range(LANES, width, LANES):
            here, at = load(z, i), place + i
            a = a + load(rows, at) * here
            b = b + load(rows, at + width) * here
            c = c + load(rows, at + 2 * width) * here
        out[k], out[k + 1], out[k + 2] = total(a), total(b), total(c)
        place += 3 * width
    for k in range(whole, out.size):
        a = load(rows, place) * load(z, 0)
        for i in range(LANES, width, LANES):
            a = a + load(rows, place + i) * load(z, i)
        out[k] = total(a)
        place += width


@njit(entry=False, **_options)
def hinge_angles(bending, z, first, strains, slopes, room):  # type: ignore[no-untyped-def]
    """Write the angles' changes and their slopes, times the roots of their weights, from the ``first`` row on.

    ``z`` (width,) are the coordinates, ``slopes`` rows of that length, flat. The room gets the hinges' positions.
    """
    width, modes, x, local = z.size, bending.modes.reshape(-1), room.points, room.local
    rest = bending.rest.reshape(-1)
    multiply(modes, z, x)
    for k in range(x.size):
        x[k] += rest[k]
    for h in range(bending.hinges.shape[0]):
        a, b, c, d = _corners(bending, h)
        angle = first_derivatives(
            x[b] - x[a], x[b + 1] - x[a + 1], x[b + 2] - x[a + 2],
            x[c] - x[a], x[c + 1] - x[a + 1], x[c + 2] - x[a + 2],
            x[d] - x[a], x[d + 1] - x[a + 1], x[d + 2] - x[a + 2], local,
        )  # fmt: skip
        root, row = bending.roots[h], (first + h) * width
        change = angle - bending.angles[h]
        if abs(change) > np.pi:
            change -= np.copysign(2.0 * np.pi, change)
        strains[first + h] = root * change
        for i in range(0, width, LANES):
            to_a, to_b, to_c, to_d = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
            for axis in range(3):
                p, q, r = root * local[axis], root * local[3 + axis], root * local[6 + axis]
                to_b = to_b + spread(p) * load(modes, (b + axis) * width + i)
                to_c = to_c + spread(q) * load(modes, (c + axis) * width + i)
                to_d = to_d + spread(r) * load(modes, (d + axis) * width + i)
                to_a = to_a + spread(p + q + r) * load(modes, (a + axis) * width + i)
            store(slopes, row + i, (to_b + to_c) + (to_d - to_a))


_X, _Y, _Z = np.int64(0), np.int64(1), np.int64(2)
"""Components. Of a number that is written out where a kernel is called numba compiles this once for each."""
FIRST = _X
"""The first of some rows, alike."""


@njit(**_options)
def _corners(bending, h):  # type: ignore[no-untyped-def]
    """Where the positions of a hinge's vertices begin."""
    stencil = bending.hinges
    return 3 * stencil[h, 0], 3 * stencil[h, 1], 3 * stencil[h, 2], 3 * stencil[h, 3]


@njit(**_options)
def _pull(bending, x, pulls, bent, h, forces):  # type: ignore[no-untyped-def]
    """The unit mean normal of a hinge, and the work on it of its vector in ``pulls``; ``bent`` times its forces.

    The normal is that of the plane of the edge and of the way from one side to the other, by feet and heights at rest,
    which halves the fold. The gradient of the work is added to the ``forces`` on the hinge's vertices.
    """
    a, b, c, d = _corners(bending, h)
    foot, height = bending.feet[h, 0], bending.feet[h, 1]
    other_foot, other_height = bending.feet[h, 2], bending.feet[h, 3]
    ex, ey, ez = x[b] - x[a], x[b + 1] - x[a + 1], x[b + 2] - x[a + 2]
    wx = (x[d] - x[a] - other_foot * ex) * other_height - (x[c] - x[a] - foot * ex) * height
    wy = (x[d + 1] - x[a + 1] - other_foot * ey) * other_height - (x[c + 1] - x[a + 1] - foot * ey) * height
    wz = (x[d + 2] - x[a + 2] - other_foot * ez) * other_height - (x[c + 2] - x[a + 2] - foot * ez) * height
    nx, ny, nz = ey * wz - ez * wy, ez * wx - ex * wz, ex * wy - ey * wx
    over = 1.0 / np.sqrt(nx * nx + ny * ny + nz * nz)
    nx, ny, nz = over * nx, over * ny, over * nz
    px, py, pz = pulls[3 * h], pulls[3 * h + 1], pulls[3 * h + 2]
    work = px * nx + py * ny + pz * nz
    scale = bent * over
    px, py, pz = scale * (px - work * nx), scale * (py - work * ny), scale * (pz - work * nz)
    _push(forces, a, b, c, d, _X, wy * pz - wz * py, py * ez - pz * ey, foot, height, other_foot, other_height)
    _push(forces, a, b, c, d, _Y, wz * px - wx * pz, pz * ex - px * ez, foot, height, other_foot, other_height)
    _push(forces, a, b, c, d, _Z, wx * py - wy * px, px * ey - py * ex, foot, height, other_foot, other_height)
    return nx, ny, nz, work


@njit(**_options)
def _push(forces, a, b, c, d, axis, on_edge, on_way, foot, height, other_foot, other_height):  # type: ignore[no-untyped-def]
    """Add one component of the forces on a hinge's vertices, of those on its edge and on the way across it."""
    here, there = -on_way * height, on_way * other_height
    forces[c + axis] += here
    forces[d + axis] += there
    on_edge -= foot * here + other_foot * there
    forces[b + axis] += on_edge
    forces[a + axis] -= on_edge + here + there


@njit(**_options)
def couple(bending, z, first, strains, slopes, others, gradient, room):  # type: ignore[no-untyped-def]
    """Add what couples bent hinges to the ``gradient``; write the rows of ``others`` that their slopes are coupled to.

    Returns the energy. The normals' turning is in the gradient alone.
    """
    width, value, across = z.size, 0.0, bending.across.reshape(-1)
    forces, pulls = room.forces, room.pulls
    for k in range(forces.size):
        forces[k] = 0.0
    multiply(across, z, pulls)
    for h in range(bending.across.shape[0]):
        bent, row, over = strains[first + h], (first + h) * width, 3 * h * width
        nx, ny, nz, flat = _pull(bending, room.points, pulls, bent, h, forces)
        begin, end, coupled = bending.starts[h], bending.starts[h + 1], 0.0
        for place in range(begin, end):
            coupled += bending.values[place] * strains[first + bending.others[place]]
        value += bent * (0.5 * coupled + flat)
        _write_coupled(bending, begin, end, first, slopes, others, h * width, width)
        for i in range(0, width, LANES):
            at = over + i
            turned = spread(nx) * load(across, at) + spread(ny) * load(across, at + width)
            turned, other = turned + spread(nz) * load(across, at + 2 * width), load(others, h * width + i)
            store(others, h * width + i, turned + spread(0.5) * other)
            force = spread(coupled + flat) * load(slopes, row + i) + spread(bent) * turned
            store(gradient, i, load(gradient, i) + force)
    add_rows(bending.modes.reshape(-1), 0, forces, 0, forces.size, gradient)
    return value


@njit(**_options)
def _write_coupled(bending, begin, end, first, slopes, others, to, width):  # type: ignore[no-untyped-def]
    """Write the rows of slopes that a hinge is coupled to, times what couples them, from ``to`` on into ``others``."""
    values, together = bending.values, 4 * LANES
    for i in range(0, width - together + 1, together):
        a, b, c, d = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
        for place in range(begin, end):
            there, value = (first + bending.others[place]) * width + i, spread_from(values, place)
            a = a + value * load(slopes, there)
            b = b + value * load(slopes, there + LANES)
            c = c + value * load(slopes, there + 2 * LANES)
            d = d + value * load(slopes, there + 3 * LANES)
        store(others, to + i, a)
        store(others, to + i + LANES, b)
        store(others, to + i + 2 * LANES, c)
        store(others, to + i + 3 * LANES, d)
    for i in range(width // together * together, width, LANES):
        a, b, paired = spread(0.0), spread(0.0), begin + (end - begin) // 2 * 2
        for place in range(begin, paired, 2):
            there, here = first + bending.others[place], first + bending.others[place + 1]
            a = a + spread_from(values, place) * load(slopes, there * width + i)
            b = b + spread_from(values, place + 1) * load(slopes, here * width + i)
        if paired < end:
            there = first + bending.others[paired]
            a = a + spread_from(values, paired) * load(slopes, there * width + i)
        store(others, to + i, a + b)


@njit(entry=False, **_options)
def add_rows(rows, begin, factors, first, count, out):  # type: ignore[no-untyped-def]
    """Add ``count`` rows as long as ``out``, from number ``begin`` on, times the factors from ``first`` on."""
    width, pairs = out.size, out.size // (2 * LANES) * (2 * LANES)
    for i in range(0, pairs, 2 * LANES):  # whole lines of memory
        a, b, at = load(out, i), load(out, i + LANES), begin * width + i
        for k in range(first, first + count):
            factor = spread_from(factors, k)
            a = a + factor * load(rows, at)
            b = b + factor * load(rows, at + LANES)
            at += width
        store(out, i, a)
        store(out, i + LANES, b)
    for i in range(pairs, width, LANES):
        a, at = load(out, i), begin * width + i
        for k in range(first, first + count):
            a = a + spread_from(factors, k) * load(rows, at)
            at += width
        store(out, i, a)


@njit(entry=False, **_options)
def add_products(left, begin, right, start, count, width, matrix):  # type: ignore[no-untyped-def]
    """Add products of ``count`` rows, from number ``begin`` of ``left`` and number ``start`` of ``right`` on.

    To the lower triangle of ``matrix`` (width, width), which is flat; what it has above its diagonal is lost.
    """
    for i in range(0, width, 4):
        most, j = i + 4, 0
        while j + LANES < most:
            at, other = i * width + j, start * width + j
            a, e = load(matrix, at), load(matrix, at + LANES)
            b, f = load(matrix, at + width), load(matrix, at + width + LANES)
            c, g = load(matrix, at + 2 * width), load(matrix, at + 2 * width + LANES)
            d, h = load(matrix, at + 3 * width), load(matrix, at + 3 * width + LANES)
            for k in range(begin * width + i, (begin + count) * width + i, width):
                row, more = load(right, other), load(right, other + LANES)
                factor = spread_from(left, k)
                a, e = a + factor * row, e + factor * more
                factor = spread_from(left, k + 1)
                b, f = b + factor * row, f + factor * more
                factor = spread_from(left, k + 2)
                c, g = c + factor * row, g + factor * more
                factor = spread_from(left, k + 3)
                d, h = d + factor * row, h + factor * more
                other += width
            store(matrix, at, a)
            store(matrix, at + LANES, e)
            store(matrix, at + width, b)
            store(matrix, at + width + LANES, f)
            store(matrix, at + 2 * width, c)
            store(matrix, at + 2 * width + LANES, g)
            store(matrix, at + 3 * width, d)
            store(matrix, at + 3 * width + LANES, h)
            j += 2 * LANES
        if j < most:
            at, other = i * width + j, start * width + j
            a, b = load(matrix, at), load(matrix, at + width)
            c, d = load(matrix, at + 2 * width), load(matrix, at + 3 * width)
            for k in range(begin * width + i, (begin + count) * width + i, width):
                row = load(right, other)
                a = a + spread_from(left, k) * row
                b = b + spread_from(left, k + 1) * row
                c = c + spread_from(left, k + 2) * row
                d = d + spread_from(left, k + 3) * row
                other += width
            store(matrix, at, a)
            store(matrix, at + width, b)
            store(matrix, at + 2 * width, c)
            store(matrix, at + 3 * width, d)
