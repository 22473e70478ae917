"""Implicit Euler of springs [baraff1998]: forces, 3 x 3 blocks per particle, and conjugate gradients.

Particle i lists its springs from ``starts[i]`` to ``starts[i + 1]``: the particle at the other end, stiffness, rest
length, dashpot. Every spring is so worked out at both ends, which writes each particle's numbers from one thread only:
no atomics, and sums over a fixed number of parts, so that results do not depend on the threads. A spring's block of
the matrix is ``a I + m m^T``, four numbers; a product needs no diagonal blocks, since

    (A p)_i = mass_i p_i + sum_j a_ij (p_i - p_j) + m_ij (m_ij . (p_i - p_j)).
"""

import math

from numba import prange

from modalshell.kernels.compiler import njit
from modalshell.kernels.frame import FASTMATH

PARTS = 64
"""Runs of particles that the work is cut into, whatever the threads."""

_kernel = njit(error_model="numpy", fastmath=FASTMATH)
_threaded = njit(error_model="numpy", fastmath=False, parallel=True)


@_kernel
def _forces(first, last, springs, zeta, drag, mass, x, v, load, out):  # type: ignore[no-untyped-def]
    starts, others, stiffness, rest, dashpot = springs
    for i in range(first, last):
        fx = load[i, 0] - drag * mass[i] * v[i, 0]
        fy = load[i, 1] - drag * mass[i] * v[i, 1]
        fz = load[i, 2] - drag * mass[i] * v[i, 2]
        for s in range(starts[i], starts[i + 1]):
            j = others[s]
            dx, dy, dz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
            inverse = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
            rate = (dx * (v[j, 0] - v[i, 0]) + dy * (v[j, 1] - v[i, 1]) + dz * (v[j, 2] - v[i, 2])) * inverse * inverse
            pull = stiffness[s] * (1.0 - rest[s] * inverse) + (dashpot[s] + zeta * stiffness[s]) * rate
            fx += pull * dx
            fy += pull * dy
            fz += pull * dz
        out[i, 0], out[i, 1], out[i, 2] = fx, fy, fz


@_kernel
def _blocks(first, last, springs, zeta, drag, mass, dt, x, v, force, blocks, inverses, right):  # type: ignore[no-untyped-def]
    starts, others, stiffness, rest, dashpot = springs
    for i in range(first, last):
        m = mass[i] * (1.0 + dt * drag)
        xx, yy, zz, xy, xz, yz = m, m, m, 0.0, 0.0, 0.0
        gx, gy, gz = 0.0, 0.0, 0.0
        for s in range(starts[i], starts[i + 1]):
            j = others[s]
            dx, dy, dz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
            inverse = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
            nx, ny, nz = dx * inverse, dy * inverse, dz * inverse
            k = stiffness[s]
            # Compressed springs would make the matrix indefinite: their part across is left out.
            across = max(k * (1.0 - rest[s] * inverse), 0.0)
            ux, uy, uz = v[j, 0] - v[i, 0], v[j, 1] - v[i, 1], v[j, 2] - v[i, 2]
            along = (k - across) * (nx * ux + ny * uy + nz * uz)
            gx += across * ux + along * nx
            gy += across * uy + along * ny
            gz += across * uz + along * nz
            a = dt * dt * across
            root = math.sqrt(dt * dt * (k - across) + dt * (dashpot[s] + zeta * k))
            mx, my, mz = root * nx, root * ny, root * nz
            blocks[s, 0], blocks[s, 1], blocks[s, 2], blocks[s, 3] = a, mx, my, mz
            xx += a + mx * mx
            yy += a + my * my
            zz += a + mz * mz
            xy += mx * my
            xz += mx * mz
            yz += my * mz
        right[i, 0] = dt * (force[i, 0] + dt * gx)
        right[i, 1] = dt * (force[i, 1] + dt * gy)
        right[i, 2] = dt * (force[i, 2] + dt * gz)
        ax, ay, az = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
        over = 1.0 / (xx * ax + xy * ay + xz * az)
        inverses[i, 0], inverses[i, 1], inverses[i, 2] = over * ax, over * ay, over * az
        inverses[i, 3] = over * (xx * zz - xz * xz)
        inverses[i, 4] = over * (xy * xz - xx * yz)
        inverses[i, 5] = over * (xx * yy - xy * xy)


@_kernel
def _product(first, last, starts, others, blocks, weight, p, out):  # type: ignore[no-untyped-def]
    """Write rows of A p; return their part of p . A p."""
    total = 0.0
    for i in range(first, last):
        px, py, pz = p[i, 0], p[i, 1], p[i, 2]
        ox, oy, oz = weight[i] * px, weight[i] * py, weight[i] * pz
        for s in range(starts[i], starts[i + 1]):
            j = others[s]
            dx, dy, dz = px - p[j, 0], py - p[j, 1], pz - p[j, 2]
            a, mx, my, mz = blocks[s, 0], blocks[s, 1], blocks[s, 2], blocks[s, 3]
            along = mx * dx + my * dy + mz * dz
            ox += a * dx + along * mx
            oy += a * dy + along * my
            oz += a * dz + along * mz
        out[i, 0], out[i, 1], out[i, 2] = ox, oy, oz
        total += px * ox + py * oy + pz * oz
    return total


