"""Forces of pressure and wind on triangles, and hyper-reduced modal forces of loads at a few weighted points."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from modalshell.core.typing import Array, Index
from modalshell.kernels.compiler import njit
from modalshell.kernels.rotations import coefficients

_DRAG_STRIDE = 4
"""Points of which one is taken for the drag: the stability of a step needs no more."""
SURFACE, TURNING, BODY = 0, 1, 2
"""Kinds of points: pressed or blown at, pushed by a force that turns with a triangle, and with mass."""
APART, LINEAR, TURNED = 0, 1, 2
"""Ways to modal forces: elsewhere, by the modes as they are, or by modes that turn."""


class Points(NamedTuple):
    """Where loads are taken: each of k points stands for an area."""

    kinds: Index
    """SURFACE, TURNING or BODY, and the number of the load; shape (k, 2)."""
    faces: Index
    """The triangle that each is on; shape (k, 3)."""
    sizes: Array
    """For SURFACE the pressure, and half the density times the coefficients of wind across and along, each times the
    number of triangles that one stands for; for TURNING the force in the triangle's frame; for BODY first the mass.
    Shape (k, 3)."""
    air: Array
    """For SURFACE the velocity of the air, for TURNING first the triangle's shape at rest, for BODY where its centre is
    from the triangle's; shape (k, 3)."""
    bodies: Array
    """For BODY the c, X and V of forces ``m (c - X x - V v)``; shape (loads, 3, 7)."""
    factors: Array
    """Factors on the loads at the time; shape (loads,)."""
    rest: Array
    """Forces without their factors on the shell at rest, which are known better elsewhere and are taken off; shape
    (k, 3)."""
    forces: Array
    """Receives the forces; shape (k, 3)."""
    modes: Array
    turns: Array
    """Modes and modal rotations of the area around; shape (k, 3, m)."""


@njit(error_model="numpy", fastmath=False, forceinline=True)
def _loaded(x, before, rate, a, b, c, air, size):  # type: ignore[no-untyped-def]
    """Force, unit normal, slip t, area, velocity across and slip's size of a triangle; see :class:`Points`."""
    px, py, pz = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
    rx, ry, rz = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
    ax, ay, az = 0.5 * (py * rz - pz * ry), 0.5 * (pz * rx - px * rz), 0.5 * (px * ry - py * rx)
    area = math.sqrt(ax * ax + ay * ay + az * az)
    unit = 1.0 / area if area > 0.0 else 0.0
    nx, ny, nz = unit * ax, unit * ay, unit * az
    third = rate / 3.0
    ux = air[0] - third * (x[a, 0] + x[b, 0] + x[c, 0] - before[a, 0] - before[b, 0] - before[c, 0])
    uy = air[1] - third * (x[a, 1] + x[b, 1] + x[c, 1] - before[a, 1] - before[b, 1] - before[c, 1])
    uz = air[2] - third * (x[a, 2] + x[b, 2] + x[c, 2] - before[a, 2] - before[b, 2] - before[c, 2])
    across = ux * nx + uy * ny + uz * nz
    tx, ty, tz = ux - across * nx, uy - across * ny, uz - across * nz
    slip = math.sqrt(tx * tx + ty * ty + tz * tz)
    pressure, friction = size[0] + size[1] * abs(across) * across, size[2] * area * slip
    force = pressure * ax + friction * tx, pressure * ay + friction * ty, pressure * az + friction * tz
    return force, (nx, ny, nz), (tx, ty, tz), area, across, slip


@njit(error_model="numpy", fastmath=False, forceinline=True)
def _turned_back(w, linear, quadratic, f):  # type: ignore[no-untyped-def]
    """``R(w)^T f = f - c1 w x f + c2 w x (w x f)``."""
    gx, gy, gz = w[1] * f[2] - w[2] * f[1], w[2] * f[0] - w[0] * f[2], w[0] * f[1] - w[1] * f[0]
    hx, hy, hz = w[1] * gz - w[2] * gy, w[2] * gx - w[0] * gz, w[0] * gy - w[1] * gx
    return (
        f[0] - linear * gx + quadratic * hx,
        f[1] - linear * gy + quadratic * hy,
        f[2] - linear * gz + quadratic * hz,
    )


