r"""Rotations from rotation vectors, their average over time, and its derivative [choi2007, eq. 16-17; choi2005].

For a rotation vector :math:`w`, with :math:`\phi = |w|`,

.. math:: R(w) = e^{[w]} = I + c_1 [w] + c_2 [w]^2, \qquad
          \tilde R(w) = \int_0^1 e^{r [w]} dr = I + c_2 [w] + c_3 [w]^2,

with :math:`c_1 = \sin\phi/\phi`, :math:`c_2 = (1-\cos\phi)/\phi^2`, :math:`c_3 = (\phi-\sin\phi)/\phi^3`.
:math:`\tilde R` is the left Jacobian of SO(3): :math:`d\,e^{[w]} = [\tilde R\,dw]\,e^{[w]}`. See theory 2, eq. 4 to 7.

From :math:`\phi = 0` to 20 rad (modal states beyond 2 pi count as wound up), R, :math:`\tilde R` and their derivatives
by w are within 1e-14 of those of w as it is stored, in the Frobenius norm and relative to it (of all 27 numbers for a
derivative). Beyond, the rounding of :math:`\phi` itself dominates: within 4.5e-16 for every radian.
"""

import math

import numpy as np

from modalshell.kernels.compiler import njit

# Said outright: without it a kernel is compiled, and cached, with the fastmath flags of whichever caller came first.
_kernel = njit(error_model="numpy", fastmath=False)

_TERMS = 9
"""Terms of the series about zero: as many as double precision needs for phi < 1."""
_EVEN, _ODD = (tuple((-1.0) ** k / math.factorial(2 * k + s) for k in reversed(range(_TERMS))) for s in (2, 3))
"""c2 = sum (-1)^k phi^(2k) / (2k + 2)! and c3, with (2k + 3)!, highest power first: exact to rounding for phi < 1."""


@njit(error_model="numpy", fastmath=False, forceinline=True)
def coefficients(x, y, z):  # type: ignore[no-untyped-def]
    """c1, c2, c3 of the rotation vector (x, y, z): half angles and a series where subtraction would cancel."""
    squared = x * x + y * y + z * z
    if squared < 1.0:
        second, third = _EVEN[0], _ODD[0]
        for k in range(1, _TERMS):
            second = second * squared + _EVEN[k]
            third = third * squared + _ODD[k]
        return 1.0 - squared * third, second, third
    angle = math.sqrt(squared)
    sine, half_sine = math.sin(angle), math.sin(0.5 * angle)
    return sine / angle, 2.0 * half_sine * half_sine / squared, (angle - sine) / (squared * angle)


@njit(error_model="numpy", fastmath=False, forceinline=True)
def _apply(w, vector, linear, quadratic):  # type: ignore[no-untyped-def]
    """``vector + linear w x vector + quadratic w x (w x vector)`` for one vertex, of tuples: slices compile slowly."""
    x, y, z = w
    vx, vy, vz = vector
    cx, cy, cz = y * vz - z * vy, z * vx - x * vz, x * vy - y * vx
    return (
        vx + linear * cx + quadratic * (y * cz - z * cy),
        vy + linear * cy + quadratic * (z * cx - x * cz),
        vz + linear * cz + quadratic * (x * cy - y * cx),
    )


@_kernel
def rotate(rotation_vectors, vectors, sign, out):  # type: ignore[no-untyped-def]
    """``out_i = R(sign w_i) v_i``; all (n, 3). ``sign`` = -1 applies the transpose."""
    for i in range(vectors.shape[0]):
        w = rotation_vectors[i, 0], rotation_vectors[i, 1], rotation_vectors[i, 2]
        first, second, _ = coefficients(w[0], w[1], w[2])
        v = vectors[i, 0], vectors[i, 1], vectors[i, 2]
        out[i, 0], out[i, 1], out[i, 2] = _apply(w, v, sign * first, second)


