"""The dense minimiser of the reduced models: minima it must find, saddles it must leave, and what it must not claim."""

import numpy as np
import pytest

from modalshell.statics.trust_region import minimise


def quadratic(matrix, vector):
    return (lambda y: (0.5 * y @ matrix @ y - vector @ y, matrix @ y - vector)), lambda _: matrix


def test_a_quadratic_takes_one_step():
    rng = np.random.default_rng(0)
    root = rng.standard_normal((6, 6))
    matrix, vector = root @ root.T + np.eye(6), rng.standard_normal(6)
    found = minimise(*quadratic(matrix, vector), np.zeros(6), 1e-9, radius=1e3)
    assert found.converged
    assert found.iterations == 1
    np.testing.assert_allclose(found.point, np.linalg.solve(matrix, vector), rtol=1e-9)


def test_the_first_step_keeps_to_the_radius():
    seen = []

    def value_gradient(y):
        seen.append(y.copy())
        return 0.5 * y @ y - 10.0 * y[0], y - np.array([10.0, 0.0])

    found = minimise(value_gradient, lambda _: np.eye(2), np.zeros(2), 1e-9, radius=0.5)
    assert found.converged
    assert np.linalg.norm(seen[1]) == pytest.approx(0.5, rel=1e-9)


def test_a_narrow_curved_valley():
    def value_gradient(y):
        a, b = 1.0 - y[0], y[1] - y[0] ** 2
        return a**2 + 100.0 * b**2, np.array([-2.0 * a - 400.0 * y[0] * b, 200.0 * b])

    def hessian(y):
        return np.array([[2.0 - 400.0 * (y[1] - 3.0 * y[0] ** 2), -400.0 * y[0]], [-400.0 * y[0], 200.0]])

    found = minimise(value_gradient, hessian, np.array([-1.2, 1.0]), 1e-10)
    assert found.converged
    assert found.iterations < 60
    np.testing.assert_allclose(found.point, [1.0, 1.0], rtol=1e-8)


@pytest.mark.parametrize("pull", [0.0, 1e-12, 0.3])
def test_a_saddle_is_left(pull):
    """(x^2 - 1)^2 + y^2 - pull x from its saddle at the origin, where the gradient says nothing or next to it."""

    def value_gradient(y):
        return (y[0] ** 2 - 1.0) ** 2 + y[1] ** 2 - pull * y[0], np.array([4 * y[0] ** 3 - 4 * y[0] - pull, 2 * y[1]])

    found = minimise(value_gradient, lambda y: np.diag([12.0 * y[0] ** 2 - 4.0, 2.0]), np.zeros(2), 1e-10)
    assert found.converged
    assert abs(found.point[0]) == pytest.approx(1.0, abs=0.1)
    assert np.linalg.norm(value_gradient(found.point)[1]) < 1e-10


def test_a_start_at_the_minimum_takes_no_step():
    found = minimise(*quadratic(np.eye(3), np.ones(3)), np.ones(3), 1e-9)
    assert found.converged
    assert found.iterations == 0


def test_walls_of_infinity_are_kept_away_from():
    def value_gradient(y):
        with np.errstate(invalid="ignore", divide="ignore"):
            return float(y[0] - np.log(y[0])), 1.0 - 1.0 / y

    found = minimise(value_gradient, lambda y: np.array([[1.0 / y[0] ** 2]]), np.array([5.0]), 1e-9, radius=100.0)
    assert found.converged
    assert found.point[0] == pytest.approx(1.0, rel=1e-8)


def test_an_unbounded_function_is_not_converged():
    found = minimise(*quadratic(-np.eye(2), np.ones(2)), np.zeros(2), 1e-9)
    assert not found.converged


def test_a_tolerance_below_rounding_is_not_claimed():
    """A gradient with an error that no step removes."""
    rng = np.random.default_rng(0)
    found = minimise(lambda y: (0.5 * y @ y, y + 1e-6 * rng.standard_normal(3)), lambda _: np.eye(3), np.ones(3), 1e-12)
    assert not found.converged
    assert found.residual > 1e-12