@_kernel
def _advance(first, last, alpha, free, inverses, p, q, r, z, dv):  # type: ignore[no-untyped-def]
    """Move dv along p, renew r and z = P^-1 r; return their parts of r . z and r . r."""
    dot, squared = 0.0, 0.0
    for i in range(first, last):
        keep = free[i]
        dv[i, 0] += alpha * p[i, 0]
        dv[i, 1] += alpha * p[i, 1]
        dv[i, 2] += alpha * p[i, 2]
        rx = keep * (r[i, 0] - alpha * q[i, 0])
        ry = keep * (r[i, 1] - alpha * q[i, 1])
        rz = keep * (r[i, 2] - alpha * q[i, 2])
        r[i, 0], r[i, 1], r[i, 2] = rx, ry, rz
        zx = inverses[i, 0] * rx + inverses[i, 1] * ry + inverses[i, 2] * rz
        zy = inverses[i, 1] * rx + inverses[i, 3] * ry + inverses[i, 4] * rz
        zz = inverses[i, 2] * rx + inverses[i, 4] * ry + inverses[i, 5] * rz
        z[i, 0], z[i, 1], z[i, 2] = zx, zy, zz
        dot += rx * zx + ry * zy + rz * zz
        squared += rx * rx + ry * ry + rz * rz
    return dot, squared


@_kernel
def _turn(first, last, beta, p, z):  # type: ignore[no-untyped-def]
    for i in range(first, last):
        p[i, 0] = z[i, 0] + beta * p[i, 0]
        p[i, 1] = z[i, 1] + beta * p[i, 1]
        p[i, 2] = z[i, 2] + beta * p[i, 2]


@_kernel
def _move(first, last, factor, step, x):  # type: ignore[no-untyped-def]
    for i in range(first, last):
        x[i, 0] += factor * step[i, 0]
        x[i, 1] += factor * step[i, 1]
        x[i, 2] += factor * step[i, 2]


@_kernel
def _sum(sums, column):  # type: ignore[no-untyped-def]
    """Sum of all parts."""
    total = 0.0
    for k in range(PARTS):
        total += sums[k, column]
    return total


@_threaded
def forces(springs, zeta, drag, mass, x, v, load, out):  # type: ignore[no-untyped-def]
    """Write ``load - drag M v`` plus the force of springs and dashpots into ``out`` (n, 3).

    ``springs`` are (starts, others, stiffness, rest, dashpot), ``zeta`` an additional dashpot as a fraction of each
    stiffness.
    """
    n = mass.size
    for k in prange(PARTS):
        first, last = k * n // PARTS, (k + 1) * n // PARTS
        _forces(first, last, springs, zeta, drag, mass, x, v, load, out)


@_threaded
def matrix(springs, zeta, drag, mass, dt, x, v, force, blocks, inverses, right):  # type: ignore[no-untyped-def]
    """Write the springs' blocks (S, 4), the inverses of the diagonal blocks (n, 6), and the right side (n, 3)."""
    n = mass.size
    for k in prange(PARTS):
        first, last = k * n // PARTS, (k + 1) * n // PARTS
        _blocks(first, last, springs, zeta, drag, mass, dt, x, v, force, blocks, inverses, right)


@_threaded
def conjugate_gradients(starts, others, blocks, inverses, weight, free, right, goal, limit, dv, work):  # type: ignore[no-untyped-def]
    """Solve A dv = right on free particles from ``dv``, to a residual of ``goal``; return iterations and residual.

    ``weight`` (n,) is the mass's part of A, ``free`` (n,) 1 or 0; ``work`` is four arrays (n, 3) and one (PARTS, 2).
    """
    p, q, r, z, sums = work
    n = starts.size - 1
    for k in prange(PARTS):
        first, last = k * n // PARTS, (k + 1) * n // PARTS
        _product(first, last, starts, others, blocks, weight, dv, q)
        for i in range(first, last):
            for axis in range(3):
                p[i, axis] = 0.0
                r[i, axis] = right[i, axis]
        sums[k, 0], sums[k, 1] = _advance(first, last, 1.0, free, inverses, p, q, r, z, dv)
    dot, squared = _sum(sums, 0), _sum(sums, 1)
    beta, done = 0.0, 0
    while done < limit and squared > goal * goal:
        for k in prange(PARTS):
            _turn(k * n // PARTS, (k + 1) * n // PARTS, beta, p, z)
        for k in prange(PARTS):
            sums[k, 0] = _product(k * n // PARTS, (k + 1) * n // PARTS, starts, others, blocks, weight, p, q)
        curvature = _sum(sums, 0)
        alpha = dot / curvature
        for k in prange(PARTS):
            first, last = k * n // PARTS, (k + 1) * n // PARTS
            sums[k, 0], sums[k, 1] = _advance(first, last, alpha, free, inverses, p, q, r, z, dv)
        beta = _sum(sums, 0) / dot
        dot, squared = _sum(sums, 0), _sum(sums, 1)
        done += 1
    return done, math.sqrt(squared)


@_threaded
def move(factor, step, x):  # type: ignore[no-untyped-def]
    """``x += factor step``, all (n, 3)."""
    n = x.shape[0]
    for k in prange(PARTS):
        _move(k * n // PARTS, (k + 1) * n // PARTS, factor, step, x)


@njit(error_model="numpy", fastmath=False)
def scatter(order, values, out):  # type: ignore[no-untyped-def]
    """``out[order[k]] = values[k]``, rows of three."""
    for k in range(order.size):
        for axis in range(3):
            out[order[k], axis] = values[k, axis]
