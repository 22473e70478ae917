r"""Kernels of the rotation-strain warp [huang2011]: positions, potential, force and Hessian.

Every triangle has its own frame (a, b, n): a along its first edge, n normal. In it, modal coordinates q give a rotation
vector :math:`w = \sum_k q_k w_k` and a surface strain :math:`S = \sum_k q_k S_k` (s_aa, s_bb, s_ab), and the tangents
become the columns a and b of

.. math:: F = e^{[w]} (I + S), \qquad e^{[w]} = \cos\phi\,I + c_1 [w] + c_2 w w^T .

The potential of a load whose adjoint gradient on the triangle is (g_a, g_b) is
:math:`\psi = g_a \cdot (F_a - a) + g_b \cdot (F_b - b)`. With :math:`N = (g_a, g_b, 0)(I + S)` and a constant,
:math:`\psi = \langle N, e^{[w]} \rangle`, so that, a bar denoting the axial vector of N and the prime d/d(phi^2),

.. math:: \psi = \cos\phi\,\mathrm{tr} N + c_1 \bar N \cdot w + c_2 w^T N w, \qquad
          \partial_w \psi = c_1 \bar N + c_2 (N + N^T) w + 2 \alpha w, \quad
          \alpha = -\tfrac12 c_1 \mathrm{tr} N + c_1' \bar N \cdot w + c_2' w^T N w .

F, and per unit of g the potential and its derivatives, are within ``3e-14 + 2^-52 |w|`` of the exact ones: ``c_1`` is
found as ``1 - |w|^2 c_3``, which within a turn costs the last digit of c_3 and beyond it the digits before the point.

Triangles come in tiles of 128. Modal data of a tile are (m, 6 * 128): rows w_a, w_b, w_n, s_aa, s_bb, s_ab of each
mode; its shape is (12 * 128): rows a, b, n (three each), then half the height, half the foot of the height and half the
length of the first edge. Padding is zero.
"""

import math

import numpy as np

from modalshell.kernels.compiler import njit
from modalshell.kernels.frame import FASTMATH, TILE, polynomials
from modalshell.kernels.packed import LANES, load, store
from modalshell.kernels.packed import spread as spread_number
from modalshell.kernels.rotations import coefficients

WORK = 14 * TILE
"""Length of the buffer that the kernels work in."""

_TINY = 1e-30
"""Least |w|^2 that is divided by: the numerators vanish there."""
_LIMIT = 39.0  # (2 pi)^2 and a little less: what the polynomials serve

_kernel = njit(error_model="numpy", fastmath=FASTMATH)


@_kernel
def _combine(modal, tile, q, work):  # type: ignore[no-untyped-def]
    """Write w and S of a tile's triangles into rows 0 to 5 of ``work``, c2 and c3 into rows 6 and 7."""
    for i in range(6 * TILE):
        work[i] = q[0] * modal[tile, 0, i]
    for mode in range(1, q.size):
        amount = q[mode]
        for i in range(6 * TILE):
            work[i] += amount * modal[tile, mode, i]
    beyond = 0
    for j in range(TILE):
        x, y, z = work[j], work[TILE + j], work[2 * TILE + j]
        squared = x * x + y * y + z * z
        beyond += squared > _LIMIT
        work[6 * TILE + j], work[7 * TILE + j] = polynomials(squared)
    if beyond:
        for j in range(TILE):
            x, y, z = work[j], work[TILE + j], work[2 * TILE + j]
            _, work[6 * TILE + j], work[7 * TILE + j] = coefficients(x, y, z)


@_kernel
def _columns(j, work):  # type: ignore[no-untyped-def]
    """Columns of F - I of triangle ``j`` in its own frame, without cancellation near rest."""
    x, y, z = work[j], work[TILE + j], work[2 * TILE + j]
    first, second, mixed = work[3 * TILE + j], work[4 * TILE + j], work[5 * TILE + j]
    c2 = work[6 * TILE + j]
    c1 = 1.0 - (x * x + y * y + z * z) * work[7 * TILE + j]
    ax, ay, az = -c2 * (y * y + z * z), c1 * z + c2 * x * y, c2 * x * z - c1 * y
    bx, by, bz = c2 * x * y - c1 * z, -c2 * (x * x + z * z), c1 * x + c2 * y * z
    return (
        ax + first * (1.0 + ax) + mixed * bx,
        ay + first * ay + mixed * (1.0 + by),
        az + first * az + mixed * bz,
        bx + mixed * (1.0 + ax) + second * bx,
        by + mixed * ay + second * (1.0 + by),
        bz + mixed * az + second * bz,
    )


