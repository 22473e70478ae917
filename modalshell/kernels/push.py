"""The modal force of modal warping on SIMD vectors [choi2007, eq. 20; theory 2, eq. 8].

On the modal data of :mod:`modalshell.kernels.frame`, and a load in the same order: rows of x, y and z of 128 vertices,
padded with zeros. The rotation is within 1e-15 of that of its rotation vector up to a whole turn, as is a frame's.
Nothing is reordered, so that kernels that call these round as they do.
"""

from __future__ import annotations

import numpy as np

from modalshell.core.typing import Array
from modalshell.kernels.compiler import UNCOUNTED, njit
from modalshell.kernels.frame import HALF_DOUBLE, LIMIT, MIDDLE, THIRD_DOUBLE, TILE
from modalshell.kernels.packed import LANES, any_above, larger, load, spread, spread_from, store, total
from modalshell.kernels.rotations import coefficients, warped_work

ROWS = 3 * TILE
"""Numbers of a load, or a displacement, of a tile."""
POWERS = np.array(list(zip((0.0, 0.0, *HALF_DOUBLE), THIRD_DOUBLE, strict=True))).ravel()
"""The coefficients of both polynomials of a frame, pair by pair, highest power first."""
DERIVATIVES = 600
"""Operations of a vertex's warp with the derivatives of its work."""
ALIKE = 0.4
"""Distance of a sample's force from the whole one, as a share of it, up to which it tells how that changes."""

_kernel = njit(error_model="numpy", fastmath={"contract", "nsz"})
_plain = njit(error_model="numpy", fastmath={"contract", "nsz"}, **UNCOUNTED)


