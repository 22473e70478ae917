"""Positions and modal forces of many instances of one shell, over tiles of vertices [choi2007].

The modal data lie in tiles as for one frame (:mod:`modalshell.kernels.frame`). While half a tile is in the first cache,
32 instances take their turns at it, two at a time: what is read for one serves both. The sums of a block are found
first, its rotations then: the long chain of a rotation's operations would keep the sums of the next vertices waiting.
Where the next pair's positions will go is fetched meanwhile. An instance's numbers do not depend on the others of its
batch, but for the last bit where it takes the first place of a pair in one batch and the second in another.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import prange, types
from numba.extending import overload
from numpy.typing import NDArray

from modalshell.kernels.compiler import njit
from modalshell.kernels.frame import HALF_DOUBLE, HALF_SINGLE, MIDDLE, THIRD_DOUBLE, THIRD_SINGLE, TILE
from modalshell.kernels.packed import (
    BYTES,
    any_above,
    larger,
    load,
    prefetch,
    spread,
    spread_from,
    store,
    store_triples,
    total,
)
from modalshell.kernels.rotations import coefficients

RIGID, LINEAR, WARPED = 0, 1, 2
"""Levels of detail."""

CHUNK = 32
"""Instances that take turns at a tile; what a thread does at least."""
BLOCK = 64
"""Vertices of a tile whose modal data these find in the first cache."""

_LIMIT = 2.0 * MIDDLE

_kernel = njit(error_model="numpy", fastmath=False)
_inline = njit(error_model="numpy", fastmath=False, forceinline=True)


def powers(dtype: Any) -> NDArray[Any]:
    """The polynomials of :mod:`modalshell.kernels.frame` as one array: their middle, those of c2, those of c3."""
    single = np.dtype(dtype) == np.float32
    half, third = (HALF_SINGLE, THIRD_SINGLE) if single else (HALF_DOUBLE, THIRD_DOUBLE)
    return np.array([MIDDLE, *half, *third], dtype=dtype)


def work_size(dtype: Any) -> int:
    """Length of the buffer that one thread needs: six rows of a tile or twelve of a block, and one packed vertex."""
    return max(6 * TILE, 12 * BLOCK) + 3 * BYTES // int(np.dtype(dtype).itemsize)


@_inline
def _two_terms(powers, at, s):  # type: ignore[no-untyped-def]
    """``c0 + c1 s``, c0 at ``at`` in ``powers``, c1 before it."""
    return spread_from(powers, at) + s * spread_from(powers, at - 1)


@_inline
def _four_terms(powers, at, s, s2):  # type: ignore[no-untyped-def]
    """``c0 + c1 s + c2 s^2 + c3 s^3``, c0 at ``at`` in ``powers``, the others before it."""
    return _two_terms(powers, at, s) + s2 * _two_terms(powers, at - 2, s)


def _coefficients(squared: Any, powers: Any) -> Any:
    """c2 and c3 at packed |w|^2 in [0, (2 pi)^2]."""
    raise NotImplementedError


@overload(_coefficients, jit_options={"forceinline": True})
def _packed_coefficients(squared, powers):  # type: ignore[no-untyped-def] # noqa: ARG001
    single = squared.scalar == types.float32
    halves = len(HALF_SINGLE) if single else len(HALF_DOUBLE)
    last = halves + (len(THIRD_SINGLE) if single else len(THIRD_DOUBLE))

    # By Estrin's scheme: sums of two and of four terms do not wait for one another, as all of Horner's do.
    def in_double(squared, powers):  # type: ignore[no-untyped-def]
        s = squared - spread_from(powers, 0)
        s2 = s * s
        s4 = s2 * s2
        high = _two_terms(powers, halves - 8, s)
        half = _four_terms(powers, halves, s, s2) + s4 * (_four_terms(powers, halves - 4, s, s2) + s4 * high)
        high = _four_terms(powers, last - 8, s, s2)
        return half * half, _four_terms(powers, last, s, s2) + s4 * (_four_terms(powers, last - 4, s, s2) + s4 * high)

    def in_single(squared, powers):  # type: ignore[no-untyped-def]
        s = squared - spread_from(powers, 0)
        s2 = s * s
        s4 = s2 * s2
        high = _two_terms(powers, halves - 4, s) + s2 * spread_from(powers, halves - 6)
        half = _four_terms(powers, halves, s, s2) + s4 * high
        return half * half, _four_terms(powers, last, s, s2) + s4 * _four_terms(powers, last - 4, s, s2)

    return in_single if single else in_double


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
def _two_sums(modal, at, q, a, b, modes):  # type: ignore[no-untyped-def]
    """``sum_k q_k modal_k`` of three rows from ``at`` on, for the coordinates from ``a`` and from ``b`` on in ``q``."""
    qa, qb = spread_from(q, a), spread_from(q, b)
    row = load(modal, at)
    ax, bx = qa * row, qb * row
    row = load(modal, at + TILE)
    ay, by = qa * row, qb * row
    row = load(modal, at + 2 * TILE)
    az, bz = qa * row, qb * row
    for k in range(1, modes):
        at += 6 * TILE
        qa, qb = spread_from(q, a + k), spread_from(q, b + k)
        row = load(modal, at)
        ax, bx = ax + qa * row, bx + qb * row
        row = load(modal, at + TILE)
        ay, by = ay + qa * row, by + qb * row
        row = load(modal, at + 2 * TILE)
        az, bz = az + qa * row, bz + qb * row
    return ax, ay, az, bx, by, bz


@_inline
def _two_sums_of_six(modal, at, q, a, b, modes):  # type: ignore[no-untyped-def]
    """:func:`_two_sums` of six rows: twelve sums at once hide more of each other's latency than twice six."""
    qa, qb = spread_from(q, a), spread_from(q, b)
    row = load(modal, at)
    ax, bx = qa * row, qb * row
    row = load(modal, at + TILE)
    ay, by = qa * row, qb * row
    row = load(modal, at + 2 * TILE)
    az, bz = qa * row, qb * row
    row = load(modal, at + 3 * TILE)
    au, bu = qa * row, qb * row
    row = load(modal, at + 4 * TILE)
    av, bv = qa * row, qb * row
    row = load(modal, at + 5 * TILE)
    aw, bw = qa * row, qb * row
    for k in range(1, modes):
        at += 6 * TILE
        qa, qb = spread_from(q, a + k), spread_from(q, b + k)
        row = load(modal, at)
        ax, bx = ax + qa * row, bx + qb * row
        row = load(modal, at + TILE)
        ay, by = ay + qa * row, by + qb * row
        row = load(modal, at + 2 * TILE)
        az, bz = az + qa * row, bz + qb * row
        row = load(modal, at + 3 * TILE)
        au, bu = au + qa * row, bu + qb * row
        row = load(modal, at + 4 * TILE)
        av, bv = av + qa * row, bv + qb * row
        row = load(modal, at + 5 * TILE)
        aw, bw = aw + qa * row, bw + qb * row
    return ax, ay, az, au, av, aw, bx, by, bz, bu, bv, bw


