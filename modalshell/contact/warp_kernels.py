"""Compiled: frames of warps in closed form that touch colliders, at their candidates alone (theory 13, eq. 7 and 8)."""

from typing import Any

import numpy as np

from modalshell.contact.complementarity import complementary, factorise, substitute
from modalshell.contact.gap_kernels import gap_and_normal, gaps_beyond
from modalshell.contact.modal_kernels import (
    between_slots,
    candidates,
    local_at,
    local_shape,
    residual_compliance,
    response,
    turned,
)
from modalshell.kernels.compiler import UNCOUNTED, njit
from modalshell.kernels.frame import TILE, WORK, add_lines, warp_tiles
from modalshell.kernels.packed import LANES, dot, load_first, spread, store_first
from modalshell.kernels.rotations import coefficients, slopes

_CORRECTIONS = 8
"""Corrections of a linearisation by the gaps that it leads to, at most."""
_PASSES = 6
"""Linearisations at most."""


_kernel = njit(error_model="numpy", fastmath=False)
_options: dict[str, Any] = {"error_model": "numpy", "fastmath": False} | UNCOUNTED
_plain = njit(**_options)


@_plain
def combined(parts, q, out):  # type: ignore[no-untyped-def]
    """Displacements or turns ``out`` (3, k) at q of vertices with ``parts`` (m, 3, k) in each mode."""
    numbers, flat, width = parts.reshape(-1), out.reshape(-1), out.size
    for i in range(0, width, LANES):
        left, moved = min(width - i, LANES), spread(0.0)
        for mode in range(q.size):
            moved = moved + spread(q[mode]) * load_first(numbers, mode * width + i, left)
        store_first(flat, i, moved, left)


@_plain
def _slopes_of_gaps(modes, rotations, by, across):  # type: ignore[no-untyped-def]
    """Slopes ``across`` (m, k) of the gaps, by turns and displacements along ``by`` (6, k)."""
    (size, count), turns = across.shape, rotations.size > 0
    moved, turned_by, ways, flat = modes.reshape(-1), rotations.reshape(-1), by.reshape(-1), across.reshape(-1)
    for i in range(0, count, LANES):
        left = min(count - i, LANES)
        p, q, r = spread(0.0), spread(0.0), spread(0.0)
        if turns:
            p, q = load_first(ways, i, left), load_first(ways, count + i, left)
            r = load_first(ways, 2 * count + i, left)
        a, b = load_first(ways, 3 * count + i, left), load_first(ways, 4 * count + i, left)
        c = load_first(ways, 5 * count + i, left)
        for mode in range(size):
            at = 3 * mode * count + i
            x, y = load_first(moved, at, left), load_first(moved, at + count, left)
            slope = a * x + b * y + c * load_first(moved, at + 2 * count, left)
            if turns:
                x, y = load_first(turned_by, at, left), load_first(turned_by, at + count, left)
                slope = slope + p * x + q * y + r * load_first(turned_by, at + 2 * count, left)
            store_first(flat, mode * count + i, slope, left)


@_kernel
def _linearised(kept, bodies, q, local, frame):  # type: ignore[no-untyped-def]
    """Gaps and their slopes at q, with displacements ``local`` (3, k) in the world beyond the modes."""
    contact_of, rest, modes, rotations = kept
    gap, normals, own, across, at, u, w, by = frame
    n, out = np.empty(3), np.empty(3)
    combined(modes, q, u)
    turns = rotations.size > 0
    if turns:
        combined(rotations, q, w)
    for i in range(gap.size):
        x, y, z = u[0, i], u[1, i], u[2, i]
        if turns:
            c1, c2, c3 = coefficients(w[0, i], w[1, i], w[2, i])
            x, y, z = turned(w[0, i], w[1, i], w[2, i], c2, c3, x, y, z)
        x, y, z = rest[0, i] + x + local[0, i], rest[1, i] + y + local[1, i], rest[2, i] + z + local[2, i]
        at[0, i], at[1, i], at[2, i] = x, y, z
        gap[i] = gap_and_normal(bodies, contact_of[i], x, y, z, n)
        a, b, c = n[0], n[1], n[2]
        normals[0, i], normals[1, i], normals[2, i] = a, b, c
        if turns:
            own[0, i], own[1, i], own[2, i] = turned(w[0, i], w[1, i], w[2, i], -c1, c2, a, b, c)
            # Rt(w)^T n
            by[3, i], by[4, i], by[5, i] = turned(w[0, i], w[1, i], w[2, i], -c2, c3, a, b, c)
            warp_slope((w[0, i], w[1, i], w[2, i]), (u[0, i], u[1, i], u[2, i]), (a, b, c), (c1, c2, c3), out)
            by[0, i], by[1, i], by[2, i] = out[0], out[1], out[2]
        else:
            own[0, i], own[1, i], own[2, i] = a, b, c
            by[3, i], by[4, i], by[5, i] = a, b, c
    _slopes_of_gaps(modes, rotations, by, across)


