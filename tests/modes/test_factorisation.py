"""Sparse factorisation: every back end solves, tells definite from indefinite, and refuses by name."""

import numpy as np
import pytest
import scipy.sparse as sps
from scenes import cantilever

from modalshell.core.errors import OptionError, SolverError
from modalshell.modes import BACKENDS, Factoriser
from modalshell.shell import EXACT


def definite_matrix(size=30, seed=0):
    rng = np.random.default_rng(seed)
    half = sps.random_array((size, size), density=0.2, rng=rng) + sps.diags_array(np.full(size, 2.0))
    return sps.csc_array(half @ half.T)


def tangent(squeeze):
    """Stiffness of the free unknowns of a V-beam squeezed along its ridge."""
    shell = cantilever((10, 4))
    x = shell.rest_positions.copy()
    x[:, 0] *= squeeze
    return shell.pattern.free_matrix(shell.energy_gradient_hessian(x, EXACT)[2])


@pytest.mark.parametrize(("size", "backend"), [(1999, "superlu"), (2000, "cholesky")])
def test_the_size_decides_on_a_single_factorisation(size, backend):
    matrix = sps.csc_array(sps.eye_array(size))
    assert Factoriser(use="solve").definite(matrix).backend == backend
    matrix.data[7] = -1.0
    assert Factoriser(use="solve").symmetric(matrix).backend == backend


def banded(size, width):
    return sps.csc_array(
        sps.diags_array(np.ones((2 * width + 1, size)), offsets=range(-width, width + 1), shape=2 * (size,))
    )


@pytest.mark.by_default("20001-1-True-cholesky-cholesky")
@pytest.mark.parametrize(
    ("size", "width", "rough", "definite", "indefinite"),
    [
        (3000, 20, False, "profile", "profile"),
        (3000, 120, True, "profile", "profile"),
        (3000, 300, True, "cholesky", "cholesky"),
        (20_001, 1, True, "cholesky", "cholesky"),
    ],
)
def test_the_work_decides_on_repeated_factorisations(size, width, rough, definite, indefinite):
    """By the band: a matrix of as many unknowns is small or large."""
    matrix, factoriser = banded(size, width), Factoriser()
    matrix.setdiag(2.0 * width + 2.0)
    assert (factoriser.rough(matrix) is not None) == rough
    assert factoriser.definite(matrix).backend == definite
    matrix.setdiag(np.where(np.arange(size) == 7, -1.0, 2.0 * width + 2.0))
    factor, expected = factoriser.symmetric(matrix), np.ones(size)
    assert factor.backend == indefinite
    assert not factor.is_definite()
    assert factor.negative_eigenvalues() == 1
    np.testing.assert_allclose(factor.solve(matrix @ expected), expected, rtol=0, atol=1e-10)


def test_a_vanishing_pivot_is_passed_round():
    """A regular matrix whose first pivots in place are zero: SuperLU finds others."""
    matrix = sps.csc_array((np.array([0.0, 1.0, 1.0, 0.0]), np.array([0, 1, 0, 1]), np.array([0, 2, 4])))
    factor = Factoriser().symmetric(matrix)
    assert not factor.is_definite()
    np.testing.assert_allclose(factor.solve(np.array([1.0, 2.0])), [2.0, 1.0], rtol=0, atol=0)


@pytest.mark.parametrize("backend", BACKENDS)
def test_factors_solve(backend):
    factoriser = Factoriser(backend)
    rng = np.random.default_rng(1)
    for seed in range(3):  # the same pattern again and again, as Newton has it
        matrix = definite_matrix()
        matrix.data *= 1.0 + seed
        for kind in ("definite", "symmetric"):
            factor = getattr(factoriser, kind)(matrix)
            assert factor.backend == backend
            assert factor.is_definite()
            for shape in ((30,), (30, 4)):
                expected = rng.standard_normal(shape)
                np.testing.assert_allclose(factor.solve(matrix @ expected), expected, rtol=0, atol=1e-10)


@pytest.mark.parametrize("sides", [(), (1,), (3,), (5,)])
@pytest.mark.parametrize("size", [2, 3000])
def test_a_factor_for_three_axes_solves_for_any_number_of_sides(size, sides):
    matrix = banded(size, min(4, size - 1))
    matrix.setdiag(10.0 + np.arange(size) / size)
    factor, right = Factoriser(use="axes").definite(matrix), np.random.default_rng(1).standard_normal((size, *sides))
    found = factor.solve(right)
    assert (found.shape, factor.backend, factor.is_definite()) == (right.shape, "superlu", True)
    assert np.abs(matrix @ found - right).max() < 1e-13
    whole = np.round(3.0 * right).astype(np.int64)
    np.testing.assert_array_equal(factor.solve(whole), factor.solve(whole.astype(np.float64)))
    matrix.setdiag(np.where(np.arange(size) == 1, -20.0, 10.0))
    signed = Factoriser(use="axes").symmetric(matrix)
    assert (signed.is_definite(), signed.negative_eigenvalues()) == (False, 1)
    assert np.abs(matrix @ signed.solve(right) - right).max() < 1e-13


@pytest.mark.parametrize("backend", BACKENDS)
def test_an_overtaken_factor_does_not_answer_for_another_matrix(backend):
    factoriser, matrix = Factoriser(backend), definite_matrix()
    expected = np.ones(30)
    first = factoriser.definite(matrix)
    factoriser.definite(sps.csc_array(3.0 * matrix))
    np.testing.assert_allclose(first.solve(matrix @ expected), expected, rtol=0, atol=1e-10)


@pytest.mark.by_default("0.9999-cholesky", "0.99-superlu", "0.7-cholesky")
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("squeeze", [1.0, 0.9999, 0.99, 0.7])
def test_definite_means_positive_definite(backend, squeeze):
    """On the matrices it is asked about: tangent stiffnesses, definite or not; and solved right in either case."""
    matrix = tangent(squeeze)
    definite = bool(np.linalg.eigvalsh(matrix.toarray())[0] > 0)
    assert definite == (squeeze > 0.995)
    factoriser = Factoriser(backend)
    expected = np.random.default_rng(2).standard_normal(matrix.shape[0])
    for _ in range(4):  # what is kept of the pattern must not spoil the next factor
        factor = factoriser.symmetric(matrix)
        assert factor.is_definite() == definite
        solution = factor.solve(matrix @ expected)
        np.testing.assert_allclose(solution, expected, rtol=0, atol=1e-6 * np.abs(expected).max())
    try:
        claimed = Factoriser(backend).definite(matrix).is_definite()
    except SolverError:
        claimed = False
    assert claimed == definite


@pytest.mark.parametrize("backend", BACKENDS)
def test_factorisation_refuses_by_name(backend):
    broken = definite_matrix()
    broken.data[3] = np.nan
    for kind in ("definite", "symmetric"):
        with pytest.raises(SolverError, match="finite"):
            getattr(Factoriser(backend), kind)(broken)
    with pytest.raises(SolverError, match="singular"):
        Factoriser(backend).symmetric(sps.csc_array((5, 5)))
    with pytest.raises(OptionError, match="no-such-backend"):
        Factoriser("no-such-backend")