@_inline
def _keep(work, at, x, y, z):  # type: ignore[no-untyped-def]
    """Write x, y and z to rows of a block, the first at ``at``."""
    store(work, at, x)
    store(work, at + BLOCK, y)
    store(work, at + 2 * BLOCK, z)


@_inline
def _kept(work, at):  # type: ignore[no-untyped-def]
    """What :func:`_keep` has written."""
    return load(work, at), load(work, at + BLOCK), load(work, at + 2 * BLOCK)


@_kernel
def _wound_up(tile, size, modal, rest, q, pose, out):  # type: ignore[no-untyped-def]
    """Positions of one tile of one instance, vertex by vertex, whatever the angles; ``out`` is (3 size,)."""
    for j in range(size):
        sums = np.zeros(6)
        for mode in range(q.size):
            for row in range(6):
                sums[row] += q[mode] * modal[tile, mode, row * TILE + j]
        wx, wy, wz = sums[3], sums[4], sums[5]
        _, second, third = coefficients(wx, wy, wz)
        x, y, z = _turned(sums[0], sums[1], sums[2], wx, wy, wz, second, third)
        x, y, z = x + rest[tile, j], y + rest[tile, TILE + j], z + rest[tile, 2 * TILE + j]
        for axis in range(3):
            if pose.size:
                row = pose[3 * axis : 3 * axis + 3]
                out[3 * j + axis] = row[0] * x + row[1] * y + row[2] * z + pose[9 + axis]
            else:
                out[3 * j + axis] = (x, y, z)[axis]


