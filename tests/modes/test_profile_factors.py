"""Factors in profile storage against those of other libraries."""

import numpy as np
import pytest

import modalshell as ms
from modalshell.core.errors import SolverError
from modalshell.modes import Factoriser
from modalshell.shell import GAUSS_NEWTON


def stiffness(cells, sheet):
    mesh = ms.cylinder_panel(length=1.0, radius=1.0, angle=50.0, cells=cells)
    shell = ms.Shell(mesh, sheet, mesh.vertices[:, 1] > 0.25)
    return shell.pattern.free_matrix(shell.energy_gradient_hessian(shell.rest_positions, GAUSS_NEWTON)[2])


@pytest.mark.parametrize("sheet", [ms.Material(200.0, 200.0, 0.05, 0.2), ms.Isotropic(1e8, 0.3, 0.006, 200.0)])
def test_solutions_and_signs_are_those_of_the_other_factor(sheet):
    matrix = stiffness((8, 6), sheet)
    own, other = Factoriser(), Factoriser("superlu")
    right = np.random.default_rng(3).standard_normal((matrix.shape[0], 2))
    shifted = matrix.copy()
    shifted.setdiag(matrix.diagonal() - 0.01 * matrix.diagonal().mean())
    for one in (matrix, shifted):
        found, expected = own.symmetric(one), other.symmetric(one)
        assert found.backend == "profile"
        assert found.solve(right) == pytest.approx(expected.solve(right), rel=1e-6, abs=1e-8 * np.abs(right).max())
        assert found.negative_eigenvalues() == expected.negative_eigenvalues()
        assert found.is_definite() == (one is matrix)


def test_what_has_no_factor_is_refused():
    matrix = stiffness((4, 4), ms.Material(200.0, 200.0, 0.05, 0.2))
    matrix.data[:] = np.nan
    with pytest.raises(SolverError, match="finite"):
        Factoriser().symmetric(matrix)