@_kernel
def warp(rotation_vectors, vectors, sign, out):  # type: ignore[no-untyped-def]
    """``out_i = Rt(sign w_i) v_i``; all (n, 3). Rt is the average of the rotations from 0 to w [choi2007, eq. 17]."""
    for i in range(vectors.shape[0]):
        w = rotation_vectors[i, 0], rotation_vectors[i, 1], rotation_vectors[i, 2]
        _, second, third = coefficients(w[0], w[1], w[2])
        v = vectors[i, 0], vectors[i, 1], vectors[i, 2]
        out[i, 0], out[i, 1], out[i, 2] = _apply(w, v, sign * second, third)


@_kernel
def averages(rotation_vectors, out):  # type: ignore[no-untyped-def]
    """``out_i = Rt(w_i)`` (n, 3, 3)."""
    for i in range(rotation_vectors.shape[0]):
        w = rotation_vectors[i, 0], rotation_vectors[i, 1], rotation_vectors[i, 2]
        _, second, third = coefficients(w[0], w[1], w[2])
        for axis in range(3):
            unit = 1.0 if axis == 0 else 0.0, 1.0 if axis == 1 else 0.0, 1.0 if axis == 2 else 0.0
            out[i, 0, axis], out[i, 1, axis], out[i, 2, axis] = _apply(w, unit, second, third)


@_kernel
def largest_angle(rotation_vectors):  # type: ignore[no-untyped-def]
    """Largest |w_i| over all vertices [rad]."""
    largest = 0.0
    for i in range(rotation_vectors.shape[0]):
        x, y, z = rotation_vectors[i, 0], rotation_vectors[i, 1], rotation_vectors[i, 2]
        largest = max(largest, x * x + y * y + z * z)
    return math.sqrt(largest)


@_kernel
def largest_turn(positions, displacements, faces):  # type: ignore[no-untyped-def]
    """Largest rotation [rad] of a vertex by small ``displacements`` (n, 3); see :func:`vertex_rotations`."""
    turns = np.empty(positions.shape)
    vertex_rotations(positions, displacements, faces, turns)
    return largest_angle(turns)


@_kernel
def rotated_load_jacobian(rotation_vectors, load, jacobians):  # type: ignore[no-untyped-def]
    """``jacobians_i = d(R(w_i)^T f_i)/dw_i = [R^T f] Rt(-w)``, written into (n, 3, 3)."""
    for i in range(load.shape[0]):
        w = rotation_vectors[i, 0], rotation_vectors[i, 1], rotation_vectors[i, 2]
        first, second, third = coefficients(w[0], w[1], w[2])
        x, y, z = _apply(w, (load[i, 0], load[i, 1], load[i, 2]), -first, second)
        for axis in range(3):
            unit = 1.0 if axis == 0 else 0.0, 1.0 if axis == 1 else 0.0, 1.0 if axis == 2 else 0.0
            a, b, c = _apply(w, unit, -second, third)
            jacobians[i, 0, axis] = y * c - z * b
            jacobians[i, 1, axis] = z * a - x * c
            jacobians[i, 2, axis] = x * b - y * a


@_kernel
def slopes(squared, first, second, third):  # type: ignore[no-untyped-def]
    """``(dc2/dphi) / phi`` and ``(dc3/dphi) / phi`` at phi^2 = ``squared``, given c1, c2 and c3 there."""
    if squared < 1.0:
        # sum (-1)^k 2k phi^(2k-2) / (2k+2)!, and with (2k+3)!: the factorials as a running product.
        term = 0.5
        slope_second = slope_third = 0.0
        for k in range(1, 11):
            term *= -1.0 / ((2.0 * k + 1.0) * (2.0 * k + 2.0))
            slope_second += 2.0 * k * term
            slope_third += 2.0 * k * term / (2.0 * k + 3.0)
            term *= squared
        return slope_second, slope_third
    return (first - 2.0 * second) / squared, (second - 3.0 * third) / squared