@_kernel
def warp_slope(w, u, n, factors, out):  # type: ignore[no-untyped-def]
    """Derivative ``out`` (3,) by w of ``n . Rt(w) u``; ``factors`` are those of the rotation by w."""
    c1, c2, c3 = factors
    square = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    d2, d3 = slopes(square, c1, c2, c3)
    nw, uw = n[0] * w[0] + n[1] * w[1] + n[2] * w[2], u[0] * w[0] + u[1] * w[1] + u[2] * w[2]
    nu = n[0] * u[0] + n[1] * u[1] + n[2] * u[2]
    # n . (w x u) = w . (u x n), and n . (w x (w x u)) = (n . w)(u . w) - w^2 (n . u)
    p, q, r = u[1] * n[2] - u[2] * n[1], u[2] * n[0] - u[0] * n[2], u[0] * n[1] - u[1] * n[0]
    radial = d2 * (w[0] * p + w[1] * q + w[2] * r) + d3 * (nw * uw - square * nu)
    out[0] = radial * w[0] + c2 * p + c3 * (n[0] * uw + u[0] * nw - 2.0 * nu * w[0])
    out[1] = radial * w[1] + c2 * q + c3 * (n[1] * uw + u[1] * nw - 2.0 * nu * w[1])
    out[2] = radial * w[2] + c2 * r + c3 * (n[2] * uw + u[2] * nw - 2.0 * nu * w[2])


@_kernel
def _reached(kept, bodies, q, local, begin, frame):  # type: ignore[no-untyped-def]
    """Gaps (k,) at q with displacements (3, k) in the axes at rest, turned in place; and the move from ``begin``."""
    contact_of, rest, modes, rotations = kept
    gaps, u, w = frame
    n, move, turns = np.empty(3), 0.0, rotations.size > 0
    combined(modes, q, u)
    if turns:
        combined(rotations, q, w)
    for i in range(gaps.size):
        x, y, z = u[0, i], u[1, i], u[2, i]
        a, b, c = local[0, i], local[1, i], local[2, i]
        if turns:
            c1, c2, c3 = coefficients(w[0, i], w[1, i], w[2, i])
            x, y, z = turned(w[0, i], w[1, i], w[2, i], c2, c3, x, y, z)
            a, b, c = turned(w[0, i], w[1, i], w[2, i], c1, c2, a, b, c)
        local[0, i], local[1, i], local[2, i] = a, b, c
        x, y, z = rest[0, i] + x + a, rest[1, i] + y + b, rest[2, i] + z + c
        gaps[i] = gap_and_normal(bodies, contact_of[i], x, y, z, n)
        move = max(move, (x - begin[0, i]) ** 2 + (y - begin[1, i]) ** 2 + (z - begin[2, i]) ** 2)
    return np.sqrt(move)


@_kernel
def gather(shape, rows_of, rows, slots, blocks, linear):  # type: ignore[no-untyped-def]
    """What :func:`press` reads of candidates (k,), whose slots are known: it serves as long as they stay.

    ``shape`` are positions at rest (n, 3), modes and modal rotations (3n, m), none where these do not turn the modes.
    Where gaps are ``linear`` in the coordinates and forces, there is room for the matrix of the problem in which all
    are pushed, its factor, and G (m,) of these, which is not a number yet.
    """
    rest, modes, rotations = shape
    count, size = rows.size, modes.shape[1]
    vertices, contact_of = np.empty(count, np.int64), np.empty(count, np.int64)
    places, by_modes = np.empty((3, count)), np.empty((size, 3, count))
    by_turns = np.empty((size if rotations.size else 0, 3, count))
    for i in range(count):
        vertices[i], contact_of[i] = rows_of[0][rows[i]], rows_of[1][rows[i]]
        for axis in range(3):
            places[axis, i] = rest[vertices[i], axis]
            for mode in range(size):
                by_modes[mode, axis, i] = modes[3 * vertices[i] + axis, mode]
            if rotations.size:
                for mode in range(size):
                    by_turns[mode, axis, i] = rotations[3 * vertices[i] + axis, mode]
    room = count if linear else 0
    steady = np.empty((room, room)), np.empty((room, room)), np.full(size if linear else 0, np.nan)
    return rows, vertices, slots, between_slots(blocks, slots), (contact_of, places, by_modes, by_turns), steady


