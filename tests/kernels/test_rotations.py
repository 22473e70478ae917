"""Rotations, their running average, the derivative of the rotated load, and the modal rotation matrix W."""

import math

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import Made
from scipy.integrate import quad_vec
from scipy.spatial.transform import Rotation

from modalshell import TriangleMesh, cylinder_panel, leaf, sheet, v_beam
from modalshell.kernels import rotations
from modalshell.modes.modal_rotation import cross_matrices, rotation_matrix, triangle_rotations

ANGLES = (0.0, 1e-300, 1e-160, 1e-8, 1e-3, 0.99, 1.0, 1.01, math.pi, 2 * math.pi, 20.0)
MESHES = Made(
    {
        "sheet": lambda: sheet(cells=(4, 3), family="lloyd"),
        "v_beam": lambda: v_beam(cells=(6, 4)),
        "cylinder": lambda: cylinder_panel(cells=(5, 6), angle=100.0),
        "leaf": lambda: leaf(cells=(6, 4)),
        "one triangle": lambda: TriangleMesh([[0, 0, 0], [1, 0, 0.2], [0.1, 0.7, -0.3]], [[0, 1, 2]]),
    }
)

coordinate = st.floats(-4.0, 4.0)
vector = st.tuples(coordinate, coordinate, coordinate).map(np.array)


def matrix_of(kernel, w, sign=1.0):
    """Matrix (3, 3) that a kernel applies for the rotation vector w."""
    out = np.empty((3, 3))
    kernel(np.tile(np.asarray(w, dtype=float), (3, 1)), np.eye(3), sign, out)
    return out.T


def directions():
    unit = np.random.default_rng(0).standard_normal((3, 3))
    return unit / np.linalg.norm(unit, axis=1, keepdims=True)


@pytest.mark.parametrize("angle", ANGLES)
def test_rotate_is_the_matrix_exponential(angle):
    for s in directions():
        exact = Rotation.from_rotvec(angle * s).as_matrix()
        np.testing.assert_allclose(matrix_of(rotations.rotate, angle * s), exact, rtol=0, atol=3e-15 * (1 + angle))
        np.testing.assert_allclose(
            matrix_of(rotations.rotate, angle * s, -1.0), exact.T, rtol=0, atol=3e-15 * (1 + angle)
        )


@pytest.mark.parametrize("angle", ANGLES)
def test_warp_is_the_average_of_the_rotations(angle):
    for s in directions():
        average, _ = quad_vec(lambda r, w=angle * s: Rotation.from_rotvec(r * w).as_matrix(), 0.0, 1.0, epsrel=1e-14)
        np.testing.assert_allclose(matrix_of(rotations.warp, angle * s), average, rtol=0, atol=1e-13)
        np.testing.assert_allclose(matrix_of(rotations.warp, angle * s, -1.0), average.T, rtol=0, atol=1e-13)


@pytest.mark.parametrize("angle", [*ANGLES[1:], 1e-4, 2e-4, 0.1, 0.5, 1.5, 3.0, 6.2, 6.4, 100.0])
def test_coefficients_keep_their_digits(angle):
    with mpmath.workdps(700):
        phi = mpmath.mpf(angle)
        exact = (
            mpmath.sin(phi) / phi,
            (1 - mpmath.cos(phi)) / phi**2,
            (phi - mpmath.sin(phi)) / phi**3,
        )
        exact = [float(value) for value in exact]
    # c1 and c2 pass through zero at multiples of pi: there they are good to rounding of the angle.
    values = rotations.coefficients(angle, 0.0, 0.0)
    assert values[0] == pytest.approx(exact[0], rel=1e-13, abs=1e-15)
    assert values[1] == pytest.approx(exact[1], rel=1e-13, abs=1e-30)
    assert values[2] == pytest.approx(exact[2], rel=1e-13, abs=0.0)


def test_coefficients_at_zero_are_the_limits():
    assert rotations.coefficients(0.0, 0.0, 0.0) == (1.0, 0.5, pytest.approx(1 / 6, rel=1e-16))