@_kernel
def _warp_slope(w, v, jacobian):  # type: ignore[no-untyped-def]
    """``d(Rt(w) v)/dw`` at fixed v for one vertex, into (3, 3)."""
    first, second, third = coefficients(w[0], w[1], w[2])
    slope_second, slope_third = slopes(w[0] * w[0] + w[1] * w[1] + w[2] * w[2], first, second, third)
    cx = w[1] * v[2] - w[2] * v[1]
    cy = w[2] * v[0] - w[0] * v[2]
    cz = w[0] * v[1] - w[1] * v[0]
    radial = (
        slope_second * cx + slope_third * (w[1] * cz - w[2] * cy),
        slope_second * cy + slope_third * (w[2] * cx - w[0] * cz),
        slope_second * cz + slope_third * (w[0] * cy - w[1] * cx),
    )
    along = w[0] * v[0] + w[1] * v[1] + w[2] * v[2]
    for row in range(3):
        for column in range(3):
            jacobian[row, column] = radial[row] * w[column] + third * (w[row] * v[column] - 2.0 * v[row] * w[column])
        jacobian[row, row] += third * along
    # d(w x v)/dw = -[v]
    jacobian[0, 1] += second * v[2]
    jacobian[0, 2] -= second * v[1]
    jacobian[1, 0] -= second * v[2]
    jacobian[1, 2] += second * v[0]
    jacobian[2, 0] += second * v[1]
    jacobian[2, 1] -= second * v[0]


@_kernel
def warp_jacobian(rotation_vectors, vectors, jacobians):  # type: ignore[no-untyped-def]
    """``jacobians_i = d(Rt(w_i) v_i)/dw_i`` at fixed v, written into (n, 3, 3)."""
    for i in range(vectors.shape[0]):
        _warp_slope(rotation_vectors[i], vectors[i], jacobians[i])


@_kernel
def warped_work(rotation_vectors, vectors, load, averaged, slope):  # type: ignore[no-untyped-def]
    """``sum f_i . Rt(w_i) v_i``, with its derivatives by v and by w written into ``averaged`` and ``slope`` (n, 3)."""
    total = 0.0
    jacobian = np.empty((3, 3))
    for i in range(vectors.shape[0]):
        w, v, f = rotation_vectors[i], vectors[i], load[i]
        _, second, third = coefficients(w[0], w[1], w[2])
        turn, force = (w[0], w[1], w[2]), (f[0], f[1], f[2])
        averaged[i, 0], averaged[i, 1], averaged[i, 2] = _apply(turn, force, -second, third)  # Rt(w)^T = Rt(-w)
        _warp_slope(w, v, jacobian)
        for axis in range(3):
            total += averaged[i, axis] * v[axis]
            slope[i, axis] = f[0] * jacobian[0, axis] + f[1] * jacobian[1, axis] + f[2] * jacobian[2, axis]
    return total


@_kernel
def _curvatures(squared, slope_second, slope_third, second, third):  # type: ignore[no-untyped-def]
    """``(d/dphi) / phi`` of both :func:`slopes` at phi^2 = ``squared``, given these, c2 and c3 there."""
    if squared < 1.0:
        # sum (-1)^k 2k (2k-2) phi^(2k-4) / (2k+2)!, and with (2k+3)!: the factorials as a running product.
        term = -1.0 / 24.0
        curve_second = curve_third = 0.0
        for k in range(2, 12):
            term *= -1.0 / ((2.0 * k + 1.0) * (2.0 * k + 2.0))
            curve_second += 4.0 * k * (k - 1.0) * term
            curve_third += 4.0 * k * (k - 1.0) * term / (2.0 * k + 3.0)
            term *= squared
        return curve_second, curve_third
    return (third - second - 4.0 * slope_second) / squared, (slope_second - 5.0 * slope_third) / squared