@_kernel
def spread(modal, shape, corners, q, work, right_side):  # type: ignore[no-untyped-def]
    """Right side of the least-squares fit: ``sum_t A_t grad N_i . (F_t - I)`` into ``right_side`` (N + 1, 3).

    ``corners`` (tiles, 3, 128) are rows of ``right_side``; the last row collects what falls on held vertices.
    """
    right_side[:] = 0.0
    for tile in range(modal.shape[0]):
        _combine(modal, tile, q, work)
        _spread_tile(shape, corners, tile, work, right_side)


@_kernel
def _spread_tile(shape, corners, tile, work, right_side):  # type: ignore[no-untyped-def]
    """Add what a tile's triangles spread to ``right_side``, after :func:`_combine`; ``work`` from row 8 on is used."""
    for j in range(TILE):
        ax, ay, az, bx, by, bz = _columns(j, work)
        height, foot, length = shape[tile, 9 * TILE + j], shape[tile, 10 * TILE + j], shape[tile, 11 * TILE + j]
        for axis in range(3):
            a, b, n = (
                shape[tile, axis * TILE + j],
                shape[tile, (3 + axis) * TILE + j],
                shape[tile, (6 + axis) * TILE + j],
            )
            fa = ax * a + ay * b + az * n
            fb = bx * a + by * b + bz * n
            work[(8 + axis) * TILE + j] = height * fa - foot * fb
            work[(11 + axis) * TILE + j] = length * fb
    for j in range(TILE):
        at0, at1, at2 = corners[tile, 0, j], corners[tile, 1, j], corners[tile, 2, j]
        for axis in range(3):
            one, two = work[(8 + axis) * TILE + j], work[(11 + axis) * TILE + j]
            right_side[at0, axis] -= one + two
            right_side[at1, axis] += one
            right_side[at2, axis] += two


@_kernel
def deformations(modal, q, work, out):  # type: ignore[no-untyped-def]
    """Columns of ``F - I`` of every triangle in its own frame into ``out`` (tiles, 6 * 128)."""
    for tile in range(modal.shape[0]):
        _combine(modal, tile, q, work)
        for j in range(TILE):
            ax, ay, az, bx, by, bz = _columns(j, work)
            out[tile, j], out[tile, TILE + j], out[tile, 2 * TILE + j] = ax, ay, az
            out[tile, 3 * TILE + j], out[tile, 4 * TILE + j], out[tile, 5 * TILE + j] = bx, by, bz


@_kernel
def largest_turn(modal, q, work):  # type: ignore[no-untyped-def]
    """Largest rotation angle of a triangle [rad] at q."""
    largest = 0.0
    for tile in range(modal.shape[0]):
        _combine(modal, tile, q, work)
        for j in range(TILE):
            x, y, z = work[j], work[TILE + j], work[2 * TILE + j]
            largest = max(largest, x * x + y * y + z * z)
    return math.sqrt(largest)


@_kernel
def adjoint_gradients(fit, corners, shape, out):  # type: ignore[no-untyped-def]
    """``A_t grad y`` of every triangle in its own frame into ``out`` (tiles, 6 * 128), from ``fit`` (N + 1, 3)."""
    for tile in range(corners.shape[0]):
        for j in range(TILE):
            at0, at1, at2 = corners[tile, 0, j], corners[tile, 1, j], corners[tile, 2, j]
            height, foot, length = shape[tile, 9 * TILE + j], shape[tile, 10 * TILE + j], shape[tile, 11 * TILE + j]
            for row in range(3):
                ga = gb = 0.0
                for axis in range(3):
                    along = shape[tile, (3 * row + axis) * TILE + j]
                    one, two = fit[at1, axis] - fit[at0, axis], fit[at2, axis] - fit[at0, axis]
                    ga += along * height * one
                    gb += along * (length * two - foot * one)
                out[tile, row * TILE + j] = ga
                out[tile, (3 + row) * TILE + j] = gb