@given(w=vector, direction=vector)
@settings(deadline=None, max_examples=60)
def test_the_average_is_the_left_jacobian(w, direction):
    """d exp([w]) = [Rt dw] exp([w]), by a central difference."""
    h = 1e-5
    ahead, behind = (matrix_of(rotations.rotate, w + sign * h * direction) for sign in (1, -1))
    turned = cross_matrices(matrix_of(rotations.warp, w) @ direction) @ matrix_of(rotations.rotate, w)
    scale = 1.0 + np.linalg.norm(direction)
    np.testing.assert_allclose((ahead - behind) / (2 * h), turned, rtol=0, atol=1e-9 * scale**3)


@given(w=vector)
@settings(deadline=None, max_examples=60)
def test_average_and_rotation_agree_on_the_closed_path(w):
    """R - I = [w] Rt: the end of the path is the integral of its tangent."""
    left = matrix_of(rotations.rotate, w) - np.eye(3)
    np.testing.assert_allclose(cross_matrices(w) @ matrix_of(rotations.warp, w), left, rtol=0, atol=1e-14 * (8 + w @ w))
    np.testing.assert_allclose(matrix_of(rotations.warp, w) @ w, w, rtol=0, atol=1e-14 * (8 + w @ w))


@pytest.mark.parametrize("scale", [1e-9, 0.3, 0.999, 1.001, 3.0, 8.0])
def test_rotated_load_jacobian_passes_the_taylor_test(scale):
    rng = np.random.default_rng(int(1000 * scale))
    w, load, direction = rng.standard_normal((3, 6, 3))
    w *= scale / np.linalg.norm(w, axis=1, keepdims=True)
    jacobians = np.empty((6, 3, 3))
    rotations.rotated_load_jacobian(w, load, jacobians)

    def rotated(v):
        out = np.empty_like(v)
        rotations.rotate(v, load, -1.0, out)
        return out

    steps = np.logspace(-1.5, -4.0, 6)
    change = np.einsum("nij,nj->ni", jacobians, direction)
    remainders = [np.linalg.norm(rotated(w + h * direction) - rotated(w) - h * change) for h in steps]
    assert np.polyfit(np.log(steps), np.log(remainders), 1)[0] == pytest.approx(2.0, abs=0.1)


def jacobian_of_warp(w, v):
    """d(Rt(w) v)/dw by Gauss-Legendre of d(e^{r[w]} v)/dw = -[e^{r[w]} v] r Rt(r w), in SciPy's rotations."""
    nodes, weights = np.polynomial.legendre.leggauss(60)
    inner = 0.5 * (nodes + 1.0)
    total = np.zeros((3, 3))
    for r, c in zip(inner, 0.5 * weights, strict=True):
        average = np.tensordot(0.5 * weights, Rotation.from_rotvec(np.outer(inner, r * w)).as_matrix(), 1)
        total -= c * r * cross_matrices(Rotation.from_rotvec(r * w).apply(v)) @ average
    return total


def warp_jacobian(w, v):
    jacobians = np.empty((len(w), 3, 3))
    rotations.warp_jacobian(w, v, jacobians)
    return jacobians


@pytest.mark.parametrize("angle", [0.0, *ANGLES, 1e-4, 0.9999999, 1.0000001, 3.0, 6.2])
def test_warp_jacobian_is_the_derivative(angle):
    v = np.random.default_rng(5).standard_normal((3, 3))
    w = angle * directions()
    for found, axis, vector in zip(warp_jacobian(w, v), w, v, strict=True):
        np.testing.assert_allclose(found, jacobian_of_warp(axis, vector), rtol=0, atol=2e-14 * (1 + angle))


def test_warp_jacobian_at_rest_is_half_the_cross_matrix():
    v = np.random.default_rng(6).standard_normal((4, 3))
    np.testing.assert_array_equal(warp_jacobian(np.zeros((4, 3)), v), -0.5 * cross_matrices(v))