@njit(error_model="numpy", fastmath=False)
def surface_forces(x, before, rate, faces, size, air, out):  # type: ignore[no-untyped-def]
    """Add a third of the force of every triangle (T, 3) to each corner of ``out`` (n, 3); see :class:`Points`.

    There is one ``size`` (3,) and the velocity of the ``air`` (T, 3) or (1, 3).
    """
    for e in range(len(faces)):
        a, b, c = faces[e, 0], faces[e, 1], faces[e, 2]
        force = _loaded(x, before, rate, a, b, c, air[e % len(air)], size)[0]
        for axis in range(3):
            part = force[axis] / 3.0
            out[a, axis] += part
            out[b, axis] += part
            out[c, axis] += part


@njit(error_model="numpy", fastmath=False, forceinline=True)
def _turning(x, a, b, c, local, shape):  # type: ignore[no-untyped-def]
    """Components in a triangle's frame as a vector; see :func:`.turning.triangle_frames`."""
    px, py, pz = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
    rx, ry, rz = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
    nx, ny, nz = py * rz - pz * ry, pz * rx - px * rz, px * ry - py * rx
    up = nx * nx + ny * ny + nz * nz
    up = 1.0 / math.sqrt(up) if up > 0.0 else 0.0
    nx, ny, nz = up * nx, up * ny, up * nz
    rx, ry, rz = shape[0] * px - shape[1] * rx, shape[0] * py - shape[1] * ry, shape[0] * pz - shape[1] * rz
    px, py, pz = px + ny * rz - nz * ry, py + nz * rx - nx * rz, pz + nx * ry - ny * rx
    along = px * px + py * py + pz * pz
    along = 1.0 / math.sqrt(along) if along > 0.0 else 0.0
    px, py, pz = along * px, along * py, along * pz
    first, second, third = local
    return (
        first * px + second * (ny * pz - nz * py) + third * nx,
        first * py + second * (nz * px - nx * pz) + third * ny,
        first * pz + second * (nx * py - ny * px) + third * nz,
    )


@njit(error_model="numpy", fastmath=False, forceinline=True)
def _add_drag(block, rows, drag):  # type: ignore[no-untyped-def]
    """Add ``rows^T block rows`` of a matrix (3, 3) and rows (3, m) to ``drag`` (m, m)."""
    for j in range(rows.shape[1]):
        vx, vy, vz = rows[0, j], rows[1, j], rows[2, j]
        sx = block[0, 0] * vx + block[0, 1] * vy + block[0, 2] * vz
        sy = block[1, 0] * vx + block[1, 1] * vy + block[1, 2] * vz
        sz = block[2, 0] * vx + block[2, 1] * vy + block[2, 2] * vz
        for i in range(rows.shape[1]):
            drag[i, j] += rows[0, i] * sx + rows[1, i] * sy + rows[2, i] * sz


@njit(error_model="numpy", fastmath=False, forceinline=True)
def _pressed(points, e, x, before, rate, block):  # type: ignore[no-untyped-def]
    """Force of pressure and wind at a point without its factor, and whether ``block`` (3, 3) received its drag."""
    a, b, c = points.faces[e, 0], points.faces[e, 1], points.faces[e, 2]
    count, size = len(points.faces), points.sizes[e]
    force, normal, tangent, area, across, slip = _loaded(x, before, rate, a, b, c, points.air[e], size)
    if (size[1] == 0.0 and size[2] == 0.0) or e % _DRAG_STRIDE != 0:
        return force, False
    # Minus the derivative is out n n + along (1 - n n) + along t t / t^2.
    share = points.factors[points.kinds[e, 1]] * min(_DRAG_STRIDE, count - e)
    out, along = share * 2.0 * size[1] * abs(across) * area, share * size[2] * area * slip
    twice = along / (slip * slip) if slip > 0.0 else 0.0
    for i in range(3):
        for j in range(3):
            block[i, j] = (out - along) * normal[i] * normal[j] + twice * tangent[i] * tangent[j]
        block[i, i] += along
    return force, True


