"""One frame of modal warping in one pass over tiles of vertices [choi2007, eq. 17].

A tile is 128 vertices. Its modal data are one block (modes, 6 * 128) with the rows ``Phi_x, Phi_y, Phi_z, Psi_x, Psi_y,
Psi_z`` of each mode one after the other, so that a frame reads one stream from start to end, and everything between
lives in a buffer of 8 kB. Every inner loop runs along the vertices of a tile and compiles to packed instructions.

The averaged rotation that a frame applies is within 1e-14 (float64) or 1e-6 (float32) of that of its rotation vector
as it is summed, in the Frobenius norm and relative to it, up to 20 rad; beyond, float64 is within 4.5e-16 for every
radian.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import prange, types
from numba.extending import overload

from modalshell.kernels.compiler import UNCOUNTED, njit
from modalshell.kernels.rotations import coefficients

TILE = 128
"""Vertices in a tile."""
WORK = 8 * TILE
"""Length of the buffer that one thread needs: six rows of sums, two of coefficients."""
_PART = 4096
"""Sums that are added to at a time, to stay near."""

# The coefficients of the warp at s = |w|^2 in [0, (2 pi)^2]: c2 = half(s)^2 and c3 = third(s) with
#     half(s) = sin(sqrt(s) / 2) / sqrt(s / 2),    third(s) = (sqrt(s) - sin(sqrt(s))) / sqrt(s)^3,
# both entire functions of s, as polynomials in s - MIDDLE (highest power first): about the middle of the interval the
# terms do not cancel, which is worth a factor of four in float32. Fitted by mpmath.chebyfit(f, [-MIDDLE, MIDDLE], N)
# with N coefficients and 60 digits; tests/reduction/test_warp_frame.py fits them anew. Largest error of half and third,
# rounding included: 5e-16 and 2e-16 in float64, 1.2e-7 and 3e-8 in float32.
MIDDLE = 2.0 * math.pi**2
LIMIT = 2.0 * MIDDLE
"""|w|^2 at a whole turn."""
# fmt: off
HALF_DOUBLE = (
    -1.970995826023855e-23, 2.6630043678714672e-20, -2.8512859150151146e-17, 2.3480015822503398e-14,
    -1.4273316403394639e-11, 6.057790251825824e-09, -1.6544855210782151e-06, 0.0002549949781043579,
    -0.017264407672919285, 0.25327701242816103,
)
THIRD_DOUBLE = (
    -4.5933564584126315e-26, 2.689184288516269e-23, -1.3175205552822534e-20, 5.3463146131704165e-18,
    -1.7551767288564363e-15, 4.544340286596682e-13, -8.983165706137499e-11, 1.2995501844786924e-08,
    -1.299436467575328e-06, 8.301822733223345e-05, -0.003060042337653349, 0.061651624772475815,
)
HALF_SINGLE = tuple(np.float32(c) for c in (
    2.34981739e-14, -1.42927648e-11, 6.05778671e-09, -1.65448173e-06, 0.000254994978, -0.0172644079, 0.253277012,
))
THIRD_SINGLE = tuple(np.float32(c) for c in (
    -1.76546298e-15, 4.58611493e-13, -8.98291507e-11, 1.29944837e-08, -1.29943666e-06, 8.30183067e-05, -0.00306004234,
    0.0616516238,
))
# fmt: on

# Not "nnan" nor "ninf": coordinates that are not finite must come out as such.
FASTMATH = {"contract", "reassoc", "nsz", "arcp"}
_kernel = njit(error_model="numpy", fastmath=FASTMATH, **UNCOUNTED)


def polynomials(squared: Any) -> Any:
    """c2 and c3 at |w|^2 = ``squared`` in [0, (2 pi)^2], in the precision of ``squared``; for compiled code only."""
    raise NotImplementedError


@overload(polynomials, jit_options={"fastmath": FASTMATH})
def _polynomials_by_precision(squared):  # type: ignore[no-untyped-def]
    single = squared == types.float32
    middle: Any = (np.float32 if single else np.float64)(MIDDLE)
    half_powers: Any = HALF_SINGLE if single else HALF_DOUBLE
    third_powers: Any = THIRD_SINGLE if single else THIRD_DOUBLE
    halves, thirds = len(half_powers), len(third_powers)

    def evaluate(squared):  # type: ignore[no-untyped-def]
        s = squared - middle
        half = half_powers[0]
        for k in range(1, halves):
            half = half * s + half_powers[k]
        third = third_powers[0]
        for k in range(1, thirds):
            third = third * s + third_powers[k]
        return half * half, third

    return evaluate


@_kernel
def rotation_coefficients(work):  # type: ignore[no-untyped-def]
    """Write c2 and c3 of the rotation vectors in rows 3 to 5 of ``work`` (8 * 128,) into rows 6 and 7."""
    beyond = 0
    for j in range(TILE):
        wx, wy, wz = work[3 * TILE + j], work[4 * TILE + j], work[5 * TILE + j]
        squared = wx * wx + wy * wy + wz * wz
        beyond += squared > LIMIT
        work[6 * TILE + j], work[7 * TILE + j] = polynomials(squared)
    if beyond:
        for j in range(TILE):
            wx, wy, wz = work[3 * TILE + j], work[4 * TILE + j], work[5 * TILE + j]
            _, work[6 * TILE + j], work[7 * TILE + j] = coefficients(np.float64(wx), np.float64(wy), np.float64(wz))


@_kernel
def warp_tiles(first, last, modal, rest, q, work, out):  # type: ignore[no-untyped-def]
    """Write ``rest + Rt(Psi q) Phi q`` of the tiles ``first`` to ``last - 1`` into ``out`` (n, 3).

    ``modal`` (tiles, m, 6 * 128) and ``rest`` (tiles, 3 * 128) are padded with zeros; ``work`` is (WORK,); all of them
    and ``q`` (m,) are of one precision.
    """
    for tile in range(first, last):
        # Six rows: the linear displacement, then the rotation vector.
        for i in range(6 * TILE):
            work[i] = q[0] * modal[tile, 0, i]
        for mode in range(1, q.size):
            amount = q[mode]
            for i in range(6 * TILE):
                work[i] += amount * modal[tile, mode, i]
        rotation_coefficients(work)
        for j in range(TILE):
            ux, uy, uz = work[j], work[TILE + j], work[2 * TILE + j]
            wx, wy, wz = work[3 * TILE + j], work[4 * TILE + j], work[5 * TILE + j]
            linear, quadratic = work[6 * TILE + j], work[7 * TILE + j]
            cx, cy, cz = wy * uz - wz * uy, wz * ux - wx * uz, wx * uy - wy * ux
            work[j] = rest[tile, j] + (ux + linear * cx + quadratic * (wy * cz - wz * cy))
            work[TILE + j] = rest[tile, TILE + j] + (uy + linear * cy + quadratic * (wz * cx - wx * cz))
            work[2 * TILE + j] = rest[tile, 2 * TILE + j] + (uz + linear * cz + quadratic * (wx * cy - wy * cx))
        start = tile * TILE
        for j in range(min(TILE, out.shape[0] - start)):
            out[start + j, 0] = work[j]
            out[start + j, 1] = work[TILE + j]
            out[start + j, 2] = work[2 * TILE + j]


@njit(error_model="numpy", fastmath=False, **UNCOUNTED)
def add_lines(lines, q, begin, out):  # type: ignore[no-untyped-def]
    """Write ``begin + lines^T q`` into ``out`` (k,), by ``lines`` (m, k); zero for ``begin`` where that is empty."""
    for first in range(0, out.size, _PART):
        own = out[first : first + _PART]
        last, mode = first + own.size, 0
        for i in range(own.size):
            own[i] = begin[first + i] if begin.size else 0.0
        while mode + 2 <= q.size:
            a, b, one, two = q[mode], q[mode + 1], lines[mode, first:last], lines[mode + 1, first:last]
            for i in range(own.size):
                own[i] = (own[i] + a * one[i]) + b * two[i]
            mode += 2
        if mode < q.size:
            a, one = q[mode], lines[mode, first:last]
            for i in range(own.size):
                own[i] += a * one[i]


@_kernel
def warp_frame(modal, rest, q, work, out):  # type: ignore[no-untyped-def]
    """:func:`warp_tiles` over all tiles on the calling thread; ``work`` is (1, WORK)."""
    warp_tiles(0, modal.shape[0], modal, rest, q, work[0], out)


@njit(error_model="numpy", fastmath=False, parallel=True)
def warp_frame_parallel(modal, rest, q, work, out):  # type: ignore[no-untyped-def]
    """:func:`warp_tiles` over as many equal parts as ``work`` (parts, WORK) has rows, each on a thread."""
    parts = work.shape[0]
    tiles = modal.shape[0]
    for part in prange(parts):
        warp_tiles(part * tiles // parts, (part + 1) * tiles // parts, modal, rest, q, work[part], out)
