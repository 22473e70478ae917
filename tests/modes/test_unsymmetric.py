"""Factors of matrices that are not symmetric: by their symmetric halves, and by LU."""

import numpy as np
import pytest
import scipy.sparse as sps

import modalshell as ms
from modalshell.modes import unsymmetric
from modalshell.modes.factorisation import Factoriser


def banded(size, skew):
    """A definite matrix of five diagonals, and ``skew`` times one without a symmetric half."""
    half = sps.diags_array([-1.0, -1.0, 5.0, -1.0, -1.0], offsets=[-40, -1, 0, 1, 40], shape=(size, size))
    rest = sps.diags_array([-skew, skew], offsets=[-1, 1], shape=(size, size))
    return sps.csc_array(half + rest)


@pytest.mark.parametrize(("skew", "by_half"), [(0.05, True), (40.0, False)])
def test_both_ways_solve_alike(skew, by_half):
    matrix = banded(3200, skew)
    sides = np.random.default_rng(0).standard_normal((3200, 2))
    factor = unsymmetric.general_factor(matrix, Factoriser())
    found = factor.solve(sides)
    np.testing.assert_allclose(matrix @ found, sides, atol=1e-10)
    np.testing.assert_allclose(factor.solve(sides[:, 0]), found[:, 0], rtol=1e-12)
    assert (factor._whole is None) == by_half
    assert not factor.solve(np.zeros(3200)).any()


@pytest.mark.slow
def test_follower_pressure_factorises_symmetric_halves(monkeypatch):
    """Each step took SuperLU twenty times as long as a symmetric one."""
    shell = ms.Shell(ms.sheet(cells=(26, 26)), ms.Isotropic(1e9, 0.3, 3e-3, 800.0), "x < 0.001")
    slow = []

    class Counted(unsymmetric._GeneralLU):
        def __init__(self, matrix):
            slow.append(matrix.shape[0])
            super().__init__(matrix)

    monkeypatch.setattr(unsymmetric, "_GeneralLU", Counted)
    answers = []
    for small in (3000, 10**9):
        monkeypatch.setattr(unsymmetric, "_SMALL", small)
        answers.append((ms.DiscreteShell(shell).equilibrium(loads=[ms.Pressure(0.2)]), len(slow)))
    (answer, none), (whole, some) = answers
    assert answer.converged
    assert (none, some > 0) == (0, True)
    np.testing.assert_allclose(answer.positions, whole.positions, rtol=0.0, atol=1e-12)
