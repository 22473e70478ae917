"""Compiled bending of a reduced energy: angles of hinges that are bent at rest, and what couples them.

Rows over coordinates are as those of :mod:`.dense_kernels`. Hinges have such rows in the Hessian alone; their gradient
is that of forces on their vertices.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from modalshell.core.typing import Array
from modalshell.kernels.compiler import COUNTED, UNCOUNTED, njit
from modalshell.kernels.packed import LANES, load, spread, spread_from, store
from modalshell.models.hybrid.dense_kernels import add_rows, multiply, write_products
from modalshell.shell.kernels.generated.flexure import first_derivatives

_options: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "nsz"}, "nogil": True} | UNCOUNTED


class Room(NamedTuple):
    """What kernels write to on their way: sums over the numbers of quadratic forms, and of bent hinges.

    Of these the positions of their vertices (3 S,) and forces there, the slopes of an angle, those of all (9 H,) times
    their roots, the constant vectors ``P_h z`` (3 H,), and the mean normals (3 H,).
    """

    products: Array
    values: Array
    points: Array
    forces: Array
    local: Array
    slopes: Array
    pulls: Array
    normals: Array


@njit(**_options | COUNTED)
def make_room(width, bending):  # type: ignore[no-untyped-def]
    """Room for rows over coordinates (width,), and the bent hinges."""
    points, hinges, coupled = 3 * bending.rest.shape[0], bending.hinges.shape[0], 3 * bending.across.shape[0]
    return Room(
        np.empty(LANES * width), np.empty(LANES), np.empty(points), np.empty(points), np.empty(9),
        np.empty(9 * hinges), np.empty(coupled), np.empty(coupled),
    )  # fmt: skip


@njit(**_options)
def fold_rows(bending):  # type: ignore[no-untyped-def]
    """Rows that :func:`write_folds` writes."""
    return bending.hinges.shape[0] + 2 * bending.across.shape[0]


@njit(entry=False, **_options)
def hinge_angles(bending, z, first, strains, room):  # type: ignore[no-untyped-def]
    """Write the angles' changes, times the roots of their weights, from the ``first`` place on.

    ``z`` (width,) are the coordinates. The room gets the hinges' positions, and the slopes by these.
    """
    x, local, slopes, rest = room.points, room.local, room.slopes, bending.rest.reshape(-1)
    multiply(bending.modes.reshape(-1), z, x)
    for k in range(x.size):
        x[k] += rest[k]
    for h in range(bending.hinges.shape[0]):
        a, b, c, d = _corners(bending, h)
        angle = first_derivatives(
            x[b] - x[a], x[b + 1] - x[a + 1], x[b + 2] - x[a + 2],
            x[c] - x[a], x[c + 1] - x[a + 1], x[c + 2] - x[a + 2],
            x[d] - x[a], x[d + 1] - x[a + 1], x[d + 2] - x[a + 2], local,
        )  # fmt: skip
        root = bending.roots[h]
        change = angle - bending.angles[h]
        if abs(change) > np.pi:
            change -= np.copysign(2.0 * np.pi, change)
        strains[first + h] = root * change
        for k in range(9):
            slopes[9 * h + k] = root * local[k]


_X, _Y, _Z = np.int64(0), np.int64(1), np.int64(2)
"""Components. Of a number that is written out where a kernel is called numba compiles this once for each."""


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


@njit(entry=False, **_options)
def add_bent(bending, z, first, strains, gradient, room):  # type: ignore[no-untyped-def]
    """Add the gradient of the bent hinges' energy, whose strains begin with the ``first``.

    Returns the energy of what couples them. The room gets the mean normals.
    """
    across, value = bending.across.reshape(-1), 0.0
    forces, pulls, normals, slopes = room.forces, room.pulls, room.normals, room.slopes
    coupled_count = bending.across.shape[0]
    for k in range(forces.size):
        forces[k] = 0.0
    multiply(across, z, pulls)
    for h in range(bending.hinges.shape[0]):
        bent = force = strains[first + h]
        if coupled_count > 0:
            nx, ny, nz, flat = _pull(bending, room.points, pulls, bent, h, forces)
            coupled = 0.0
            for place in range(bending.starts[h], bending.starts[h + 1]):
                coupled += bending.values[place] * strains[first + bending.others[place]]
            value += bent * (0.5 * coupled + flat)
            force += coupled + flat
            normals[3 * h], normals[3 * h + 1], normals[3 * h + 2] = nx, ny, nz
            pulls[3 * h], pulls[3 * h + 1], pulls[3 * h + 2] = bent * nx, bent * ny, bent * nz
        a, b, c, d = _corners(bending, h)
        for axis in range(3):
            at = 9 * h + axis
            to_b, to_c, to_d = force * slopes[at], force * slopes[at + 3], force * slopes[at + 6]
            forces[b + axis] += to_b
            forces[c + axis] += to_c
            forces[d + axis] += to_d
            forces[a + axis] -= to_b + to_c + to_d
    add_rows(bending.modes.reshape(-1), forces, 0, forces.size, gradient)
    add_rows(across, pulls, 0, pulls.size, gradient)
    return value


@njit(entry=False, **_options)
def write_folds(bending, width, folds, room):  # type: ignore[no-untyped-def]
    """Write rows of hinges by which the Hessian of bending is a sum of products, after :func:`add_bent`.

    ``folds`` has rows (H, width) of the angles' slopes where hinges are not coupled. Where they are, it has three for
    each: with the slopes S, and half of what they are coupled to, O, the Hessian ``S S + S O + O S`` is that of
    ``S + O`` less that of O, which is written with both signs.
    """
    modes, slopes, count = bending.modes.reshape(-1), room.slopes, bending.hinges.shape[0]
    for h in range(count):
        a, b, c, d = _corners(bending, h)
        a, b, c, d, at, to = a * width, b * width, c * width, d * width, 9 * h, h * width
        bx, by, bz = spread_from(slopes, at), spread_from(slopes, at + 1), spread_from(slopes, at + 2)
        cx, cy, cz = spread_from(slopes, at + 3), spread_from(slopes, at + 4), spread_from(slopes, at + 5)
        dx, dy, dz = spread_from(slopes, at + 6), spread_from(slopes, at + 7), spread_from(slopes, at + 8)
        ax, ay, az = bx + cx + dx, by + cy + dy, bz + cz + dz
        for i in range(0, width, LANES):  # numbers of a row stay in registers: it is not told apart from the slopes
            y, z = i + width, i + 2 * width
            to_b = bx * load(modes, b + i) + by * load(modes, b + y) + bz * load(modes, b + z)
            to_c = cx * load(modes, c + i) + cy * load(modes, c + y) + cz * load(modes, c + z)
            to_d = dx * load(modes, d + i) + dy * load(modes, d + y) + dz * load(modes, d + z)
            to_a = ax * load(modes, a + i) + ay * load(modes, a + y) + az * load(modes, a + z)
            store(folds, to + i, (to_b + to_c) + (to_d - to_a))
    coupled = bending.across.shape[0]
    if coupled == 0:
        return
    across, normals, none = bending.across.reshape(-1), room.normals, spread(0.0)
    for h in range(coupled):
        begin, end, over, other = bending.starts[h], bending.starts[h + 1], 3 * h * width, (count + h) * width
        _write_coupled(bending, begin, end, folds, other, width)
        nx, ny, nz = spread_from(normals, 3 * h), spread_from(normals, 3 * h + 1), spread_from(normals, 3 * h + 2)
        for i in range(0, width, LANES):
            at = over + i
            turned = nx * load(across, at) + ny * load(across, at + width) + nz * load(across, at + 2 * width)
            store(folds, other + i, turned + spread(0.5) * load(folds, other + i))
    for k in range(0, coupled * width, LANES):
        other = load(folds, coupled * width + k)
        store(folds, k, load(folds, k) + other)
        store(folds, 2 * coupled * width + k, none - other)


@njit(**_options)
def _write_coupled(bending, begin, end, folds, to, width):  # type: ignore[no-untyped-def]
    """Write the sum of the slopes that a hinge is coupled to, times what couples them, from ``to`` on."""
    values, together = bending.values, 4 * LANES
    for i in range(0, width - together + 1, together):
        a, b, c, d = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
        for place in range(begin, end):
            there, value = bending.others[place] * width + i, spread_from(values, place)
            a = a + value * load(folds, there)
            b = b + value * load(folds, there + LANES)
            c = c + value * load(folds, there + 2 * LANES)
            d = d + value * load(folds, there + 3 * LANES)
        store(folds, to + i, a)
        store(folds, to + i + LANES, b)
        store(folds, to + i + 2 * LANES, c)
        store(folds, to + i + 3 * LANES, d)
    for i in range(width // together * together, width, LANES):
        a, b, paired = spread(0.0), spread(0.0), begin + (end - begin) // 2 * 2
        for place in range(begin, paired, 2):
            there, here = bending.others[place] * width + i, bending.others[place + 1] * width + i
            a = a + spread_from(values, place) * load(folds, there)
            b = b + spread_from(values, place + 1) * load(folds, here)
        if paired < end:
            a = a + spread_from(values, paired) * load(folds, bending.others[paired] * width + i)
        store(folds, to + i, a + b)


@njit(entry=False, **_options)
def write_bending(known, bending, width, folds, room, matrix):  # type: ignore[no-untyped-def]
    """Write the lower triangle of the sum of ``known`` and the Hessian of bending, after :func:`add_bent`.

    The second derivatives of the angles and of the normals are left out.
    """
    size, count, coupled = width * width, bending.hinges.shape[0], bending.across.shape[0]
    write_folds(bending, width, folds, room)
    flat = bending.flat.reshape(-1)
    for k in range(0, flat.size, LANES):
        store(matrix, k, load(known, k) + load(flat, k))
    for k in range(flat.size, size, LANES):
        store(matrix, k, load(known, k))
    write_products(matrix, folds, folds, count, width, matrix)
    if coupled > 0:
        others, negative = folds[coupled * width :], folds[2 * coupled * width :]
        write_products(matrix, others, negative, coupled, width, matrix)