@_kernel
def _slope(x, y, z, c1, c2, d1, d2, ax, ay, az, bx, by, bz):  # type: ignore[no-untyped-def]
    """Gradient in w of ``<N, e^[w]>`` for N = (a, b, 0); ``d1`` and ``d2`` are c1' and c2'."""
    aw, bw = ax * x + ay * y + az * z, bx * x + by * y + bz * z
    lx, ly, lz = bz, -az, ay - bx
    alpha = 2.0 * (-0.5 * c1 * (ax + by) + d1 * (lx * x + ly * y + lz * z) + d2 * (x * aw + y * bw))
    return (
        c1 * lx + c2 * (ax * x + bx * y + aw) + alpha * x,
        c1 * ly + c2 * (ay * x + by * y + bw) + alpha * y,
        c1 * lz + c2 * (az * x + bz * y) + alpha * z,
    )


@_kernel
def potential(modal, adjoint, q, work, force):  # type: ignore[no-untyped-def]
    """Potential of the load at q; its gradient is added to ``force`` (m,)."""
    total = 0.0
    for tile in range(modal.shape[0]):
        _combine(modal, tile, q, work)
        total = _potential_of(modal, adjoint, tile, work, total, force)
    return total


@_kernel
def _potential_of(modal, adjoint, tile, work, total, force):  # type: ignore[no-untyped-def]
    """Add what a tile has of :func:`potential`, after :func:`_combine`; ``work`` from row 8 on is used."""
    for j in range(TILE):
        fax, fay, faz, fbx, fby, fbz = _columns(j, work)
        ax, ay, az = adjoint[tile, j], adjoint[tile, TILE + j], adjoint[tile, 2 * TILE + j]
        bx, by, bz = adjoint[tile, 3 * TILE + j], adjoint[tile, 4 * TILE + j], adjoint[tile, 5 * TILE + j]
        total += ax * fax + ay * fay + az * faz + bx * fbx + by * fby + bz * fbz
        x, y, z = work[j], work[TILE + j], work[2 * TILE + j]
        first, second, mixed = work[3 * TILE + j], work[4 * TILE + j], work[5 * TILE + j]
        c2, c3 = work[6 * TILE + j], work[7 * TILE + j]
        squared = x * x + y * y + z * z
        c1 = 1.0 - squared * c3
        # Cancellation in c2' for small w costs nothing: w^T N w shrinks as fast.
        d1, d2 = 0.5 * (c3 - c2), 0.5 * (c1 - 2.0 * c2) / max(squared, _TINY)
        nax, nay, naz = ax + first * ax + mixed * bx, ay + first * ay + mixed * by, az + first * az + mixed * bz
        nbx, nby, nbz = bx + mixed * ax + second * bx, by + mixed * ay + second * by, bz + mixed * az + second * bz
        wx, wy, wz = _slope(x, y, z, c1, c2, d1, d2, nax, nay, naz, nbx, nby, nbz)
        work[8 * TILE + j], work[9 * TILE + j], work[10 * TILE + j] = wx, wy, wz
        # The columns of e^[w].
        rax, ray, raz = 1.0 - c2 * (y * y + z * z), c1 * z + c2 * x * y, c2 * x * z - c1 * y
        rbx, rby, rbz = c2 * x * y - c1 * z, 1.0 - c2 * (x * x + z * z), c1 * x + c2 * y * z
        work[11 * TILE + j] = ax * rax + ay * ray + az * raz
        work[12 * TILE + j] = bx * rbx + by * rby + bz * rbz
        work[13 * TILE + j] = ax * rbx + ay * rby + az * rbz + bx * rax + by * ray + bz * raz
    for mode in range(force.size):
        amount = 0.0
        for i in range(6 * TILE):
            amount += modal[tile, mode, i] * work[8 * TILE + i]
        force[mode] += amount
    return total


