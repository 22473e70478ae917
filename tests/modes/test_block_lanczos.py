"""Lanczos steps of several vectors at once, on operators whose eigenpairs are known."""

import numpy as np
import pytest

from modalshell.modes.block_lanczos import BLOCK, largest_pairs

SIZE = 600


def operator(values, seed=0):
    """A symmetric operator with these eigenvalues, and its eigenvectors."""
    axes = np.linalg.qr(np.random.default_rng(seed).standard_normal((SIZE, SIZE)))[0]
    return (lambda block: axes @ (values[:, None] * (axes.T @ block))), axes


def start(seed=1):
    return np.random.default_rng(seed).standard_normal((SIZE, BLOCK))


@pytest.mark.by_default("1-30", "2-4")
@pytest.mark.parametrize("wanted", [1, 4, 11, 30])
@pytest.mark.parametrize("copies", [1, 2, BLOCK])
def test_pairs_are_those_of_largest_size(wanted, copies):
    values = np.repeat(1.0 / (1.0 + np.arange(SIZE // copies)) ** 2, copies)
    values[::7] *= -1.0
    product, axes = operator(values)
    found, vectors = largest_pairs(product, start(), wanted)
    order = np.argsort(-np.abs(values), kind="stable")
    np.testing.assert_allclose(np.abs(found), np.abs(values[order[:wanted]]), rtol=1e-12)
    np.testing.assert_allclose(vectors.T @ vectors, np.eye(wanted), atol=1e-12)
    np.testing.assert_allclose(product(vectors), vectors * found, atol=1e-12)
    whole = np.flatnonzero(np.abs(values) >= np.abs(values[order[wanted - 1]]) * (1.0 - 1e-9))
    assert np.linalg.norm(vectors - axes[:, whole] @ (axes[:, whole].T @ vectors)) < 1e-8


def test_a_spectrum_without_gaps_does_not_converge_and_says_so():
    values = 1.0 - 1e-6 * np.arange(SIZE) / SIZE
    assert largest_pairs(operator(values)[0], start(), 5) is None


def test_a_space_as_large_as_half_of_all_is_not_begun():
    assert largest_pairs(lambda _: pytest.fail("no product is needed"), start(), SIZE // 8) is None


@pytest.mark.slow
@pytest.mark.parametrize(("largest", "converges"), [(1e6, True), (1e12, False)])
def test_pairs_far_below_the_largest_are_right_or_not_there(largest, converges):
    values = np.concatenate([[largest, 1e3], 1.0 / (1.0 + np.arange(SIZE - 2)) ** 2])
    for seed in range(5):
        found = largest_pairs(operator(values, seed)[0], start(seed + 10), 4)
        assert (found is not None) == converges  # the rounding of the largest hides the others
        if found is not None:
            np.testing.assert_allclose(found[0], values[:4], rtol=1e-8)


def test_products_are_far_fewer_than_one_by_one():
    values, calls = 1.0 / (1.0 + np.arange(SIZE)) ** 2, []
    product, _ = operator(values)
    largest_pairs(lambda block: (calls.append(1), product(block))[1], start(), 5)
    assert len(calls) <= 12