@pytest.mark.parametrize("angle", [1e-9, 1e-3, 0.3, 0.999, 1.0, 1.001, math.pi, 2 * math.pi, 20.0])
def test_warp_jacobian_passes_the_taylor_test(angle):
    rng = np.random.default_rng(int(1000 * angle))
    w, v, direction = rng.standard_normal((3, 6, 3))
    w *= angle / np.linalg.norm(w, axis=1, keepdims=True)
    change = np.einsum("nij,nj->ni", warp_jacobian(w, v), direction)

    def warped(at):
        out = np.empty_like(v)
        rotations.warp(at, v, 1.0, out)
        return out

    steps = np.logspace(-1.5, -4.0, 6)
    remainders = [np.linalg.norm(warped(w + h * direction) - warped(w) - h * change) for h in steps]
    assert np.polyfit(np.log(steps), np.log(remainders), 1)[0] == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 0.3, 0.999, 1.0, 1.001, math.pi, 2 * math.pi, 20.0])
def test_curvature_of_the_warped_work_is_the_derivative_of_its_gradient(angle):
    """By central differences of fourth order; the work itself passes at the third slope of Taylor as well."""
    rng = np.random.default_rng(int(1000 * angle))
    w, v, load, along_w, along_v = rng.standard_normal((5, 6, 3))
    w *= angle / np.linalg.norm(w, axis=1, keepdims=True)
    mixed, curvature = np.empty((2, 6, 3, 3))
    rotations.warped_work_curvature(w, v, load, mixed, curvature)

    def gradient(h):
        by_v, by_w = np.empty((2, 6, 3))
        rotations.warped_work(w + h * along_w, v + h * along_v, load, by_v, by_w)
        return by_v, by_w

    h = 1e-3
    near, far = (np.subtract(gradient(size), gradient(-size)) / (2.0 * size) for size in (h, 2.0 * h))
    by_v, by_w = (4.0 * near - far) / 3.0
    np.testing.assert_allclose(np.einsum("nij,nj->ni", mixed, along_w), by_v, rtol=0, atol=1e-10)
    found = np.einsum("nij,nj->ni", curvature, along_w) + np.einsum("nji,nj->ni", mixed, along_v)
    np.testing.assert_allclose(found, by_w, rtol=0, atol=1e-10)
    np.testing.assert_allclose(curvature, curvature.swapaxes(1, 2), rtol=0, atol=1e-14)


@pytest.mark.parametrize("angle", [1e-160, 1e-8, 1e-3, 0.5, 0.99999, 1.0, 1.00001, 2.0, math.pi, 2 * math.pi, 20.0])
def test_slopes_of_the_coefficients_keep_their_digits(angle):
    squared = angle**2
    first, second, third = rotations.coefficients(angle, 0.0, 0.0)
    with mpmath.workdps(700):
        phi = mpmath.mpf(angle)
        exact_second = (phi * mpmath.sin(phi) - 2 * (1 - mpmath.cos(phi))) / phi**4
        exact_third = (3 * mpmath.sin(phi) - phi * (2 + mpmath.cos(phi))) / phi**5
    found = rotations.slopes(squared, first, second, third)
    # Where the closed form cancels, at angles of 1 and a little more, two digits go.
    assert found[0] == pytest.approx(float(exact_second), rel=1e-13, abs=1e-17)
    assert found[1] == pytest.approx(float(exact_third), rel=1e-13, abs=1e-17)
    with mpmath.workdps(1400):
        series = [
            mpmath.nsum(
                lambda k, s=s: (-1) ** int(k) * 4 * k * (k - 1) * phi ** (2 * k - 4) / mpmath.factorial(2 * k + s),
                [2, 90],
            )
            for s in (2, 3)
        ]
    curves = rotations._curvatures.py_func(squared, *found, second, third)
    for curve, exact in zip(curves, series, strict=True):
        assert curve == pytest.approx(float(exact), rel=1e-11, abs=1e-16)


def test_largest_angle():
    w = np.array([[0.1, 0.0, 0.0], [0.0, -3.0, 4.0], [1.0, 1.0, 1.0]])
    assert rotations.largest_angle(w) == pytest.approx(5.0, rel=1e-15)