@_kernel
def add_curvature(modal, adjoint, q, work, blocks, hessian):  # type: ignore[no-untyped-def]
    """Add the Hessian of :func:`potential` to ``hessian`` (m, m); ``blocks`` is a buffer (15, 128).

    ``blocks`` holds, for each triangle, the second derivatives in w (xx, yy, zz, xy, xz, yz), then the mixed ones in w
    and each of s_aa, s_bb, s_ab; there are none in the strain alone.
    """
    for tile in range(modal.shape[0]):
        _combine(modal, tile, q, work)
        for j in range(TILE):
            ax, ay, az = adjoint[tile, j], adjoint[tile, TILE + j], adjoint[tile, 2 * TILE + j]
            bx, by, bz = adjoint[tile, 3 * TILE + j], adjoint[tile, 4 * TILE + j], adjoint[tile, 5 * TILE + j]
            x, y, z = work[j], work[TILE + j], work[2 * TILE + j]
            first, second, mixed = work[3 * TILE + j], work[4 * TILE + j], work[5 * TILE + j]
            c2, c3 = work[6 * TILE + j], work[7 * TILE + j]
            squared = x * x + y * y + z * z
            inverse = 1.0 / max(squared, _TINY)
            c1 = 1.0 - squared * c3
            d1, d2, d3 = 0.5 * (c3 - c2), 0.5 * (c1 - 2.0 * c2) * inverse, 0.5 * (c2 - 3.0 * c3) * inverse
            e1, e2 = 0.5 * (d3 - d2), 0.5 * (d1 - 4.0 * d2) * inverse  # second derivatives of c1, c2
            blocks[6, j], blocks[7, j], blocks[8, j] = _slope(x, y, z, c1, c2, d1, d2, ax, ay, az, 0.0, 0.0, 0.0)
            blocks[9, j], blocks[10, j], blocks[11, j] = _slope(x, y, z, c1, c2, d1, d2, 0.0, 0.0, 0.0, bx, by, bz)
            blocks[12, j], blocks[13, j], blocks[14, j] = _slope(x, y, z, c1, c2, d1, d2, bx, by, bz, ax, ay, az)
            nax, nay, naz = ax + first * ax + mixed * bx, ay + first * ay + mixed * by, az + first * az + mixed * bz
            nbx, nby, nbz = bx + mixed * ax + second * bx, by + mixed * ay + second * by, bz + mixed * az + second * bz
            aw, bw = nax * x + nay * y + naz * z, nbx * x + nby * y + nbz * z
            lx, ly, lz = nbz, -naz, nay - nbx
            # (N + N^T) w
            mx, my, mz = nax * x + nbx * y + aw, nay * x + nby * y + bw, naz * x + nbz * y
            trace, along, quadratic = nax + nby, lx * x + ly * y + lz * z, x * aw + y * bw
            alpha = 2.0 * (-0.5 * c1 * trace + d1 * along + d2 * quadratic)
            beta = 2.0 * (-0.5 * d1 * trace + e1 * along + e2 * quadratic)
            # w^T v + v^T w with all of c1' axial, c2' (N + N^T) w and the second derivatives in phi^2.
            vx, vy, vz = (
                2.0 * (d1 * lx + d2 * mx) + beta * x,
                2.0 * (d1 * ly + d2 * my) + beta * y,
                2.0 * (d1 * lz + d2 * mz) + beta * z,
            )
            blocks[0, j] = 2.0 * c2 * nax + alpha + 2.0 * x * vx
            blocks[1, j] = 2.0 * c2 * nby + alpha + 2.0 * y * vy
            blocks[2, j] = alpha + 2.0 * z * vz
            blocks[3, j] = c2 * (nay + nbx) + x * vy + y * vx
            blocks[4, j] = c2 * naz + x * vz + z * vx
            blocks[5, j] = c2 * nbz + y * vz + z * vy
        for mode in range(q.size):
            for j in range(TILE):
                x, y, z = modal[tile, mode, j], modal[tile, mode, TILE + j], modal[tile, mode, 2 * TILE + j]
                first, second = modal[tile, mode, 3 * TILE + j], modal[tile, mode, 4 * TILE + j]
                mixed = modal[tile, mode, 5 * TILE + j]
                for row in range(3):
                    work[(8 + row) * TILE + j] = (
                        blocks[6 + row, j] * first + blocks[9 + row, j] * second + blocks[12 + row, j] * mixed
                    )
                work[8 * TILE + j] += blocks[0, j] * x + blocks[3, j] * y + blocks[4, j] * z
                work[9 * TILE + j] += blocks[3, j] * x + blocks[1, j] * y + blocks[5, j] * z
                work[10 * TILE + j] += blocks[4, j] * x + blocks[5, j] * y + blocks[2, j] * z
                for row in range(3):
                    at = 6 + 3 * row
                    work[(11 + row) * TILE + j] = blocks[at, j] * x + blocks[at + 1, j] * y + blocks[at + 2, j] * z
            for other in range(mode + 1):
                amount = 0.0
                for i in range(6 * TILE):
                    amount += modal[tile, other, i] * work[8 * TILE + i]
                hessian[mode, other] += amount
                if other < mode:
                    hessian[other, mode] += amount