@_plain
def _same(one, other):  # type: ignore[no-untyped-def]
    """Whether numbers (k,) are the same as others."""
    same = one.size == other.size
    for i in range(min(one.size, other.size)):
        same = same and one[i] == other[i]
    return same


@_plain
def _offsets(gap, normals, local, across, ways, offset):  # type: ignore[no-untyped-def]
    """Gaps ``offset`` (k,) without forces, to first order, from those where displacements are ``local`` (3, k)."""
    free, q = ways
    for i in range(gap.size):
        offset[i] = gap[i]
    for j in range(3):
        normal, shape = normals[j], local[j]
        for i in range(gap.size):
            offset[i] -= normal[i] * shape[i]
    for k in range(q.size):
        row, way = across[k], free[k] - q[k]
        for i in range(gap.size):
            offset[i] += row[i] * way


@_kernel
def press(kept, bodies, step, before, limits):  # type: ignore[no-untyped-def]
    """End of a frame: ``q = free + G J^T f`` with ``0 <= f _|_ gap >= 0`` at the candidates.

    Each linearisation is corrected by the gaps that its end has, and taken again where that is far. Returns candidates
    (k,), coordinates (m,), forces (r,) along the normals, and those on the candidates in the axes at rest (k, 3), their
    elastic energy [J] beyond the modes, and whether the gaps met their tolerance. Coordinates are empty where the
    candidates are others than those that are kept.

    Parameters
    ----------
    kept : tuple
        Of the candidates of the last frame, by :func:`gather`.
    bodies : tuple
        Packed contacts.
    step : tuple
        Coordinates (m,) without contacts, G (m,), and the coordinates to begin with.
    before : tuple
        Gaps (r,) [m] that choose the candidates, forces (r,) [N] and displacements (n, 3) [m] beyond the modes.
    limits : tuple
        Gap of a candidate, numbers of them and of those inside, gap that is none, move of a good linearisation, and
        accuracy of the small problems [m].
    """
    rows, vertices, _, between, place, _ = kept
    free, compliance, begin = step
    near, most, inside, deep, far, accuracy = limits
    found = candidates(before[0], before[1], near, most, inside)
    if not _same(found, rows):
        return found, np.empty(0), np.empty(0), np.empty((0, 3)), 0.0, False
    count = rows.size
    forces, local, pushes = np.empty(count), np.empty((3, count)), np.empty((count, 3))
    for i in range(count):
        forces[i] = before[1][rows[i]]
        for j in range(3):
            local[j, i] = before[2][vertices[i], j]
    q = begin.copy()
    found = q, forces, local, pushes
    steady = np.empty((count, count)), np.empty((0, 0)), np.empty(0)
    energy, settled = solved(between, place, bodies, (free, compliance), found, (deep, far, accuracy), steady)
    pushed = np.zeros(before[1].size)
    for i in range(count):
        pushed[rows[i]] = forces[i]
    return rows, q, pushed, pushes, energy, settled