@_kernel
def crowd_positions(begin, end, level, order, modal, rest, q, powers, poses, work, out):  # type: ignore[no-untyped-def]
    """``out_b = R_b (rest + u_b) + t_b`` (B, n, 3) of the instances b of ``order`` (k,), u at ``level``, at q (B, m).

    Of ``order`` the chunks ``begin`` to ``end - 1`` are taken. ``modal`` (tiles, m, 6 * 128) and ``rest``
    (tiles, 3 * 128) are padded with zeros; ``poses`` (B, 12) hold R and t, or are (0, 12) where instances stay.
    """
    vertices, modes = out.shape[1], q.shape[1]
    lanes = BYTES // out.itemsize
    limit = modal.dtype.type(_LIMIT)
    moved = poses.shape[0] > 0
    flat_modal, flat_rest, flat_q, flat_poses = modal.reshape(-1), rest.reshape(-1), q.reshape(-1), poses.reshape(-1)
    flat = out.reshape(-1)
    for chunk in range(begin, end):
        last = min((chunk + 1) * CHUNK, order.size)
        for tile in range(modal.shape[0]):
            size = min(TILE, vertices - tile * TILE)
            for begun in range(0, size, BLOCK):
                ended = min(begun + BLOCK, size)
                for pair in range(chunk * CHUNK, last, 2):
                    a, b = order[pair], order[min(pair + 1, last - 1)]
                    worst_a = worst_b = spread(limit)
                    next_a, next_b = order[min(pair + 2, last - 1)], order[min(pair + 3, last - 1)]
                    if level == WARPED:
                        for j in range(begun, ended, lanes):
                            at, k = 6 * tile * modes * TILE + j, j - begun
                            ax, ay, az, au, av, aw, bx, by, bz, bu, bv, bw = _two_sums_of_six(
                                flat_modal, at, flat_q, a * modes, b * modes, modes
                            )
                            _keep(work, k, ax, ay, az)
                            _keep(work, k + 3 * BLOCK, au, av, aw)
                            _keep(work, k + 6 * BLOCK, bx, by, bz)
                            _keep(work, k + 9 * BLOCK, bu, bv, bw)
                    for j in range(begun, ended, lanes):
                        for part in range(0, 3 * lanes, lanes):
                            prefetch(flat, 3 * (next_a * vertices + tile * TILE + j) + part)
                            prefetch(flat, 3 * (next_b * vertices + tile * TILE + j) + part)
                        at = 3 * tile * TILE + j
                        x, y, z = load(flat_rest, at), load(flat_rest, at + TILE), load(flat_rest, at + 2 * TILE)
                        ax, ay, az, bx, by, bz = x, y, z, x, y, z
                        if level != RIGID:
                            at = 6 * tile * modes * TILE + j
                            if level == LINEAR:
                                ax, ay, az, bx, by, bz = _two_sums(flat_modal, at, flat_q, a * modes, b * modes, modes)
                            else:
                                k = j - begun
                                ax, ay, az = _kept(work, k)
                                au, av, aw = _kept(work, k + 3 * BLOCK)
                                bx, by, bz = _kept(work, k + 6 * BLOCK)
                                bu, bv, bw = _kept(work, k + 9 * BLOCK)
                                squared_a, squared_b = au * au + av * av + aw * aw, bu * bu + bv * bv + bw * bw
                                worst_a, worst_b = larger(squared_a, worst_a), larger(squared_b, worst_b)
                                second_a, third_a = _coefficients(squared_a, powers)
                                second_b, third_b = _coefficients(squared_b, powers)
                                ax, ay, az = _turned(ax, ay, az, au, av, aw, second_a, third_a)
                                bx, by, bz = _turned(bx, by, bz, bu, bv, bw, second_b, third_b)
                            ax, ay, az, bx, by, bz = ax + x, ay + y, az + z, bx + x, by + y, bz + z
                        if moved:
                            ax, ay, az = _placed(ax, ay, az, flat_poses, 12 * a)
                            bx, by, bz = _placed(bx, by, bz, flat_poses, 12 * b)
                        to_a, to_b = 3 * (a * vertices + tile * TILE + j), 3 * (b * vertices + tile * TILE + j)
                        if j + lanes <= size:
                            store_triples(flat, to_a, ax, ay, az)
                            store_triples(flat, to_b, bx, by, bz)
                        else:
                            store_triples(work, 12 * BLOCK, ax, ay, az)
                            for i in range(3 * (size - j)):
                                flat[to_a + i] = work[12 * BLOCK + i]
                            store_triples(work, 12 * BLOCK, bx, by, bz)
                            for i in range(3 * (size - j)):
                                flat[to_b + i] = work[12 * BLOCK + i]
                    if any_above(worst_a, limit):
                        start = 3 * (a * vertices + tile * TILE)
                        _wound_up(tile, size, modal, rest, q[a], poses[a : a + 1].ravel(), flat[start:])
                    if any_above(worst_b, limit):
                        start = 3 * (b * vertices + tile * TILE)
                        _wound_up(tile, size, modal, rest, q[b], poses[b : b + 1].ravel(), flat[start:])


@_kernel
def _turn_back_wound_up(tile, modal, mass, q, felt, work):  # type: ignore[no-untyped-def]
    """``mass R(w)^T felt`` of one tile of one instance into ``work`` (3 * 128,), vertex by vertex."""
    for j in range(TILE):
        w = np.zeros(3)
        for mode in range(q.size):
            for row in range(3):
                w[row] += q[mode] * modal[tile, mode, (3 + row) * TILE + j]
        first, second, _ = coefficients(w[0], w[1], w[2])
        turned = _turned(felt[0], felt[1], felt[2], w[0], w[1], w[2], -first, second)
        for axis in range(3):
            work[axis * TILE + j] = mass[tile, j] * turned[axis]


