"""Rotations from |w| = 0 to 1e6 rad against 60 digits of mpmath, in the Frobenius norm and relative to it.

R = e^[w] and Rt = int_0^1 e^(r[w]) dr are compared as matrices, their derivatives by w as all their 27 numbers. The
exact values belong to w as it is stored. Beyond 20 rad the rounding of the angle is allowed for: two units in its last
place, where states wind up at 2 pi.
"""

import importlib
import math
import pkgutil

import mpmath
import numpy as np
import pytest
from bases import bare_basis
from mpmath import mpf
from numba.core.dispatcher import Dispatcher

import modalshell
from modalshell.kernels import rotations
from modalshell.kernels.frame import TILE
from modalshell.models.reduction import rotation_strain_kernels as rotation_strain
from modalshell.models.reduction.warp_frame import WarpFrame
from modalshell.supports.constraints import nearest_branch

ANGLES = (0.0, 5e-324, 1e-310, 1e-300, 1e-160, 1e-20, 1e-8, 1e-4, 0.1, 0.5, 1.0 - 1e-9, 1.0 + 1e-9, 1.2, 2.0)
ANGLES += (math.pi - 1e-9, math.pi, 5.0, 2 * math.pi - 1e-9, 2 * math.pi, 2 * math.pi + 1e-9, 20.0, 1e3, 1e6)


def allowed(angle):
    """Error that rotations and their averages state at an angle [rad]."""
    return max(1e-14, 2.0**-51 * angle)


def directions():
    unit = np.random.default_rng(0).standard_normal((3, 3))
    unit = list(unit / np.linalg.norm(unit, axis=1, keepdims=True))
    mixed = [np.array([1.0, 1e-8, -1e-160]), np.array([1e-3, -5e-324, 1.0]), np.array([0.0, 1.0, 1e-16])]
    return [np.eye(3)[0], np.array([2.0, -1.0, 2.0]) / 3.0, *unit, *mixed]


def cross(w):
    zero = mpf(0)
    return np.array([[zero, -w[2], w[1]], [w[2], zero, -w[0]], [-w[1], w[0], zero]], dtype=object)


def exact(w):
    """R, Rt and their derivatives ``[i, j, k] = dM_ik/dw_j``, in mpmath, for w of floats or of mpmath's numbers."""
    w = np.array([mpf(x) for x in w], dtype=object)
    size = max(abs(x) for x in w)
    # The closed forms cancel as phi^-5.
    with mpmath.workdps(60 + (int(-6 * mpmath.log10(size)) if 0 < size < 1 else 0)):
        phi = mpmath.sqrt(sum(x * x for x in w))
        if phi == 0:
            c, d = (mpf(1), mpf(1) / 2, mpf(1) / 6), (-mpf(1) / 3, -mpf(1) / 12, -mpf(1) / 60)
        else:
            sine, cosine = mpmath.sin(phi), mpmath.cos(phi)
            c = (sine / phi, (1 - cosine) / phi**2, (phi - sine) / phi**3)
            d = ((cosine - c[0]) / phi**2, (c[0] - 2 * c[1]) / phi**2, (c[1] - 3 * c[2]) / phi**2)
        matrix, identity = cross(w), cross([mpf(0)] * 3) + np.eye(3, dtype=int)
        axes = [cross([mpf(int(i == j)) for i in range(3)]) for j in range(3)]
        results = [identity + c[k] * matrix + c[k + 1] * matrix @ matrix for k in (0, 1)]
        for k in (0, 1):
            slope = d[k] * matrix + d[k + 1] * matrix @ matrix
            parts = [c[k] * a + c[k + 1] * (a @ matrix + matrix @ a) + x * slope for a, x in zip(axes, w, strict=True)]
            results.append(np.stack(parts, axis=1))
        return results


def distance(found, value):
    """Frobenius norm of the error over that of the exact value."""
    with mpmath.workdps(60):
        gaps = [mpf(float(a)) - b for a, b in zip(np.ravel(found), np.ravel(value), strict=True)]
        return float(mpmath.norm(gaps) / mpmath.norm(list(np.ravel(value))))


def by_kernels(w):
    vectors, unit = np.tile(w, (3, 1)), np.eye(3)
    rotation, average, jacobian, turned = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3, 3)), np.empty((3, 3, 3))
    rotations.rotate(vectors, unit, 1.0, rotation)
    rotations.warp(vectors, unit, 1.0, average)
    rotations.warp_jacobian(vectors, unit, jacobian)
    rotations.rotated_load_jacobian(-vectors, unit, turned)  # R(-w)^T = R(w)
    return rotation.T, average.T, -np.moveaxis(turned, 0, 2), np.moveaxis(jacobian, 0, 2)


@pytest.mark.by_default("0.0", "1e-300", "1e-08", "0.999999999", "3.141592653589793", "6.283185307179586", "1000.0")
@pytest.mark.parametrize("angle", ANGLES)
def test_rotations_their_average_and_derivatives_keep_their_stated_error(angle):
    for direction in directions():
        w = angle * direction
        for found, value in zip(by_kernels(w), exact(w), strict=True):
            assert distance(found, value) < allowed(angle)


