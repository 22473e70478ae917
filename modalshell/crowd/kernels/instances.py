"""Positions and modal forces of many instances of one shell, over packs of vertices [choi2007].

A pack is as many vertices as a register holds numbers. Its modal data are one block (modes, 6, lanes) in the order of
reading. While those of 64 vertices are in the first cache, 32 instances take their turns at them, two at a time: what
is read for one serves both. A pair's sums stay in registers until its rotations are done: while those wait for one
another the processor goes on to the sums of the next pack. Where the next pair's positions will go is fetched
meanwhile. An instance's numbers do not depend on the others of its batch, but for the last bit where it takes the first
place of a pair in one batch and the second in another.

On an AMD processor (Zen 5, AVX-512) the multiplications are the bound, writing is hidden: a pack of float64 with 8
modes takes 48 cycles, of which 82 multiplications need 41, and the shuffles and writes of positions, which take turns
with them, the others.
"""

import numpy as np
from numba import prange

from modalshell.crowd.kernels.polynomials import packed_coefficients
from modalshell.kernels.compiler import njit
from modalshell.kernels.frame import LIMIT
from modalshell.kernels.packed import (
    any_above,
    lane_count,
    larger,
    load,
    prefetch,
    spread,
    spread_from,
    store,
    store_first_triples,
    store_triples,
    total,
)
from modalshell.kernels.rotations import coefficients

RIGID, LINEAR, WARPED = 0, 1, 2
"""Levels of detail."""

CHUNK = 32
"""Instances that take turns at a block; what a thread does at least."""
BLOCK = 64
"""Vertices whose modal data these find in the first cache."""
WORK = 6 * BLOCK
"""Length of the buffer that one thread needs: the forces on a block for each of a pair."""

_kernel = njit(error_model="numpy", fastmath=False)
_inline = njit(error_model="numpy", fastmath=False, forceinline=True)


@_inline
def _turned(x, y, z, wx, wy, wz, linear, quadratic):  # type: ignore[no-untyped-def]
    """``v + linear w x v + quadratic w x (w x v)``."""
    cx, cy, cz = wy * z - wz * y, wz * x - wx * z, wx * y - wy * x
    return (
        x + linear * cx + quadratic * (wy * cz - wz * cy),
        y + linear * cy + quadratic * (wz * cx - wx * cz),
        z + linear * cz + quadratic * (wx * cy - wy * cx),
    )


@_inline
def _warped(x, y, z, wx, wy, wz, powers, worst):  # type: ignore[no-untyped-def]
    """A displacement turned by the mean of the rotations up to w, and the larger of ``worst`` and |w|^2."""
    squared = wx * wx + wy * wy + wz * wz
    second, third = packed_coefficients(squared, powers)
    x, y, z = _turned(x, y, z, wx, wy, wz, second, third)
    return x, y, z, larger(squared, worst)


@_inline
def _placed(x, y, z, poses, at):  # type: ignore[no-untyped-def]
    """``R v + t`` with R, row by row, and t from ``at`` on in ``poses``."""
    return (
        spread_from(poses, at) * x
        + spread_from(poses, at + 1) * y
        + spread_from(poses, at + 2) * z
        + spread_from(poses, at + 9),
        spread_from(poses, at + 3) * x
        + spread_from(poses, at + 4) * y
        + spread_from(poses, at + 5) * z
        + spread_from(poses, at + 10),
        spread_from(poses, at + 6) * x
        + spread_from(poses, at + 7) * y
        + spread_from(poses, at + 8) * z
        + spread_from(poses, at + 11),
    )


@_inline
def _write(flat, instance, vertices, pack, x, y, z):  # type: ignore[no-untyped-def]
    """Store a pack's positions of an instance, of the last pack those of its vertices alone."""
    lanes = lane_count(flat)
    at, left = 3 * (instance * vertices + pack * lanes), vertices - pack * lanes
    if left >= lanes:
        store_triples(flat, at, x, y, z)
    else:
        store_first_triples(flat, at, x, y, z, left)