@_kernel
def crowd_forces(begin, end, order, modal, mass, q, powers, felt, work, out):  # type: ignore[no-untyped-def]
    """Modal forces ``Phi^T R(Psi q_b)^T (mass felt_b)`` (B, m) of the instances b of ``order``, from zeros.

    ``mass`` (tiles, 128) is padded with zeros; ``felt`` (B, 3) is one acceleration for all vertices of an instance.
    """
    modes = q.shape[1]
    lanes = BYTES // modal.itemsize
    limit = modal.dtype.type(_LIMIT)
    flat_modal, flat_mass, flat_q = modal.reshape(-1), mass.reshape(-1), q.reshape(-1)
    one = spread(modal.dtype.type(1.0))
    for chunk in range(begin, end):
        last = min((chunk + 1) * CHUNK, order.size)
        for tile in range(modal.shape[0]):
            for pair in range(chunk * CHUNK, last, 2):
                a, b = order[pair], order[min(pair + 1, last - 1)]
                worst_a = worst_b = spread(limit)
                fx, fy, fz = spread(felt[a, 0]), spread(felt[a, 1]), spread(felt[a, 2])
                gx, gy, gz = spread(felt[b, 0]), spread(felt[b, 1]), spread(felt[b, 2])
                for j in range(0, TILE, lanes):
                    at = (6 * tile * modes + 3) * TILE + j
                    au, av, aw, bu, bv, bw = _two_sums(flat_modal, at, flat_q, a * modes, b * modes, modes)
                    squared_a, squared_b = au * au + av * av + aw * aw, bu * bu + bv * bv + bw * bw
                    worst_a, worst_b = larger(squared_a, worst_a), larger(squared_b, worst_b)
                    second_a, third_a = _coefficients(squared_a, powers)
                    second_b, third_b = _coefficients(squared_b, powers)
                    # R^T f = f - c1 w x f + c2 w x (w x f), with c1 = 1 - |w|^2 c3.
                    ax, ay, az = _turned(fx, fy, fz, au, av, aw, squared_a * third_a - one, second_a)
                    bx, by, bz = _turned(gx, gy, gz, bu, bv, bw, squared_b * third_b - one, second_b)
                    m = load(flat_mass, tile * TILE + j)
                    store(work, j, m * ax)
                    store(work, TILE + j, m * ay)
                    store(work, 2 * TILE + j, m * az)
                    store(work, 3 * TILE + j, m * bx)
                    store(work, 4 * TILE + j, m * by)
                    store(work, 5 * TILE + j, m * bz)
                if any_above(worst_a, limit):
                    _turn_back_wound_up(tile, modal, mass, q[a], felt[a], work[: 3 * TILE])
                if any_above(worst_b, limit):
                    _turn_back_wound_up(tile, modal, mass, q[b], felt[b], work[3 * TILE :])
                for mode in range(modes):
                    at = 6 * (tile * modes + mode) * TILE
                    row = load(flat_modal, at)
                    sum_a, sum_b = row * load(work, 0), row * load(work, 3 * TILE)
                    for i in range(lanes, 3 * TILE, lanes):
                        row = load(flat_modal, at + i)
                        sum_a, sum_b = sum_a + row * load(work, i), sum_b + row * load(work, 3 * TILE + i)
                    out[a, mode] += total(sum_a)
                    if b != a:
                        out[b, mode] += total(sum_b)


@njit(error_model="numpy", fastmath=False, parallel=True)
def crowd_positions_parallel(level, order, modal, rest, q, powers, poses, work, out):  # type: ignore[no-untyped-def]
    """:func:`crowd_positions` over as many equal parts of the chunks as ``work`` has rows, each on a thread."""
    parts, chunks = work.shape[0], (order.size + CHUNK - 1) // CHUNK
    for part in prange(parts):
        begin, end = part * chunks // parts, (part + 1) * chunks // parts
        crowd_positions(begin, end, level, order, modal, rest, q, powers, poses, work[part], out)


@njit(error_model="numpy", fastmath=False, parallel=True)
def crowd_forces_parallel(order, modal, mass, q, powers, felt, work, out):  # type: ignore[no-untyped-def]
    """:func:`crowd_forces` over as many equal parts of the chunks as ``work`` has rows, each on a thread."""
    parts, chunks = work.shape[0], (order.size + CHUNK - 1) // CHUNK
    for part in prange(parts):
        begin, end = part * chunks // parts, (part + 1) * chunks // parts
        crowd_forces(begin, end, order, modal, mass, q, powers, felt, work[part], out)