@given(a=vector, b=vector)
def test_cross_matrices_are_the_cross_product(a, b):
    np.testing.assert_allclose(cross_matrices(a) @ b, np.cross(a, b), rtol=0, atol=1e-14 * (1 + (a @ a) * (b @ b)))


@pytest.mark.parametrize("name", MESHES)
@given(a=vector, b=vector)
@settings(deadline=None, max_examples=20)
def test_rigid_displacements_give_their_rotation_at_every_vertex(name, a, b):
    mesh = MESHES[name]
    u = a + np.cross(b, mesh.vertices)
    w = (rotation_matrix(mesh) @ u.ravel()).reshape(-1, 3)
    np.testing.assert_allclose(w, np.broadcast_to(b, w.shape), rtol=0, atol=1e-12 * (1 + np.abs(u).max()))


@pytest.mark.parametrize("name", MESHES)
def test_triangle_rotation_is_the_least_squares_fit(name):
    mesh = MESHES[name]
    u = np.random.default_rng(1).standard_normal(mesh.vertices.shape)
    w = triangle_rotations(mesh, u[:, :, None])[:, :, 0]
    for face, fitted in zip(mesh.faces, w, strict=True):
        arms = mesh.vertices[face] - mesh.vertices[face].mean(axis=0)
        relative = u[face] - u[face].mean(axis=0)
        matrix = np.vstack([-cross_matrices(arm) for arm in arms])  # w x P = -[P] w
        best, *_ = np.linalg.lstsq(matrix, relative.ravel(), rcond=None)
        np.testing.assert_allclose(fitted, best, rtol=0, atol=1e-11 * np.abs(best).max())


@pytest.mark.parametrize("name", MESHES)
def test_vertex_rotations_are_the_mean_over_their_triangles(name):
    mesh = MESHES[name]
    u = np.random.default_rng(2).standard_normal(mesh.vertices.shape)
    per_triangle = triangle_rotations(mesh, u[:, :, None])[:, :, 0]
    w = (rotation_matrix(mesh) @ u.ravel()).reshape(-1, 3)
    for vertex in range(len(mesh.vertices)):
        mean = per_triangle[(mesh.faces == vertex).any(axis=1)].mean(axis=0)
        np.testing.assert_allclose(w[vertex], mean, rtol=0, atol=1e-12 * np.abs(per_triangle).max())


@pytest.mark.parametrize("name", MESHES)
def test_fused_vertex_rotations_equal_the_matrix(name):
    mesh = MESHES[name]
    u = np.random.default_rng(3).standard_normal(mesh.vertices.shape)
    out = np.empty_like(u)
    rotations.vertex_rotations(mesh.vertices, u, mesh.faces, out)
    matrix = (rotation_matrix(mesh) @ u.ravel()).reshape(-1, 3)
    np.testing.assert_allclose(out, matrix, rtol=0, atol=1e-12 * np.abs(matrix).max())


def test_fused_vertex_rotations_at_a_deformed_state():
    mesh = MESHES["leaf"]
    rng = np.random.default_rng(4)
    x = mesh.vertices + 0.2 * mesh.edge_lengths.min() * rng.standard_normal(mesh.vertices.shape)
    u = rng.standard_normal(x.shape)
    out = np.empty_like(u)
    rotations.vertex_rotations(x, u, mesh.faces, out)
    matrix = (rotation_matrix(TriangleMesh(x, mesh.faces)) @ u.ravel()).reshape(-1, 3)
    np.testing.assert_allclose(out, matrix, rtol=0, atol=1e-11 * np.abs(matrix).max())


def test_triangles_that_have_collapsed_do_not_count():
    """A corner on the opposite edge: the other triangle rotates, and a vertex of none does not."""
    faces = np.array([[0, 1, 2], [2, 1, 3]])
    x = np.array([[0.5, 0.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.3, 1.0, 0.0]])
    u = np.cross([0.1, -0.2, 0.3], x)
    out = np.full_like(x, np.nan)
    rotations.vertex_rotations(x, u, faces, out)
    np.testing.assert_allclose(out[1:], [[0.1, -0.2, 0.3]] * 3, atol=1e-14)
    np.testing.assert_array_equal(out[0], 0.0)