@_inline
def _two_sums(modal, at, q, a, b, modes):  # type: ignore[no-untyped-def]
    """``sum_k q_k modal_k`` of three rows from ``at`` on, for the coordinates from ``a`` and from ``b`` on in ``q``."""
    lanes = lane_count(modal)
    qa, qb = spread_from(q, a), spread_from(q, b)
    row = load(modal, at)
    ax, bx = qa * row, qb * row
    row = load(modal, at + lanes)
    ay, by = qa * row, qb * row
    row = load(modal, at + 2 * lanes)
    az, bz = qa * row, qb * row
    for k in range(1, modes):
        at += 6 * lanes
        qa, qb = spread_from(q, a + k), spread_from(q, b + k)
        row = load(modal, at)
        ax, bx = ax + qa * row, bx + qb * row
        row = load(modal, at + lanes)
        ay, by = ay + qa * row, by + qb * row
        row = load(modal, at + 2 * lanes)
        az, bz = az + qa * row, bz + qb * row
    return ax, ay, az, bx, by, bz


@_inline
def _two_sums_of_six(modal, at, q, a, b, modes):  # type: ignore[no-untyped-def]
    """:func:`_two_sums` of six rows: twelve sums at once hide more of each other's latency than twice six."""
    lanes = lane_count(modal)
    qa, qb = spread_from(q, a), spread_from(q, b)
    row = load(modal, at)
    ax, bx = qa * row, qb * row
    row = load(modal, at + lanes)
    ay, by = qa * row, qb * row
    row = load(modal, at + 2 * lanes)
    az, bz = qa * row, qb * row
    row = load(modal, at + 3 * lanes)
    au, bu = qa * row, qb * row
    row = load(modal, at + 4 * lanes)
    av, bv = qa * row, qb * row
    row = load(modal, at + 5 * lanes)
    aw, bw = qa * row, qb * row
    for k in range(1, modes):
        at += 6 * lanes
        qa, qb = spread_from(q, a + k), spread_from(q, b + k)
        row = load(modal, at)
        ax, bx = ax + qa * row, bx + qb * row
        row = load(modal, at + lanes)
        ay, by = ay + qa * row, by + qb * row
        row = load(modal, at + 2 * lanes)
        az, bz = az + qa * row, bz + qb * row
        row = load(modal, at + 3 * lanes)
        au, bu = au + qa * row, bu + qb * row
        row = load(modal, at + 4 * lanes)
        av, bv = av + qa * row, bv + qb * row
        row = load(modal, at + 5 * lanes)
        aw, bw = aw + qa * row, bw + qb * row
    return ax, ay, az, au, av, aw, bx, by, bz, bu, bv, bw


@_kernel
def _wound_up(first, end, modal, rest, q, pose, out):  # type: ignore[no-untyped-def]
    """Positions of the vertices ``first`` to ``end - 1`` of one instance, whatever the angles; ``out`` is (n, 3)."""
    lanes = modal.shape[3]
    for vertex in range(first, end):
        pack, j = divmod(vertex, lanes)
        sums = np.zeros(6)
        for mode in range(q.size):
            for row in range(6):
                sums[row] += q[mode] * modal[pack, mode, row, j]
        wx, wy, wz = sums[3], sums[4], sums[5]
        _, second, third = coefficients(wx, wy, wz)
        x, y, z = _turned(sums[0], sums[1], sums[2], wx, wy, wz, second, third)
        x, y, z = x + rest[pack, 0, j], y + rest[pack, 1, j], z + rest[pack, 2, j]
        for axis in range(3):
            if pose.size:
                row = pose[3 * axis : 3 * axis + 3]
                out[vertex, axis] = row[0] * x + row[1] * y + row[2] * z + pose[9 + axis]
            else:
                out[vertex, axis] = (x, y, z)[axis]


