"""The fold angle of a hinge: its definition, its sign, its one turn, and its derivatives where it is flat."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import folds, hinge_mesh, noisy

from modalshell import Material, Shell, TriangleMesh, leaf, v_beam
from modalshell.shell.kernels.generated import flexure


@pytest.mark.slow
@settings(deadline=None)
@given(angle=st.floats(-math.pi + 1e-6, math.pi - 1e-6))
def test_fold_angle_is_the_turn_about_the_edge(angle):
    vertices, _ = hinge_mesh(angle)
    hinges = np.array([[0, 1, 2, 3]])
    out = np.empty(1)
    flexure.measures(vertices, hinges, out)
    assert out[0] == pytest.approx(angle, abs=1e-13)
    # The edge read from its other end, with the triangles in their places, is the same hinge.
    flexure.measures(vertices, np.array([[1, 0, 3, 2]]), out)
    assert out[0] == pytest.approx(angle, abs=1e-13)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_mesh_hinges_follow_the_definition(sign):
    mesh = TriangleMesh(leaf(cells=(6, 4)).vertices * (1.0, 1.0, sign), leaf(cells=(6, 4)).faces)
    x = noisy(mesh, mesh.vertices, 0.2, 5)
    x0, x1, x2, x3 = np.moveaxis(x[mesh.hinges], 1, 0)
    e = x1 - x0
    n1, n2 = np.cross(e, x2 - x0), np.cross(x3 - x0, e)
    theta = np.arctan2(np.sum(np.cross(n1, n2) * e, 1) / np.linalg.norm(e, axis=1), np.sum(n1 * n2, 1))
    np.testing.assert_allclose(folds(mesh, x), theta, atol=1e-13)
    assert np.abs(theta).min() > 0


def test_a_ridge_and_a_valley_fold_opposite_ways():
    mesh = v_beam(fold=150.0, cells=(6, 4))
    ridge = folds(mesh, mesh.vertices)
    on_ridge = np.abs(mesh.vertices[mesh.hinges[:, :2], 1]).max(axis=1) < 1e-12
    np.testing.assert_allclose(np.abs(ridge[on_ridge]), np.radians(30.0), atol=1e-12)
    assert np.ptp(ridge[on_ridge]) < 1e-12
    np.testing.assert_allclose(ridge[~on_ridge], 0.0, atol=1e-12)
    valley = folds(mesh, mesh.vertices * (1, 1, -1))
    np.testing.assert_allclose(valley, -ridge, atol=1e-12)


@given(value=st.floats(-math.pi, math.pi), rest=st.floats(-math.pi, math.pi))
def test_angle_differences_lie_in_one_turn(value, rest):
    deviation = flexure._deviation.py_func(value, rest)
    assert -math.pi < deviation <= math.pi
    turns = (deviation - (value - rest)) / (2 * math.pi)
    assert turns == pytest.approx(round(turns), abs=1e-15)


def test_half_a_turn_counts_as_plus_pi():
    assert flexure._deviation.py_func(math.pi, 0.0) == math.pi
    assert flexure._deviation.py_func(-math.pi, 0.0) == math.pi
    assert flexure._deviation.py_func(0.0, math.pi) == math.pi


def test_folding_past_the_back_takes_the_short_way():
    mesh = TriangleMesh(*hinge_mesh(3.0))
    shell = Shell(mesh, Material(stretch=0.0, shear=0.0, flexure=1.0, density=1.0))
    weight = shell.elements[2].weight[0]
    for angle in (3.1, -3.1, -3.0):
        expected = (angle - 3.0) % (2 * math.pi)
        assert shell.energy(hinge_mesh(angle)[0]) == pytest.approx(weight * expected**2, rel=1e-10)


@pytest.mark.parametrize("other", [(0.7, -0.8), (0.3, -1.1), (2.5, -0.1), (-3.0, -0.2)])
def test_flat_hinge_has_finite_derivatives_that_are_limits(other):
    """No acos: at theta = 0 gradient and Hessian of theta are finite and where nearby hinges tend to."""
    values = {}
    for angle in (0.0, 1e-9, -1e-9):
        x = hinge_mesh(angle, other=other)[0]
        gradient, hessian = np.empty(9), np.empty(45)
        value = flexure.second_derivatives(*(x[1:] - x[0]).ravel(), gradient, hessian)
        assert value == pytest.approx(angle, abs=1e-15)
        values[angle] = np.concatenate([gradient, hessian])
        assert np.isfinite(values[angle]).all()
    scale = np.abs(values[0.0]).max()
    np.testing.assert_allclose(values[1e-9], values[0.0], rtol=0, atol=1e-7 * scale)
    np.testing.assert_allclose(values[-1e-9], values[0.0], rtol=0, atol=1e-7 * scale)
    heights = 1.1, -other[1]  # off the edge, theta moves by one over the height, along the normal
    np.testing.assert_allclose(
        np.abs(values[0.0][3:9]), [0, 0, 1 / heights[0], 0, 0, 1 / heights[1]], atol=1e-14 * scale
    )
