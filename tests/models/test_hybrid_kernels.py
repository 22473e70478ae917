"""Dense algebra of the hybrid's steps, by NumPy's."""

import numba
import numpy as np
import pytest
from test_hybrid_isotropic import folded, panel, reduced_to

import modalshell as ms
from modalshell.kernels.packed import LANES, transpose
from modalshell.models.hybrid import dense_kernels as dense
from modalshell.models.hybrid.assumed_stress_step import implicit_step
from modalshell.models.hybrid.energy_kernels import evaluate


@numba.njit(error_model="numpy")
def solved(matrix, vector, count):
    """The number of negative pivots; the vector is solved for in place."""
    negative = dense.factorise(matrix, vector.size, count)
    if negative >= 0:
        dense.solve(matrix, vector)
    return negative


@numba.njit(error_model="numpy")
def algebra(rows, others, factors, known):
    """Products of rows with a vector, with factors, and with other rows."""
    count, width = factors.size, rows.size // factors.size
    multiplied, added, products = np.empty(count), np.ones(width), np.empty(width * width)
    dense.multiply(rows, others[:width], multiplied)
    dense.add_rows(rows, factors, 0, count, added)
    dense.write_products(known, rows, others, count, width, products)
    return multiplied, added, products


@numba.njit(error_model="numpy")
def transposed(source, lanes):
    target = np.empty(source.size)
    transpose(source, 0, lanes, target, 0, lanes)
    return target


def in_rows(array, rows, width):
    """Numbers in the first rows and columns of zeros, flat."""
    found = np.zeros((rows, width))
    found[: array.shape[0], : array.shape[-1]] = array
    return found.ravel()


def test_a_tile_of_registers_is_transposed():
    tile = np.arange(LANES * LANES, dtype=float)
    np.testing.assert_array_equal(transposed(tile, LANES).reshape(LANES, LANES), tile.reshape(LANES, LANES).T)


@pytest.mark.by_default("5", "44")
@pytest.mark.parametrize("count", [2, 5, 12, 44, 61])
def test_a_factor_solves_and_counts_negative_pivots(count):
    rng, width = np.random.default_rng(count), dense.width_of(count)
    mixed = rng.standard_normal((count, count))
    signs = np.where(np.arange(count) % 3 == 1, -1.0, 1.0)
    lower = np.tril(mixed / count, -1) + np.eye(count)
    for weights in (np.ones(count), signs):
        whole, right = lower @ np.diag(weights * (1.0 + rng.random(count))) @ lower.T, rng.standard_normal(count)
        room = in_rows(np.tril(whole) + 7.0 * np.triu(mixed, 1), width, width)  # what is above is not read
        vector = in_rows(right[None], 1, width)
        assert solved(room, vector, count) == np.sum(weights < 0.0)
        np.testing.assert_allclose(vector[:count], np.linalg.solve(whole, right), rtol=1e-10, atol=1e-12)
        assert not vector[count:].any()
    for bad in (0.0, np.inf, np.nan):
        whole = np.diag(np.r_[np.ones(count - 1), bad])
        assert solved(in_rows(whole, width, width), in_rows(right[None], 1, width), count) == -1


@pytest.mark.by_default("6-12")
@pytest.mark.parametrize(("rows", "count"), [(1, 3), (6, 12), (13, 44)])
def test_products_of_rows(rows, count):
    rng, width = np.random.default_rng(rows), dense.width_of(count)
    one, other, known = (rng.standard_normal((n, width)) for n in (rows, rows, width))
    factors = rng.standard_normal(rows)
    multiplied, added, products = algebra(one.ravel(), other.ravel(), factors, known.ravel())
    np.testing.assert_allclose(multiplied, one @ other[0], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(added, 1.0 + factors @ one, rtol=1e-12, atol=1e-12)
    exact = known + one.T @ other
    np.testing.assert_allclose(np.tril(products.reshape(width, width)), np.tril(exact), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("count", [3, 6])
def test_the_membrane_is_the_sum_of_its_quadratic_forms(count):
    """At counts that are no multiple of the rows that are taken at once."""
    shell = panel()
    reduced, rng = reduced_to(shell, ms.solve_modes(shell, count).modes), np.random.default_rng(count)
    form, z, stresses = reduced.membrane, rng.standard_normal(count), rng.standard_normal(reduced.membrane.modes)
    triangles, forms = form.pairs.transpose(1, 0, 2).reshape(count * (count + 1) // 2, -1)[:, : form.modes], []
    for triangle in triangles.T:
        lower = np.zeros((count, count))
        lower[np.tril_indices(count)] = triangle
        forms.append(lower + np.tril(lower, -1).T)
    slopes = form.linear[:, : form.modes].T + forms @ z
    _, strains, found, _, lower = evaluate(reduced, z, stresses)
    np.testing.assert_allclose(found, slopes, rtol=1e-12, atol=1e-12 * np.abs(slopes).max())
    exact = 0.5 * (form.linear[:, : form.modes].T + slopes) @ z
    np.testing.assert_allclose(strains[: form.modes], exact, rtol=1e-12, atol=1e-12 * np.abs(exact).max())
    geometric = np.tril(np.tensordot(stresses, forms, 1))
    change = lower - evaluate(reduced, z, np.zeros(form.modes))[4]
    np.testing.assert_allclose(np.tril(change), geometric, rtol=1e-9, atol=1e-9 * np.abs(lower).max())


@pytest.mark.by_default("panel")
@pytest.mark.parametrize("make", [folded, panel])
def test_a_step_ends_in_balance(make):
    shell = make()
    reduced, rng = reduced_to(shell, ms.solve_modes(shell, 6).modes), np.random.default_rng(1)
    z, rates, force = (scale * rng.standard_normal(6) for scale in (0.006, 0.15, 0.3))
    dt, drag, none = 1 / 30, 1.0, np.zeros(reduced.membrane.modes)
    kept = np.full(6 + none.size, np.nan)
    end, done, energy, _, iterations = implicit_step(
        reduced, (z, rates, z, z, z + dt * rates, none), force, dt, drag, 0.0, 1e-10, kept
    )
    assert done
    assert 2 < iterations < 15
    value, _, _, gradient, _ = evaluate(reduced, end, none)
    pushes = gradient, (1.0 / dt**2 + drag / dt) * (end - z), -(force + rates / dt)
    assert np.linalg.norm(sum(pushes)) < 1e-8 * max(map(np.linalg.norm, pushes))
    assert energy == pytest.approx(value, rel=1e-12)