@_kernel
def crowd_positions(begin, end, level, order, modal, rest, q, powers, poses, out):  # type: ignore[no-untyped-def]
    """``out_b = R_b (rest + u_b) + t_b`` (B, n, 3) of the instances b of ``order`` (k,), u at ``level``, at q (B, m).

    Of ``order`` the chunks ``begin`` to ``end - 1`` are taken. ``modal`` (packs, m, 6, lanes) and ``rest``
    (packs, 3, lanes) are padded with zeros; ``poses`` (B, 12) hold R and t, or are (0, 12) where instances stay.
    """
    vertices, modes = out.shape[1], q.shape[1]
    lanes = lane_count(out)
    limit = modal.dtype.type(LIMIT)
    moved = poses.shape[0] > 0
    flat_modal, flat_rest, flat_q, flat_poses = modal.reshape(-1), rest.reshape(-1), q.reshape(-1), poses.reshape(-1)
    flat = out.reshape(-1)
    for chunk in range(begin, end):
        last = min((chunk + 1) * CHUNK, order.size)
        for first in range(0, modal.shape[0], BLOCK // lanes):
            ended = min(first + BLOCK // lanes, modal.shape[0])
            for pair in range(chunk * CHUNK, last, 2):
                a, b = order[pair], order[min(pair + 1, last - 1)]
                worst_a = worst_b = spread(limit)
                next_a, next_b = order[min(pair + 2, last - 1)], order[min(pair + 3, last - 1)]
                for pack in range(first, ended):
                    for part in range(3):
                        prefetch(flat, 3 * (next_a * vertices + pack * lanes) + part * lanes)
                        prefetch(flat, 3 * (next_b * vertices + pack * lanes) + part * lanes)
                    at = 3 * pack * lanes
                    x, y, z = load(flat_rest, at), load(flat_rest, at + lanes), load(flat_rest, at + 2 * lanes)
                    ax, ay, az, bx, by, bz = x, y, z, x, y, z
                    bu, bv, bw = x, y, z
                    at = 6 * pack * modes * lanes
                    if level == WARPED:
                        ax, ay, az, au, av, aw, bx, by, bz, bu, bv, bw = _two_sums_of_six(
                            flat_modal, at, flat_q, a * modes, b * modes, modes
                        )
                        ax, ay, az, worst_a = _warped(ax, ay, az, au, av, aw, powers, worst_a)
                        ax, ay, az = ax + x, ay + y, az + z
                    elif level == LINEAR:
                        ax, ay, az, bx, by, bz = _two_sums(flat_modal, at, flat_q, a * modes, b * modes, modes)
                        ax, ay, az, bx, by, bz = ax + x, ay + y, az + z, bx + x, by + y, bz + z
                    if moved:
                        ax, ay, az = _placed(ax, ay, az, flat_poses, 12 * a)
                    _write(flat, a, vertices, pack, ax, ay, az)
                    # The first is out of the registers before the second begins.
                    if level == WARPED:
                        bx, by, bz, worst_b = _warped(bx, by, bz, bu, bv, bw, powers, worst_b)
                        bx, by, bz = bx + x, by + y, bz + z
                    if moved:
                        bx, by, bz = _placed(bx, by, bz, flat_poses, 12 * b)
                    _write(flat, b, vertices, pack, bx, by, bz)
                if any_above(worst_a, limit):
                    upto = min(ended * lanes, vertices)
                    _wound_up(first * lanes, upto, modal, rest, q[a], poses[a : a + 1].ravel(), out[a])
                if any_above(worst_b, limit):
                    upto = min(ended * lanes, vertices)
                    _wound_up(first * lanes, upto, modal, rest, q[b], poses[b : b + 1].ravel(), out[b])


@_kernel
def _turn_back_wound_up(first, end, modal, mass, q, felt, work):  # type: ignore[no-untyped-def]
    """``mass R(w)^T felt`` of the packs ``first`` to ``end - 1`` of one instance into ``work``, whatever the angles."""
    lanes = modal.shape[3]
    for pack in range(first, end):
        for j in range(lanes):
            w = np.zeros(3)
            for mode in range(q.size):
                for row in range(3):
                    w[row] += q[mode] * modal[pack, mode, 3 + row, j]
            linear, quadratic, _ = coefficients(w[0], w[1], w[2])
            if felt.ndim == 1:
                x, y, z = felt[0], felt[1], felt[2]
            else:
                x, y, z = felt[pack, 0, j], felt[pack, 1, j], felt[pack, 2, j]
            turned = _turned(x, y, z, w[0], w[1], w[2], -linear, quadratic)
            for axis in range(3):
                work[(3 * (pack - first) + axis) * lanes + j] = mass[pack, j] * turned[axis]


@_kernel
def crowd_forces(begin, end, order, modal, mass, q, powers, felt, work, out):  # type: ignore[no-untyped-def]
    """Modal forces ``Phi^T R(Psi q_b)^T (mass felt_b)`` (B, m) of the instances b of ``order``, from zeros.

    ``mass`` (packs, lanes) is padded with zeros; ``felt`` (B, 3) is one acceleration for all vertices of an instance,
    or (B, packs, 3, lanes) one for each; ``work`` is (WORK,).
    """
    modes = q.shape[1]
    lanes = lane_count(modal)
    limit = modal.dtype.type(LIMIT)
    flat_modal, flat_mass, flat_q, flat_felt = modal.reshape(-1), mass.reshape(-1), q.reshape(-1), felt.reshape(-1)
    one = spread(modal.dtype.type(1.0))
    for chunk in range(begin, end):
        last = min((chunk + 1) * CHUNK, order.size)
        for first in range(0, modal.shape[0], BLOCK // lanes):
            ended = min(first + BLOCK // lanes, modal.shape[0])
            for pair in range(chunk * CHUNK, last, 2):
                a, b = order[pair], order[min(pair + 1, last - 1)]
                worst_a = worst_b = spread(limit)
                if felt.ndim == 2:
                    fx, fy, fz = spread(felt[a, 0]), spread(felt[a, 1]), spread(felt[a, 2])
                    gx, gy, gz = spread(felt[b, 0]), spread(felt[b, 1]), spread(felt[b, 2])
                for pack in range(first, ended):
                    if felt.ndim == 4:
                        at = 3 * (a * modal.shape[0] + pack) * lanes
                        fx, fy, fz = load(flat_felt, at), load(flat_felt, at + lanes), load(flat_felt, at + 2 * lanes)
                        at = 3 * (b * modal.shape[0] + pack) * lanes
                        gx, gy, gz = load(flat_felt, at), load(flat_felt, at + lanes), load(flat_felt, at + 2 * lanes)
                    at = (6 * pack * modes + 3) * lanes
                    au, av, aw, bu, bv, bw = _two_sums(flat_modal, at, flat_q, a * modes, b * modes, modes)
                    squared_a, squared_b = au * au + av * av + aw * aw, bu * bu + bv * bv + bw * bw
                    worst_a, worst_b = larger(squared_a, worst_a), larger(squared_b, worst_b)
                    second_a, third_a = packed_coefficients(squared_a, powers)
                    second_b, third_b = packed_coefficients(squared_b, powers)
                    # R^T f = f - c1 w x f + c2 w x (w x f), with c1 = 1 - |w|^2 c3.
                    ax, ay, az = _turned(fx, fy, fz, au, av, aw, squared_a * third_a - one, second_a)
                    bx, by, bz = _turned(gx, gy, gz, bu, bv, bw, squared_b * third_b - one, second_b)
                    m = load(flat_mass, pack * lanes)
                    at = 3 * (pack - first) * lanes
                    store(work, at, m * ax)
                    store(work, at + lanes, m * ay)
                    store(work, at + 2 * lanes, m * az)
                    store(work, at + 3 * BLOCK, m * bx)
                    store(work, at + 3 * BLOCK + lanes, m * by)
                    store(work, at + 3 * BLOCK + 2 * lanes, m * bz)
                if any_above(worst_a, limit):
                    _turn_back_wound_up(first, ended, modal, mass, q[a], felt[a], work[: 3 * BLOCK])
                if any_above(worst_b, limit):
                    _turn_back_wound_up(first, ended, modal, mass, q[b], felt[b], work[3 * BLOCK :])
                for mode in range(modes):
                    sum_a = sum_b = spread(modal.dtype.type(0.0))
                    for pack in range(first, ended):
                        at, k = 6 * (pack * modes + mode) * lanes, 3 * (pack - first) * lanes
                        for i in range(0, 3 * lanes, lanes):
                            row = load(flat_modal, at + i)
                            sum_a, sum_b = sum_a + row * load(work, k + i), sum_b + row * load(work, k + 3 * BLOCK + i)
                    out[a, mode] += total(sum_a)
                    if b != a:
                        out[b, mode] += total(sum_b)


@njit(error_model="numpy", fastmath=False, parallel=True)
def crowd_positions_parallel(parts, level, order, modal, rest, q, powers, poses, out):  # type: ignore[no-untyped-def]
    """:func:`crowd_positions` over ``parts`` equal parts of the chunks, each on a thread."""
    chunks = (order.size + CHUNK - 1) // CHUNK
    for part in prange(parts):
        begin, end = part * chunks // parts, (part + 1) * chunks // parts
        crowd_positions(begin, end, level, order, modal, rest, q, powers, poses, out)


@njit(error_model="numpy", fastmath=False, parallel=True)
def crowd_forces_parallel(order, modal, mass, q, powers, felt, work, out):  # type: ignore[no-untyped-def]
    """:func:`crowd_forces` over as many equal parts of the chunks as ``work`` has rows, each on a thread."""
    parts, chunks = work.shape[0], (order.size + CHUNK - 1) // CHUNK
    for part in prange(parts):
        begin, end = part * chunks // parts, (part + 1) * chunks // parts
        crowd_forces(begin, end, order, modal, mass, q, powers, felt, work[part], out)