@pytest.mark.parametrize("angle", [1e-8, 1.2, 2 * math.pi, 1e6])
def test_loads_and_displacements_along_the_axis_too(angle):
    """In the norm of all 27 numbers: here a matrix of one load may be far smaller than those of others."""
    for direction in directions():
        w = angle * direction
        backward, forward = -exact(-w)[2], exact(w)[3]
        for other in (direction, np.eye(3)[1]):
            found = [np.empty((1, 3, 3)) for _ in range(2)]
            rotations.rotated_load_jacobian(w[None], other[None], found[0])
            rotations.warp_jacobian(w[None], other[None], found[1])
            for matrix, tensor in zip(found, (backward, forward), strict=True):
                gap = [mpf(float(x)) - y for x, y in zip(np.ravel(matrix), np.ravel(tensor @ other), strict=True)]
                assert mpmath.norm(gap) < allowed(angle) * mpmath.norm(list(np.ravel(tensor)))


@pytest.mark.parametrize("angle", ANGLES[:-1])
def test_averages_and_the_work_of_a_load_agree_with_the_matrix(angle):
    """The fused kernels take the same coefficients: within rounding of the kernels tested above."""
    rng = np.random.default_rng(1)
    v, f = rng.standard_normal((2, 3))
    for direction in directions():
        w = angle * direction
        _, average, _, slope = by_kernels(w)
        out, left, by_w = np.empty((1, 3, 3)), np.empty((1, 3)), np.empty((1, 3))
        rotations.averages(w[None], out)
        np.testing.assert_array_equal(out[0], average)
        work = rotations.warped_work(w[None], v[None], f[None], left, by_w)
        assert work == pytest.approx(f @ average @ v, abs=1e-14 * np.linalg.norm(f) * np.linalg.norm(v))
        np.testing.assert_allclose(left[0], average.T @ f, rtol=0, atol=1e-14 * np.linalg.norm(f))
        expected = np.einsum("i,ijk,k->j", f, slope, v)
        scale = np.linalg.norm(slope) * np.linalg.norm(f) * np.linalg.norm(v)
        np.testing.assert_allclose(by_w[0], expected, rtol=0, atol=1e-14 * scale)


@pytest.mark.by_default(
    "0.0-float64",
    "5e-324-float32",
    "1e-310-float32",
    "1e-300-float32",
    "1e-160-float32",
    "1e-20-float32",
    "1e-08-float64",
    "0.0001-float64",
    "0.1-float64",
    "0.5-float64",
    "0.999999999-float64",
    "1.000000001-float64",
    "1.2-float64",
    "2.0-float64",
    "3.141592652589793-float64",
    "3.141592653589793-float64",
    "5.0-float64",
    "6.283185306179586-float64",
    "6.283185307179586-float64",
    "6.283185308179586-float64",
    "20.0-float64",
    "1000.0-float64",
    "1000000.0-float64",
)
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("angle", ANGLES)
def test_the_average_of_a_frame_keeps_its_stated_error(angle, dtype):
    bound = allowed(angle) if dtype is np.float64 else 1e-6
    for direction in directions()[1::2]:
        with np.errstate(under="ignore"):
            w = (angle * direction).astype(dtype)
        columns = []
        for axis in np.eye(3):
            basis = bare_basis(np.zeros((1, 3)), axis[:, None], w.astype(float)[:, None])
            columns.append(WarpFrame(basis, dtype=dtype).positions([1.0])[0])
        assert distance(np.transpose(columns), exact([float(x) for x in w])[1]) < bound


# ---- turned triangles


def one_triangle(coordinates, adjoint):
    """Deformation, potential, gradient and Hessian of one triangle whose six coordinates are (w, S) themselves."""
    modal = np.zeros((1, 6, 6, TILE))
    modal[0, range(6), range(6), 0] = 1.0
    modal = modal.reshape(1, 6, 6 * TILE)
    gradients = np.zeros((1, 6, TILE))
    gradients[0, :, 0] = adjoint
    gradients = gradients.reshape(1, 6 * TILE)
    work, columns, force, hessian = np.empty(14 * TILE), np.empty((1, 6 * TILE)), np.zeros(6), np.zeros((6, 6))
    rotation_strain.deformations(modal, coordinates, work, columns)
    value = rotation_strain.potential(modal, gradients, coordinates, work, force)
    rotation_strain.add_curvature(modal, gradients, coordinates, work, np.empty((15, TILE)), hessian)
    return columns.reshape(6, TILE)[:, 0], value, force, hessian