@njit(error_model="numpy", fastmath=False, forceinline=True)
def _felt(points, e, x, before, rate, block, work):  # type: ignore[no-untyped-def]
    """Force by mass at a point without its factor, and whether ``block`` (3, 3) received drag; ``work`` is (3, 3)."""
    load, mass = points.kinds[e, 1], points.sizes[e, 0]
    a, b, c = points.faces[e, 0], points.faces[e, 1], points.faces[e, 2]
    body, dragging = points.bodies[load], False
    centre, speed, force = work[0], work[1], work[2]
    for i in range(3):
        centre[i] = (x[a, i] + x[b, i] + x[c, i]) / 3.0
        speed[i] = rate * (centre[i] - (before[a, i] + before[b, i] + before[c, i]) / 3.0)
        centre[i] += points.air[e, i]
    for i in range(3):
        felt = body[i, 0]
        for j in range(3):
            felt -= body[i, 1 + j] * centre[j] + body[i, 4 + j] * speed[j]
            block[i, j] = points.factors[load] * mass * body[i, 4 + j]
            dragging = dragging or block[i, j] != 0.0
        force[i] = mass * felt
    return (force[0], force[1], force[2]), dragging


@njit(error_model="numpy", fastmath=False)
def point_forces(points, x, before, rate, q, way, push, drag):  # type: ignore[no-untyped-def]
    """Forces at points, over those at rest, into ``points.forces``, with modal forces and drag added to the last two.

    At positions x (n, 3) and velocities ``rate (x - before)``; ``push`` is (m,), ``drag`` (m, m). The drag is minus the
    derivatives of the modal forces by the modal rates, with modes turned by the coordinates ``q`` (m,) unless ``way``
    is LINEAR.
    """
    faces, factors, forces, modes, turns = points.faces, points.factors, points.forces, points.modes, points.turns
    rest = points.rest
    count, _, size = modes.shape
    block, work, rows = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, size))
    for e in range(count):
        kind, load = points.kinds[e, 0], points.kinds[e, 1]
        dragging = False
        if kind == SURFACE:
            force, dragging = _pressed(points, e, x, before, rate, block)
        elif kind == TURNING:
            force = _turning(x, faces[e, 0], faces[e, 1], faces[e, 2], points.sizes[e], points.air[e])
        else:
            force, dragging = _felt(points, e, x, before, rate, block, work)
        force = (
            factors[load] * (force[0] - rest[e, 0]),
            factors[load] * (force[1] - rest[e, 1]),
            factors[load] * (force[2] - rest[e, 2]),
        )
        forces[e, 0], forces[e, 1], forces[e, 2] = force
        if way == APART and not dragging:
            continue
        w, linear, quadratic = (0.0, 0.0, 0.0), 1.0, 0.5
        if way != LINEAR:
            wx = wy = wz = 0.0
            for j in range(size):
                wx += turns[e, 0, j] * q[j]
                wy += turns[e, 1, j] * q[j]
                wz += turns[e, 2, j] * q[j]
            w = (wx, wy, wz)
            linear, quadratic, _ = coefficients(wx, wy, wz)
        if way != APART:
            local = _turned_back(w, linear, quadratic, force)
            for j in range(size):
                push[j] += modes[e, 0, j] * local[0] + modes[e, 1, j] * local[1] + modes[e, 2, j] * local[2]
        if dragging:
            for j in range(size):
                v = (modes[e, 0, j], modes[e, 1, j], modes[e, 2, j])
                rows[0, j], rows[1, j], rows[2, j] = _turned_back((-w[0], -w[1], -w[2]), linear, quadratic, v)
            _add_drag(block, rows, drag)