def load_rows(load: Array) -> Array:
    """A load (n, 3) in the order of the modal data (tiles * 3 * 128,)."""
    tiles = -(-len(load) // TILE)
    padded = np.zeros((tiles * TILE, 3))
    padded[: len(load)] = load
    return padded.reshape(tiles, TILE, 3).transpose(0, 2, 1).ravel()


@_plain
def push_frame(modal, rows, powers, q, work, force):  # type: ignore[no-untyped-def]
    """Write the modal force ``Phi^T R(Psi q)^T f`` of a load in ``rows`` into ``force`` (m,).

    ``modal`` (tiles * m * 6 * 128,) and ``rows`` are flat, ``powers`` are :data:`POWERS`, and ``work`` holds 3 * 128
    numbers.
    """
    size, one, middle = 2 * ROWS * q.size, spread(1.0), spread(MIDDLE)
    for mode in range(q.size):
        force[mode] = 0.0
    for tile in range(modal.size // size):
        worst = spread(0.0)
        for vertex in range(0, TILE, LANES):
            at = tile * size + ROWS + vertex
            amount = spread_from(q, 0)
            wx, wy, wz = amount * load(modal, at), amount * load(modal, at + TILE), amount * load(modal, at + 2 * TILE)
            for mode in range(1, q.size):
                amount = spread_from(q, mode)
                at += 2 * ROWS
                wx = wx + amount * load(modal, at)
                wy = wy + amount * load(modal, at + TILE)
                wz = wz + amount * load(modal, at + 2 * TILE)
            squared = wx * wx + wy * wy + wz * wz
            worst = larger(squared, worst)
            shifted = squared - middle
            half, third = spread_from(powers, 0), spread_from(powers, 1)
            for k in range(2, powers.size, 2):
                half = half * shifted + spread_from(powers, k)
                third = third * shifted + spread_from(powers, k + 1)
            quadratic, linear = half * half, squared * third - one  # minus c1
            at = tile * ROWS + vertex
            fx, fy, fz = load(rows, at), load(rows, at + TILE), load(rows, at + 2 * TILE)
            cx, cy, cz = wy * fz - wz * fy, wz * fx - wx * fz, wx * fy - wy * fx
            store(work, vertex, fx + linear * cx + quadratic * (wy * cz - wz * cy))
            store(work, TILE + vertex, fy + linear * cy + quadratic * (wz * cx - wx * cz))
            store(work, 2 * TILE + vertex, fz + linear * cz + quadratic * (wx * cy - wy * cx))
        if any_above(worst, LIMIT):
            _turn_back_wound_up(modal, tile * size + ROWS, rows, tile * ROWS, q, work)
        for mode in range(q.size):
            at = tile * size + 2 * ROWS * mode
            a = b = c = d = spread(0.0)  # four sums, so that none waits for the one before
            for i in range(0, ROWS, 4 * LANES):
                a = a + load(work, i) * load(modal, at + i)
                b = b + load(work, i + LANES) * load(modal, at + i + LANES)
                c = c + load(work, i + 2 * LANES) * load(modal, at + i + 2 * LANES)
                d = d + load(work, i + 3 * LANES) * load(modal, at + i + 3 * LANES)
            force[mode] += total((a + b) + (c + d))


@_plain
def _turn_back_wound_up(modal, at, rows, first, q, work):  # type: ignore[no-untyped-def]
    """Turn the load of a tile back by rotations of any angle; its rotation vectors' rows begin ``at`` in ``modal``."""
    for vertex in range(TILE):
        wx = wy = wz = 0.0
        for mode in range(q.size):
            row, amount = at + 2 * ROWS * mode + vertex, q[mode]
            wx, wy = wx + amount * modal[row], wy + amount * modal[row + TILE]
            wz += amount * modal[row + 2 * TILE]
        linear, quadratic, _ = coefficients(wx, wy, wz)
        row = first + vertex
        fx, fy, fz = rows[row], rows[row + TILE], rows[row + 2 * TILE]
        cx, cy, cz = wy * fz - wz * fy, wz * fx - wx * fz, wx * fy - wy * fx
        work[vertex] = fx - linear * cx + quadratic * (wy * cz - wz * cy)
        work[TILE + vertex] = fy - linear * cy + quadratic * (wz * cx - wx * cz)
        work[2 * TILE + vertex] = fz - linear * cz + quadratic * (wx * cy - wy * cx)


@_kernel
def work_frame(modal, rows, powers, q, work, force):  # type: ignore[no-untyped-def]
    """Write the gradient (m,) of the work ``f . Rt(Psi q) Phi q`` of a load in ``rows`` into ``force``; the work [J].

    The arguments are those of :func:`push_frame`, but ``work`` holds 6 * 128 numbers: derivatives of a tile's work by
    the linear displacements, and by the rotation vectors.
    """
    size, middle, done = 2 * ROWS * q.size, spread(MIDDLE), 0.0
    for mode in range(q.size):
        force[mode] = 0.0
    for tile in range(modal.size // size):
        worst, whole = spread(0.0), spread(0.0)
        for vertex in range(0, TILE, LANES):
            at = tile * size + vertex
            wx = wy = wz = vx = vy = vz = spread(0.0)
            for mode in range(q.size):
                amount, turn = spread_from(q, mode), at + ROWS
                vx = vx + amount * load(modal, at)
                vy = vy + amount * load(modal, at + TILE)
                vz = vz + amount * load(modal, at + 2 * TILE)
                wx = wx + amount * load(modal, turn)
                wy = wy + amount * load(modal, turn + TILE)
                wz = wz + amount * load(modal, turn + 2 * TILE)
                at += 2 * ROWS
            squared = wx * wx + wy * wy + wz * wz
            worst = larger(squared, worst)
            shifted = squared - middle
            half, third = spread_from(powers, 0), spread_from(powers, 1)
            half_slope = third_slope = spread(0.0)
            for k in range(2, powers.size, 2):
                half_slope, third_slope = half_slope * shifted + half, third_slope * shifted + third
                half = half * shifted + spread_from(powers, k)
                third = third * shifted + spread_from(powers, k + 1)
            second, second_slope = half * half, spread(4.0) * half * half_slope  # by w they are w times these
            third_slope = third_slope + third_slope
            at = tile * ROWS + vertex
            fx, fy, fz = load(rows, at), load(rows, at + TILE), load(rows, at + 2 * TILE)
            cx, cy, cz = wy * fz - wz * fy, wz * fx - wx * fz, wx * fy - wy * fx
            ax = fx - second * cx + third * (wy * cz - wz * cy)
            ay = fy - second * cy + third * (wz * cx - wx * cz)
            az = fz - second * cz + third * (wx * cy - wy * cx)
            whole = whole + ax * vx + ay * vy + az * vz
            along, across, both = wx * vx + wy * vy + wz * vz, wx * fx + wy * fy + wz * fz, vx * fx + vy * fy + vz * fz
            radial = third_slope * (along * across - squared * both) - second_slope * (cx * vx + cy * vy + cz * vz)
            radial = radial - (third + third) * both
            bent, pushed = third * across, third * along
            store(work, vertex, ax)
            store(work, TILE + vertex, ay)
            store(work, 2 * TILE + vertex, az)
            store(work, 3 * TILE + vertex, radial * wx + bent * vx + pushed * fx + second * (vy * fz - vz * fy))
            store(work, 4 * TILE + vertex, radial * wy + bent * vy + pushed * fy + second * (vz * fx - vx * fz))
            store(work, 5 * TILE + vertex, radial * wz + bent * vz + pushed * fz + second * (vx * fy - vy * fx))
        if any_above(worst, LIMIT):
            done += _wound_up_work(modal, tile * size, rows, tile * ROWS, q, work)
        else:
            done += total(whole)
        for mode in range(q.size):
            at = tile * size + 2 * ROWS * mode
            a = b = c = d = spread(0.0)  # as above
            for i in range(0, 2 * ROWS, 4 * LANES):
                a = a + load(work, i) * load(modal, at + i)
                b = b + load(work, i + LANES) * load(modal, at + i + LANES)
                c = c + load(work, i + 2 * LANES) * load(modal, at + i + 2 * LANES)
                d = d + load(work, i + 3 * LANES) * load(modal, at + i + 3 * LANES)
            force[mode] += total((a + b) + (c + d))
    return done


@_kernel
def _wound_up_work(modal, at, rows, first, q, work):  # type: ignore[no-untyped-def]
    """The derivatives of a tile's work by rotations of any angle, and the work; its rows begin ``at`` in ``modal``."""
    turns, moved, load, by_moves, by_turns = np.zeros((5, TILE, 3))
    for vertex in range(TILE):
        for axis in range(3):
            place = axis * TILE + vertex
            for mode in range(q.size):
                row = at + 2 * ROWS * mode + place
                moved[vertex, axis] += q[mode] * modal[row]
                turns[vertex, axis] += q[mode] * modal[row + ROWS]
            load[vertex, axis] = rows[first + place]
    done = warped_work(turns, moved, load, by_moves, by_turns)
    for vertex in range(TILE):
        for axis in range(3):
            work[axis * TILE + vertex] = by_moves[vertex, axis]
            work[ROWS + axis * TILE + vertex] = by_turns[vertex, axis]
    return done


@_kernel
def change_by_sample(known, sampled, change):  # type: ignore[no-untyped-def]
    """Take a sample's modal force (m,) from that near by, in ``change``; whether it is like the ``known`` whole one.

    It is not where the sample does not feel the load as all do: one at few vertices, say.
    """
    off = whole = 0.0
    for mode in range(known.size):
        change[mode] -= sampled[mode]
        off += (sampled[mode] - known[mode]) ** 2
        whole += known[mode] ** 2
    return off <= ALIKE**2 * whole


@_kernel
def push_change(modal, rows, powers, q, near, known):  # type: ignore[no-untyped-def]
    """Change (m,) of the modal force from q, where it is ``known``, to ``near`` (m,) by a sample of vertices.

    And whether that serves; see :func:`change_by_sample`. The arguments are those of :func:`push_frame`.
    """
    forces, work, places = np.empty((2, q.size)), np.empty(ROWS), (q, near)
    for side in range(2):  # one call of the long kernel, which is compiled where it is called
        push_frame(modal, rows, powers, places[side], work, forces[side])
    return forces[1], change_by_sample(known, forces[0], forces[1])