@_kernel
def warped_work_curvature(rotation_vectors, vectors, load, mixed, curvature):  # type: ignore[no-untyped-def]
    """Second derivatives of ``f_i . Rt(w_i) v_i`` by v and w, and by w twice, into ``mixed``, ``curvature`` (n, 3, 3).

    With ``a = f . (w x v)`` and ``b = f . (w x (w x v))`` the work is ``f . v + c2 a + c3 b``.
    """
    slope_b = np.empty(3)
    for i in range(vectors.shape[0]):
        w, v, f = rotation_vectors[i], vectors[i], load[i]
        _warp_slope(-w, f, mixed[i])  # Rt(w)^T = Rt(-w)
        squared = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
        first, second, third = coefficients(w[0], w[1], w[2])
        slope_second, slope_third = slopes(squared, first, second, third)
        curve_second, curve_third = _curvatures(squared, slope_second, slope_third, second, third)
        slope_a = (v[1] * f[2] - v[2] * f[1], v[2] * f[0] - v[0] * f[2], v[0] * f[1] - v[1] * f[0])
        fw, vw, fv = 0.0, 0.0, 0.0
        for axis in range(3):
            fw += f[axis] * w[axis]
            vw += v[axis] * w[axis]
            fv += f[axis] * v[axis]
        for axis in range(3):
            slope_b[axis] = f[axis] * vw + v[axis] * fw - 2.0 * fv * w[axis]
        a = slope_a[0] * w[0] + slope_a[1] * w[1] + slope_a[2] * w[2]
        b = fw * vw - fv * squared
        for row in range(3):
            for column in range(3):
                mixed[i, row, column] = -mixed[i, row, column]
                curvature[i, row, column] = (
                    slope_second * (w[row] * slope_a[column] + slope_a[row] * w[column])
                    + slope_third * (w[row] * slope_b[column] + slope_b[row] * w[column])
                    + third * (f[row] * v[column] + v[row] * f[column])
                    + (curve_second * a + curve_third * b) * w[row] * w[column]
                )
            curvature[i, row, row] += slope_second * a + slope_third * b - 2.0 * third * fv


@_kernel
def vertex_rotations(positions, displacements, faces, out):  # type: ignore[no-untyped-def]
    """Rotation vectors (n, 3) that fit small ``displacements`` (n, 3) about ``positions`` best, into ``out``.

    The modal rotation [choi2007, eq. 9-15] at any configuration: ``A w = sum_k P_k x d_k`` in each triangle, with
    ``A = sum |P|^2 I - P P^T``, then the mean over the triangles at each vertex. Triangles that have collapsed to a
    line have no rotation and do not count.
    """
    count = np.empty(positions.shape[0])
    count[:] = 0.0
    out[:] = 0.0
    for face in range(faces.shape[0]):
        xx = yy = zz = xy = xz = yz = bx = by = bz = 0.0
        i, j, h = faces[face, 0], faces[face, 1], faces[face, 2]
        mx = (positions[i, 0] + positions[j, 0] + positions[h, 0]) / 3.0
        my = (positions[i, 1] + positions[j, 1] + positions[h, 1]) / 3.0
        mz = (positions[i, 2] + positions[j, 2] + positions[h, 2]) / 3.0
        for k in range(3):
            v = faces[face, k]
            x, y, z = positions[v, 0] - mx, positions[v, 1] - my, positions[v, 2] - mz
            dx, dy, dz = displacements[v, 0], displacements[v, 1], displacements[v, 2]
            xx += y * y + z * z
            yy += x * x + z * z
            zz += x * x + y * y
            xy -= x * y
            xz -= x * z
            yz -= y * z
            bx += y * dz - z * dy
            by += z * dx - x * dz
            bz += x * dy - y * dx
        cxx, cxy, cxz = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
        cyy, cyz, czz = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
        determinant = xx * cxx + xy * cxy + xz * cxz
        if not determinant > 1e-15 * (xx + yy + zz) ** 3:
            continue
        wx = (cxx * bx + cxy * by + cxz * bz) / determinant
        wy = (cxy * bx + cyy * by + cyz * bz) / determinant
        wz = (cxz * bx + cyz * by + czz * bz) / determinant
        for k in range(3):
            v = faces[face, k]
            count[v] += 1.0
            out[v, 0] += wx
            out[v, 1] += wy
            out[v, 2] += wz
    for v in range(out.shape[0]):
        for axis in range(3):
            out[v, axis] /= max(count[v], 1.0)