@_kernel
def _slopes(shape, tile, normal, work, slopes):  # type: ignore[no-untyped-def]
    """Derivatives of what a tile's triangles spread along a ``normal`` (3,) by turn and strain, after :func:`_combine`.

    ``dF = [Rt(w) dw] F + e^[w] dS``; into ``slopes`` (12, 128): of the first part by the six, then of the second one.
    ``work`` (20 * 128) is written to, too, for the loop to be packed.
    """
    n0, n1, n2 = normal[0], normal[1], normal[2]
    for j in range(TILE):
        x, y, z = work[j], work[TILE + j], work[2 * TILE + j]
        first, second, mixed = work[3 * TILE + j], work[4 * TILE + j], work[5 * TILE + j]
        c2, c3 = work[6 * TILE + j], work[7 * TILE + j]
        c1 = 1.0 - (x * x + y * y + z * z) * c3
        height, foot, length = shape[tile, 9 * TILE + j], shape[tile, 10 * TILE + j], shape[tile, 11 * TILE + j]
        na = shape[tile, j] * n0 + shape[tile, TILE + j] * n1 + shape[tile, 2 * TILE + j] * n2
        nb = shape[tile, 3 * TILE + j] * n0 + shape[tile, 4 * TILE + j] * n1 + shape[tile, 5 * TILE + j] * n2
        nn = shape[tile, 6 * TILE + j] * n0 + shape[tile, 7 * TILE + j] * n1 + shape[tile, 8 * TILE + j] * n2
        ax, ay, az = 1.0 - c2 * (y * y + z * z), c1 * z + c2 * x * y, c2 * x * z - c1 * y
        bx, by, bz = c2 * x * y - c1 * z, 1.0 - c2 * (x * x + z * z), c1 * x + c2 * y * z
        fx, fy, fz = ax + first * ax + mixed * bx, ay + first * ay + mixed * by, az + first * az + mixed * bz
        gx, gy, gz = bx + mixed * ax + second * bx, by + mixed * ay + second * by, bz + mixed * az + second * bz
        # n . ((Rt dw) x F) = dw . Rt^T (F x n), and Rt^T v = v - c2 w x v + c3 w x (w x v).
        px, py, pz = fy * nn - fz * nb, fz * na - fx * nn, fx * nb - fy * na
        rx, ry, rz = gy * nn - gz * nb, gz * na - gx * nn, gx * nb - gy * na
        px, py, pz = height * px - foot * rx, height * py - foot * ry, height * pz - foot * rz
        rx, ry, rz = length * rx, length * ry, length * rz
        kx, ky, kz = y * pz - z * py, z * px - x * pz, x * py - y * px
        work[8 * TILE + j] = px - c2 * kx + c3 * (y * kz - z * ky)
        work[9 * TILE + j] = py - c2 * ky + c3 * (z * kx - x * kz)
        work[10 * TILE + j] = pz - c2 * kz + c3 * (x * ky - y * kx)
        kx, ky, kz = y * rz - z * ry, z * rx - x * rz, x * ry - y * rx
        work[14 * TILE + j] = rx - c2 * kx + c3 * (y * kz - z * ky)
        work[15 * TILE + j] = ry - c2 * ky + c3 * (z * kx - x * kz)
        work[16 * TILE + j] = rz - c2 * kz + c3 * (x * ky - y * kx)
        a, b = na * ax + nb * ay + nn * az, na * bx + nb * by + nn * bz
        work[11 * TILE + j], work[12 * TILE + j], work[13 * TILE + j] = height * a, -foot * b, height * b - foot * a
        work[17 * TILE + j], work[18 * TILE + j], work[19 * TILE + j] = 0.0, length * b, length * a
    for row in range(12):
        for j in range(TILE):
            slopes[row, j] = work[(8 + row) * TILE + j]


