"""Solves by columns of right sides that are local."""

import numpy as np
import pytest

import modalshell as ms
from modalshell.shell import EXACT


def sheet(cells):
    return ms.Shell(ms.sheet(cells=(cells, cells)), ms.Isotropic(1e9, 0.3, 1e-3, 1000.0), "x < 0.01")


@pytest.mark.slow
def test_columns_of_an_inverse_end_where_they_fall_below_rounding():
    """Each took the whole factor, so that the stiffness of 26,000 vertices took many minutes."""
    internal = sheet(64).pattern.internal
    solve, count = internal.solve, internal.count
    chosen = [3, count // 3, count // 2, count - 2]
    units = np.eye(count)[:, chosen]
    found = solve(units)
    whole = np.stack([solve(unit) for unit in units.T], axis=1)
    np.testing.assert_allclose(found, whole, rtol=0.0, atol=1e-16 * np.abs(whole).max())
    assert np.count_nonzero(whole) > 0.9 * whole.size  # tiny numbers all over the sheet
    assert np.count_nonzero(found) < 0.5 * whole.size


def test_a_stiffness_of_local_columns_is_that_of_products():
    plate = sheet(24)
    step = np.random.default_rng(0).standard_normal(plate.rest_positions.size)
    data = plate.energy_gradient_hessian(plate.rest_positions, EXACT)[2]
    product = plate.pattern.product(data, step)
    np.testing.assert_allclose(plate.stiffness() @ step, product, atol=1e-13 * np.abs(product).max())
