"""Forces of pressure and wind on triangles, and their modal forces by quadrature over a few triangles."""

from __future__ import annotations

import math

from modalshell.kernels.compiler import njit
from modalshell.kernels.rotations import coefficients

_DRAG_STRIDE = 8
"""Triangles of which one is taken for the drag: the stability of a step needs no more."""


@njit(error_model="numpy", fastmath=False, forceinline=True)
def _loaded(x, before, rate, a, b, c, air, size):  # type: ignore[no-untyped-def]
    """Force, unit normal, slip t, area, velocity across and slip's size of a triangle; see :func:`surface_push`."""
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
    """Add a third of the force of every triangle (T, 3) to each corner of ``out`` (n, 3); see :func:`surface_push`."""
    for e in range(len(faces)):
        a, b, c = faces[e, 0], faces[e, 1], faces[e, 2]
        force = _loaded(x, before, rate, a, b, c, air[e % len(air)], size)[0]
        for axis in range(3):
            part = force[axis] / 3.0
            out[a, axis] += part
            out[b, axis] += part
            out[c, axis] += part


@njit(error_model="numpy", fastmath=False)
def surface_push(x, before, rate, faces, sizes, air, modes, turns, q, turned, push, drag):  # type: ignore[no-untyped-def]
    """Add modal forces (m,) to ``push`` and minus their derivatives by the modal rates (m, m) to ``drag``.

    Of triangles ``faces`` (k, 3) at positions x (n, 3), velocities ``rate (x - before)``, in an air of velocity (k, 3).
    ``sizes`` (k, 3) are pressure, and half the density times the coefficients of wind across and along, each times the
    number of triangles that one stands for. ``modes`` and ``turns`` (k, 3, m) are those of the area around it; where
    ``turned``, modes turn with them.
    """
    count, _, size = modes.shape
    for e in range(count):
        force, normal, tangent, area, across, slip = _loaded(
            x, before, rate, faces[e, 0], faces[e, 1], faces[e, 2], air[e], sizes[e]
        )
        wx = wy = wz = 0.0
        if turned:
            for j in range(size):
                wx += turns[e, 0, j] * q[j]
                wy += turns[e, 1, j] * q[j]
                wz += turns[e, 2, j] * q[j]
        w = (wx, wy, wz)
        linear, quadratic, _ = coefficients(wx, wy, wz)
        local = _turned_back(w, linear, quadratic, force)
        for j in range(size):
            push[j] += modes[e, 0, j] * local[0] + modes[e, 1, j] * local[1] + modes[e, 2, j] * local[2]
        if e % _DRAG_STRIDE or (sizes[e, 1] == 0.0 and sizes[e, 2] == 0.0):
            continue
        share = min(_DRAG_STRIDE, count - e)
        across_it = share * 2.0 * sizes[e, 1] * abs(across) * area
        along = share * sizes[e, 2] * area * slip
        twice = along / (slip * slip) if slip > 0.0 else 0.0
        # Minus the derivative is across_it n n + along (1 - n n) + twice t t, here in the frame that is turned back.
        nx, ny, nz = _turned_back(w, linear, quadratic, normal)
        tx, ty, tz = _turned_back(w, linear, quadratic, tangent)
        for j in range(size):
            vx, vy, vz = modes[e, 0, j], modes[e, 1, j], modes[e, 2, j]
            out, slid = (across_it - along) * (vx * nx + vy * ny + vz * nz), twice * (vx * tx + vy * ty + vz * tz)
            sx = along * vx + out * nx + slid * tx
            sy = along * vy + out * ny + slid * ty
            sz = along * vz + out * nz + slid * tz
            for i in range(size):
                drag[i, j] += modes[e, 0, i] * sx + modes[e, 1, i] * sy + modes[e, 2, i] * sz