def exact_triangle(w, strain, adjoint):
    """The same from mpmath; second derivatives of e^[w] by a central difference of the exact first ones."""
    with mpmath.workdps(60):
        stretch = np.array([[mpf(0)] * 3] * 3, dtype=object) + np.eye(3, dtype=int)
        parts = [np.zeros((3, 3), dtype=int) for _ in range(3)]
        for part, places in zip(parts, (((0, 0),), ((1, 1),), ((0, 1), (1, 0))), strict=True):
            for place in places:
                part[place] = 1
        for part, amount in zip(parts, strain, strict=True):
            stretch = stretch + part * mpf(float(amount))
        g = np.array([[mpf(float(x)) for x in adjoint[:3]], [mpf(float(x)) for x in adjoint[3:]]], dtype=object).T
        rotation, _, slope, _ = exact(w)
        step = mpf(10) ** -25
        second = []
        for j in range(3):
            ahead, behind = ([mpf(x) + sign * step * (k == j) for k, x in enumerate(w)] for sign in (1, -1))
            second.append((exact(ahead)[2] - exact(behind)[2]) / (2 * step))  # [i, l, k]
        columns = (rotation @ stretch)[:, :2]
        value = np.sum(g * (columns - np.eye(3, dtype=int)[:, :2]))

        def along(matrix, right):
            return np.sum(g * (matrix @ right)[:, :2])

        gradient = [along(slope[:, j], stretch) for j in range(3)] + [along(rotation, part) for part in parts]
        hessian = np.array([[mpf(0)] * 6] * 6, dtype=object)
        for j in range(3):
            for k in range(3):
                hessian[j, k] = along(second[j][:, k], stretch)
                hessian[j, 3 + k] = hessian[3 + k, j] = along(slope[:, j], parts[k])
        return (columns - np.eye(3, dtype=int)[:, :2]).T.ravel(), value, np.array(gradient, dtype=object), hessian


@pytest.mark.by_default("0.0")
@pytest.mark.parametrize("angle", ANGLES)
def test_turned_triangles_keep_their_stated_error(angle):
    """F as it is; potential, gradient and Hessian over |g|, as the largest over all loads of that size have it."""
    rng = np.random.default_rng(2)
    bound = 3e-14 + 2.0**-51 * angle
    for direction in directions()[::3]:
        w, adjoint, strain = angle * direction, rng.standard_normal(6), 0.1 * rng.standard_normal(3)
        found, values = one_triangle(np.concatenate([w, strain]), adjoint), exact_triangle(w, strain, adjoint)
        for scale, one, other in zip((1.0, *[np.linalg.norm(adjoint)] * 3), found, values, strict=True):
            assert mpmath.norm(list(np.ravel(one) - np.ravel(other).astype(object))) < bound * scale


# ---- rotation vectors from rotations


@pytest.mark.by_default("0.999999999")
@pytest.mark.parametrize("angle", [a for a in ANGLES if a > 1e-100] + [math.pi + 1e-12, math.pi - 1e-12, 9.0 * math.pi])
def test_the_nearest_branch_keeps_its_digits(angle):
    """The rotation meant, to rounding of the longest vector (the target's counts beyond a turn), also at half turns."""
    rng = np.random.default_rng(3)
    for direction in directions()[::2]:
        for reach in (0.0, math.pi, 7.0):
            w, present = angle * direction, reach * rng.standard_normal(3)
            near = nearest_branch(w, present)
            gap = np.ravel(exact(near)[0] - exact(w)[0])
            target = angle if angle > 6.3 else 0.0
            assert mpmath.norm(list(gap)) < 1e-15 * (1.0 + np.linalg.norm(near) + 0.5 * target), (w, present)
            length = np.linalg.norm(near)
            for turns in (-1, 1):
                other = near / length * (length + turns * 2 * math.pi) if length else w
                assert np.linalg.norm(near - present) <= np.linalg.norm(other - present) + 1e-9


def test_no_rotation_and_whole_turns_stay_with_the_present_axis():
    np.testing.assert_array_equal(nearest_branch(np.zeros(3), np.zeros(3)), np.zeros(3))
    np.testing.assert_array_equal(nearest_branch(np.zeros(3), np.array([0.0, 1.0, 0.0])), np.zeros(3))
    turned = nearest_branch(np.array([2 * math.pi, 0.0, 0.0]), np.array([0.0, 6.0, 0.0]))
    np.testing.assert_allclose(turned, [0.0, 2 * math.pi, 0.0], rtol=1e-15)


def test_every_kernel_says_its_fastmath_flags():
    """One that does not is compiled, and cached, with those of whichever caller came first: bits would depend on it."""
    names = [module.name for module in pkgutil.walk_packages(modalshell.__path__, "modalshell.")]
    # Devices and other engines need further packages; factorisations take no fastmath flag at all.
    others = ("device", "engines", "symbolic", "blender", "linalg", "__main__")
    modules = [importlib.import_module(name) for name in names if not any(other in name for other in others)]
    found = [value for module in modules for value in vars(module).values() if isinstance(value, Dispatcher)]
    assert len(found) > 200
    assert [kernel.__name__ for kernel in found if "fastmath" not in kernel.targetoptions] == []