@njit(entry=False, error_model="numpy", fastmath=False)
def solved(between, place, bodies, way, found, limits, steady):  # type: ignore[no-untyped-def]
    """Solve the problem of candidates from where it is ``found``, in place: as of :func:`stay`.

    ``way`` are coordinates (m,) without contacts, and G (m,). ``steady`` are the matrix, its factor and G as of
    :func:`gather`, or room for the matrix and no G. Where there is a factor all are to stay pushed, and one that opens
    ends it. Returns the elastic energy [J] beyond the modes, and whether gaps met their tolerance.
    """
    q, forces, local, pushes = found
    free, compliance = way
    deep, far, accuracy = limits
    count, solved, move, energy = forces.size, False, np.inf, 0.0
    matrix, factor, known = steady
    gap, offset, expected, stays = np.empty(count), np.empty(count), np.empty(count), factor.size > 0
    triples = np.empty((5, 3, count))
    normals, own, at, u, w = triples[0], triples[1], triples[2], triples[3], triples[4]
    across, by = np.empty((q.size, count)), np.empty((6, count))
    for _ in range(_PASSES):
        _linearised(place, bodies, q, local, (gap, normals, own, across, at, u, w, by))
        if not (known.size and _same(known, compliance)):
            residual_compliance(between, own, matrix)
            response(across, compliance, matrix)
            if stays:
                for i in range(count):
                    for j in range(count):
                        factor[i, j] = matrix[i, j]
                if not factorise(factor):
                    if known.size:
                        known[0] = np.nan  # what was kept is overwritten
                    return energy, False
            for k in range(known.size):
                known[k] = compliance[k]
        _offsets(gap, normals, local, across, (free, q), offset)
        for _ in range(_CORRECTIONS):
            if stays:
                for i in range(count):
                    forces[i] = -offset[i]
                substitute(factor, forces)
                for i in range(count):
                    if not forces[i] > 0.0:
                        return energy, False
            else:
                complementary(matrix, offset, forces, accuracy, True)
            _ended_small(matrix, offset, forces, (free, compliance, across), own, (q, expected, pushes))
            local_at(between, pushes, local)
            energy = 0.0
            for i in range(count):
                for j in range(3):
                    energy += 0.5 * pushes[i, j] * local[j, i]
            move = _reached(place, bodies, q, local, at, (gap, u, w))
            worst = 0.0
            for i in range(count):
                worst = max(worst, abs(gap[i]) if forces[i] > 0.0 else -gap[i])
            solved = worst <= deep
            if solved or not worst < np.inf:
                break
            for i in range(count):
                offset[i] += gap[i] - expected[i]
        if (solved and move <= far) or not move < np.inf:
            break
    return energy, solved and move <= far


@_plain
def _ended_small(matrix, offset, forces, step, own, out):  # type: ignore[no-untyped-def]
    """Coordinates (m,), expected gaps (k,) and forces (k, 3) in the axes at rest by forces (k,) on the candidates."""
    free, compliance, across = step
    q, expected, pushes = out
    flat = across.reshape(-1)
    for k in range(q.size):  # forces are not negative
        q[k] = free[k] + compliance[k] * dot(flat, k * forces.size, forces, 0, forces.size)
    for j in range(expected.size):
        expected[j] = offset[j]
    for i in range(forces.size):
        force, row = forces[i], matrix[i]
        pushed = force > 0.0
        for j in range(3):
            pushes[i, j] = force * own[j, i] if pushed else 0.0
        if pushed:
            for j in range(expected.size):
                expected[j] += row[j] * force


@_kernel
def warp_ended(tiles, q, pushed, rows_of, bodies, out):  # type: ignore[no-untyped-def]
    """Positions at q, a :func:`local_shape` that turns with them, and gaps there; the least one.

    ``tiles`` are modal data and positions at rest in tiles, for :func:`warp_tiles`, and no lines; or none, positions at
    rest (n, 3), and the modes as lines (m, 3n), where nothing turns. ``pushed`` are stored shapes, slots of these, and
    forces there, ``out`` positions and displacements (n, 3) [m], and gaps (r,) [m] of all rows.
    """
    (modal, rest, lines), (base, local, gaps), work = tiles, out, np.empty(WORK)
    local_shape(pushed[0], pushed[1], pushed[2], base[:0], local)
    if lines.size:
        add_lines(lines, q, rest.reshape(-1), base.reshape(-1))
    for tile in range(modal.shape[0]):
        warp_tiles(tile, tile + 1, modal, rest, q, work, base)
        _turn_tile(work, local[tile * TILE : (tile + 1) * TILE])
    return gaps_beyond(bodies, rows_of[0], rows_of[1], base, local, np.empty(3), gaps)


@_plain
def _turn_tile(work, local):  # type: ignore[no-untyped-def]
    """Turn displacements (j, 3) of a tile, in place, by the rotation vectors that its frame has left in ``work``."""
    for j in range(local.shape[0]):
        a, b, c = work[3 * TILE + j], work[4 * TILE + j], work[5 * TILE + j]
        second, third = work[6 * TILE + j], work[7 * TILE + j]
        first = 1.0 - (a * a + b * b + c * c) * third
        local[j, 0], local[j, 1], local[j, 2] = turned(a, b, c, first, second, local[j, 0], local[j, 1], local[j, 2])