@njit(error_model="numpy", fastmath=False)
def deformation_rows(modal, shape, columns, q, out):  # type: ignore[no-untyped-def]
    """Derivatives ``out`` (T, 6, m) of :func:`deformations` by q (m,), of triangles with ``columns`` (T, 6, m).

    The ``shape`` of their tiles has the axes for their frames, and 1, 0 and 1 for sides.
    """
    work, slopes, axes = np.empty(20 * TILE), np.empty((3, 12, TILE)), np.zeros((3, 3))
    axes[0, 0] = axes[1, 1] = axes[2, 2] = 1.0
    for t in range(columns.shape[0]):
        j = t % TILE
        if j == 0:
            _combine(modal, t // TILE, q, work)
            for axis in range(3):
                _slopes(shape, t // TILE, axes[axis], work, slopes[axis])
        for row in range(6):
            own = slopes[row % 3, 6 * (row // 3) : 6 * (row // 3) + 6]
            a0, a1, a2, a3, a4, a5 = own[0, j], own[1, j], own[2, j], own[3, j], own[4, j], own[5, j]
            for k in range(q.size):
                p0, p1, p2 = columns[t, 0, k], columns[t, 1, k], columns[t, 2, k]
                p3, p4, p5 = columns[t, 3, k], columns[t, 4, k], columns[t, 5, k]
                out[t, row, k] = a0 * p0 + a1 * p1 + a2 * p2 + a3 * p3 + a4 * p4 + a5 * p5


@njit(error_model="numpy", fastmath=False)
def spread_rows(modal, shape, columns, corners, q, directions, out, further):  # type: ignore[no-untyped-def]
    """Derivatives ``out`` (N + 1, d, M) of the right side of :func:`spread` along directions (d, 3) by q (m,).

    ``columns`` (T, 6, M) are the turns and strains of the triangles in each mode, ``corners`` (T, 3) rows of ``out``. M
    is m filled up to whole registers. ``further`` are the corners of tiles and the right side itself, which is written
    as well, as of :func:`spread`, or rows of none; and a load's adjoint gradients and a force (m,) to which its own is
    added, as of :func:`potential`, or tiles of none.
    """
    work, slopes, size = np.empty(20 * TILE), np.empty((directions.shape[0], 12, TILE)), columns.shape[2]
    numbers, sums, right_side, adjoint = columns.reshape(-1), out.reshape(-1), further[1], further[2]
    sums[:] = 0.0
    right_side[:] = 0.0
    for t in range(columns.shape[0]):
        j = t % TILE
        if j == 0:
            _combine(modal, t // TILE, q, work)
            for d in range(directions.shape[0]):
                _slopes(shape, t // TILE, directions[d], work, slopes[d])
            if right_side.size:
                _spread_tile(shape, further[0], t // TILE, work, right_side)
            if adjoint.shape[0]:
                _potential_of(modal, adjoint, t // TILE, work, 0.0, further[3])
        for d in range(directions.shape[0]):
            by = slopes[d]
            a0, a1, a2 = spread_number(by[0, j]), spread_number(by[1, j]), spread_number(by[2, j])
            a3, a4, a5 = spread_number(by[3, j]), spread_number(by[4, j]), spread_number(by[5, j])
            b0, b1, b2 = spread_number(by[6, j]), spread_number(by[7, j]), spread_number(by[8, j])
            b4, b5 = spread_number(by[10, j]), spread_number(by[11, j])
            at0 = (corners[t, 0] * directions.shape[0] + d) * size
            at1 = (corners[t, 1] * directions.shape[0] + d) * size
            at2 = (corners[t, 2] * directions.shape[0] + d) * size
            for k in range(0, size, LANES):
                at = 6 * t * size + k
                p0, p1, p2 = load(numbers, at), load(numbers, at + size), load(numbers, at + 2 * size)
                p3, p4 = load(numbers, at + 3 * size), load(numbers, at + 4 * size)
                p5 = load(numbers, at + 5 * size)
                one = a0 * p0 + a1 * p1 + a2 * p2 + a3 * p3 + a4 * p4 + a5 * p5
                two = b0 * p0 + b1 * p1 + b2 * p2 + b4 * p4 + b5 * p5
                store(sums, at1 + k, load(sums, at1 + k) + one)
                store(sums, at2 + k, load(sums, at2 + k) + two)
                store(sums, at0 + k, load(sums, at0 + k) - (one + two))
