"""Analyses of a pattern are made once for all that factorise it."""

import numpy as np
import pytest
import scipy.sparse as sps

import modalshell as ms
from modalshell.linalg import CholeskyAnalysis, ProfileAnalysis, known_analyses
from modalshell.linalg.known_analyses import known_analysis


@pytest.fixture(autouse=True)
def nothing_known(monkeypatch):
    monkeypatch.setattr(known_analyses, "_known", type(known_analyses._known)())


def definite(size, offset, seed=0):
    """A matrix of diagonals, of another pattern for each ``offset``."""
    off = np.random.default_rng(seed).uniform(-1.0, 0.0, size - offset)
    return sps.csc_array(sps.diags_array([np.full(size, 4.0), off, off], offsets=[0, offset, -offset]))


@pytest.mark.parametrize("kind", [CholeskyAnalysis, ProfileAnalysis])
def test_a_pattern_is_analysed_once_whatever_its_values(kind):
    first, same, other = definite(50, 3), definite(50, 3, seed=1), definite(50, 4)
    assert kind.known(first) is kind.known(same)
    assert kind.known(other) is not kind.known(first)
    for matrix in (first, same, other):
        right_side = np.arange(50.0)
        found = kind.known(matrix).factorise(matrix).solve(right_side)
        np.testing.assert_array_equal(found, kind(matrix).factorise(matrix).solve(right_side))


def test_kinds_are_kept_apart():
    matrix = definite(50, 3)
    assert isinstance(ProfileAnalysis.known(matrix), ProfileAnalysis)
    assert isinstance(CholeskyAnalysis.known(matrix), CholeskyAnalysis)
    assert CholeskyAnalysis.known(matrix, once=True) is not CholeskyAnalysis.known(matrix)


def test_indices_that_are_changed_later_do_not_matter():
    """SciPy sorts the indices of a matrix in place, which other matrices may share."""
    matrix = definite(50, 3)
    backwards = sps.csc_array((matrix.data.copy(), matrix.indices.copy(), matrix.indptr.copy()), shape=matrix.shape)
    for begin, end in zip(matrix.indptr[:-1], matrix.indptr[1:], strict=True):
        for part in (backwards.data, backwards.indices):
            part[begin:end] = part[begin:end][::-1].copy()
    unsorted = sps.csc_array((backwards.data.copy(), backwards.indices.copy(), backwards.indptr), shape=matrix.shape)
    analysis = ProfileAnalysis.known(backwards)
    backwards.has_sorted_indices = False
    backwards.sort_indices()
    found = analysis.factorise(unsorted).solve(np.ones(50))
    np.testing.assert_allclose(matrix @ found, np.ones(50), rtol=0, atol=1e-14)


def test_few_are_kept_and_none_of_a_matrix_that_is_too_large(monkeypatch):
    matrices = [definite(40, offset) for offset in range(1, 12)]
    made = [known_analysis("test", matrix, object) for matrix in matrices]
    assert known_analysis("test", matrices[-1], object) is made[-1]
    assert known_analysis("test", matrices[0], object) is not made[0]
    assert len(known_analyses._known) == known_analyses._KEPT
    monkeypatch.setattr(known_analyses, "_ENTRIES", matrices[-1].nnz - 1)
    assert known_analysis("test", matrices[-1], object) is not made[-1]


def test_models_of_one_mesh_share_their_analysis(monkeypatch):
    """Other constants of a material, another model: the matrices' patterns are the same."""
    made = []
    plain = CholeskyAnalysis.__init__
    monkeypatch.setattr(CholeskyAnalysis, "__init__", lambda *args, **more: made.append(plain(*args, **more)))
    mesh = ms.sheet(cells=(6, 3))
    answers = []
    for young in (1e6, 2e6):
        shell = ms.Shell(mesh, ms.Isotropic(young, 0.3, 1e-2, 100.0), clamped=range(8))
        answers += [ms.DiscreteShell(shell, backend="cholesky").equilibrium(gravity=(0, 0, -1)) for _ in range(2)]
    assert len(made) == 1
    np.testing.assert_array_equal(answers[0].positions, answers[1].positions)
    np.testing.assert_array_equal(answers[2].positions, answers[3].positions)
