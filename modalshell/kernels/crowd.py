"""Many instances of one shell at once: their positions and their modal forces, over tiles of vertices [choi2007].

The modal data lie in tiles as for one frame (:mod:`modalshell.kernels.frame`) and stay in the second cache while the
instances take their turns; eight modes are summed in one pass over the buffer, and only positions are written out. An
instance's numbers do not depend on the others of its batch.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from modalshell.kernels.frame import FASTMATH, TILE, rotation_coefficients

RIGID, LINEAR, WARPED = 0, 1, 2
"""Levels of detail."""

_kernel = njit(cache=True, error_model="numpy", fastmath=FASTMATH)


@_kernel
def _sum_modes(modal, q, first, last, work):  # type: ignore[no-untyped-def]
    """``work[first:last] = sum_k q_k modal[k, first:last]``, eight modes a pass and the rest one by one."""
    whole = q.size // 8 * 8
    if whole == 0:
        work[first:last] = 0.0
    for mode in range(0, whole, 8):
        a, b, c, d = q[mode], q[mode + 1], q[mode + 2], q[mode + 3]
        e, f, g, h = q[mode + 4], q[mode + 5], q[mode + 6], q[mode + 7]
        m0, m1, m2, m3 = modal[mode], modal[mode + 1], modal[mode + 2], modal[mode + 3]
        m4, m5, m6, m7 = modal[mode + 4], modal[mode + 5], modal[mode + 6], modal[mode + 7]
        if mode == 0:
            for i in range(first, last):
                half = a * m0[i] + b * m1[i] + c * m2[i] + d * m3[i]
                work[i] = half + (e * m4[i] + f * m5[i] + g * m6[i] + h * m7[i])
        else:
            for i in range(first, last):
                half = a * m0[i] + b * m1[i] + c * m2[i] + d * m3[i]
                work[i] += half + (e * m4[i] + f * m5[i] + g * m6[i] + h * m7[i])
    for mode in range(whole, q.size):
        a, m0 = q[mode], modal[mode]
        for i in range(first, last):
            work[i] += a * m0[i]


@_kernel
def _displacements(modal, q, level, work):  # type: ignore[no-untyped-def]
    """Displacements of a tile at a level into the first three rows of ``work``."""
    if level == RIGID:
        work[: 3 * TILE] = 0.0
        return
    if level == LINEAR:
        _sum_modes(modal, q, 0, 3 * TILE, work)
        return
    _sum_modes(modal, q, 0, 6 * TILE, work)
    rotation_coefficients(work)
    for j in range(TILE):
        ux, uy, uz = work[j], work[TILE + j], work[2 * TILE + j]
        wx, wy, wz = work[3 * TILE + j], work[4 * TILE + j], work[5 * TILE + j]
        linear, quadratic = work[6 * TILE + j], work[7 * TILE + j]
        cx, cy, cz = wy * uz - wz * uy, wz * ux - wx * uz, wx * uy - wy * ux
        work[j] = ux + linear * cx + quadratic * (wy * cz - wz * cy)
        work[TILE + j] = uy + linear * cy + quadratic * (wz * cx - wx * cz)
        work[2 * TILE + j] = uz + linear * cz + quadratic * (wx * cy - wy * cx)


@_kernel
def _place(rest, rotation, translation, work):  # type: ignore[no-untyped-def]
    """Positions ``R (rest + u) + t`` of a tile in place of its displacements u, the first three rows of ``work``."""
    xx, xy, xz = rotation[0, 0], rotation[0, 1], rotation[0, 2]
    yx, yy, yz = rotation[1, 0], rotation[1, 1], rotation[1, 2]
    zx, zy, zz = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    tx, ty, tz = translation[0], translation[1], translation[2]
    for j in range(TILE):
        x, y, z = rest[j] + work[j], rest[TILE + j] + work[TILE + j], rest[2 * TILE + j] + work[2 * TILE + j]
        work[j] = xx * x + xy * y + xz * z + tx
        work[TILE + j] = yx * x + yy * y + yz * z + ty
        work[2 * TILE + j] = zx * x + zy * y + zz * z + tz


@_kernel
def _interleave(work, out):  # type: ignore[no-untyped-def]
    """Rows x, y, z of ``work`` as vertex after vertex into ``out`` (3 size,)."""
    for j in range(out.size // 3):
        out[3 * j], out[3 * j + 1], out[3 * j + 2] = work[j], work[TILE + j], work[2 * TILE + j]


@_kernel
def crowd_positions(modal, rest, q, levels, rotations, translations, work, out):  # type: ignore[no-untyped-def]
    """``out_b = R_b (rest + u_b) + t_b`` (B, n, 3) of instances at q (B, m), u at each one's level (B,).

    ``modal`` (tiles, m, 6 * 128) and ``rest`` (tiles, 3 * 128) are padded with zeros; ``rotations`` (B, 3, 3) and
    ``translations`` (B, 3) place the instances; ``work`` is (8 * 128,).
    """
    count, vertices = out.shape[0], out.shape[1]
    flat = out.reshape(count, 3 * vertices)
    for b in range(count):
        for tile in range(modal.shape[0]):
            start = tile * TILE
            size = min(TILE, vertices - start)
            _displacements(modal[tile], q[b], levels[b], work)
            _place(rest[tile], rotations[b], translations[b], work)
            _interleave(work, flat[b, 3 * start : 3 * (start + size)])


@_kernel
def crowd_forces(modal, mass, q, levels, felt, work, out):  # type: ignore[no-untyped-def]
    """Modal forces ``Phi^T R(Psi q_b)^T (mass felt_b)`` (B, m) of warped instances, R = I for the other levels.

    ``mass`` (tiles, 128) is padded with zeros; ``felt`` (B, 3) is one acceleration for all vertices of an instance.
    """
    out[:] = 0.0
    for b in range(q.shape[0]):
        fx, fy, fz = felt[b]
        for tile in range(modal.shape[0]):
            if levels[b] == WARPED:
                _sum_modes(modal[tile], q[b], 3 * TILE, 6 * TILE, work)
                rotation_coefficients(work)
                for j in range(TILE):
                    # R^T f = f - c1 w x f + c2 w x (w x f), with c1 = 1 - |w|^2 c3.
                    wx, wy, wz = work[3 * TILE + j], work[4 * TILE + j], work[5 * TILE + j]
                    second, third = work[6 * TILE + j], work[7 * TILE + j]
                    first = 1.0 - (wx * wx + wy * wy + wz * wz) * third
                    cx, cy, cz = wy * fz - wz * fy, wz * fx - wx * fz, wx * fy - wy * fx
                    m = mass[tile, j]
                    work[j] = m * (fx - first * cx + second * (wy * cz - wz * cy))
                    work[TILE + j] = m * (fy - first * cy + second * (wz * cx - wx * cz))
                    work[2 * TILE + j] = m * (fz - first * cz + second * (wx * cy - wy * cx))
            else:
                for j in range(TILE):
                    m = mass[tile, j]
                    work[j], work[TILE + j], work[2 * TILE + j] = m * fx, m * fy, m * fz
            for mode in range(q.shape[1]):
                total = work[0] * modal[tile, mode, 0]
                for i in range(1, 3 * TILE):
                    total += work[i] * modal[tile, mode, i]
                out[b, mode] += total


@_kernel
def switch_errors(modal, q, vertices, work, out):  # type: ignore[no-untyped-def]
    """Largest displacement and largest distance between linear and warped positions of each instance, (B, 2)."""
    linear = np.empty(3 * TILE, q.dtype)
    out[:] = 0.0
    for b in range(q.shape[0]):
        for tile in range(modal.shape[0]):
            _sum_modes(modal[tile], q[b], 0, 3 * TILE, linear)
            _displacements(modal[tile], q[b], WARPED, work)
            for j in range(min(TILE, vertices - tile * TILE)):
                length = gap = 0.0
                for axis in range(3):
                    u = linear[axis * TILE + j]
                    length += u * u
                    gap += (u - work[axis * TILE + j]) ** 2
                out[b, 0] = max(out[b, 0], length)
                out[b, 1] = max(out[b, 1], gap)
        out[b, 0], out[b, 1] = math.sqrt(out[b, 0]), math.sqrt(out[b, 1])
