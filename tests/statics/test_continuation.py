"""One load continuation for sparse and dense problems."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import cantilever

from modalshell import DiscreteShell, Isotropic, ModalDerivatives, Shell, flat_beam, solve_modes
from modalshell.core.cost import counted
from modalshell.core.errors import SolverError
from modalshell.core.timings import Timings
from modalshell.models.reduction.derivatives import modal_derivatives
from modalshell.models.reduction.reduced_energy import ReducedEnergy, ReducedPotential
from modalshell.modes import Factoriser
from modalshell.shell import EXACT
from modalshell.statics.continuation import equilibrium
from modalshell.statics.newton import is_minimum, mixed_newton
from modalshell.statics.potential import Potential


def full(shell, load):
    return Potential(load, shell.rest_positions, shell, Factoriser(), Timings())


def reduced(shell, load):
    basis = modal_derivatives(solve_modes(shell, 4))
    push = load.ravel() @ basis.vectors
    energy = ReducedEnergy(shell, basis.vectors)
    return ReducedPotential(push, np.zeros_like(push), energy, np.sqrt(basis.eigenvalues), basis.edge_change)


@pytest.mark.parametrize("problem_of", [full, reduced])
def test_states_on_the_path_balance_their_share_of_the_load(problem_of):
    shell = cantilever()
    problem = problem_of(shell, shell.gravity_force((0.0, 0.0, -40.0)))
    scale = problem.scale_at(None)
    result = equilibrium(problem, None)
    assert result.converged
    assert result.stable
    shares = [share for share, _ in result.path]
    assert len(shares) > 1
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    np.testing.assert_array_equal(result.path[-1][1], result.point)
    for share, x in result.path:
        part = problem.loaded(share)
        goal = 1e-7 if share == 1.0 else problem.path_goal
        assert part.measure(part.residual(x)) <= goal * scale
        assert part.definite_factor(part.linearise(x, EXACT)[1]) is not None


@pytest.mark.parametrize("problem_of", [full, reduced])
def test_steps_keep_their_reach(problem_of):
    shell = cantilever()
    problem = problem_of(shell, shell.gravity_force((0.0, 0.0, -40.0)))
    gradient, hessian = problem.linearise(problem.origin, EXACT)
    direction = problem.step(problem.factor(hessian), gradient)
    _, _, short = problem.moved(problem.origin, direction, 0.01)
    moved, _, half = problem.moved(problem.origin, direction, 0.005)
    assert 0.0 < short < 1.0
    assert half == pytest.approx(0.5 * short)
    assert np.abs(moved - problem.origin).max() > 0.0


def test_a_singular_reduced_hessian_is_a_solver_error():
    shell = cantilever()
    problem = reduced(shell, shell.gravity_force((0.0, 0.0, -1.0)))
    size = problem.load.size
    factor = problem.factor(np.zeros((size, size)))
    assert not factor.is_definite()
    with pytest.raises(SolverError, match="singular"):
        problem.step(factor, problem.load)


def test_reduced_newton_stays_where_its_hessian_is_singular(monkeypatch):
    shell = cantilever()
    problem = reduced(shell, shell.gravity_force((0.0, 0.0, -1.0)))
    flat = np.zeros((problem.load.size, problem.load.size))
    monkeypatch.setattr(ReducedPotential, "linearise", lambda self, *_: (-self.load, flat))
    result = mixed_newton(problem, problem.origin, 1.0)
    assert not result.converged
    np.testing.assert_array_equal(result.point, problem.origin)


def test_full_and_reduced_answers_are_near():
    shell = cantilever()
    truth = DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -0.5)).positions
    model = ModalDerivatives(shell, 4).equilibrium(gravity=(0.0, 0.0, -0.5)).positions
    drop = np.abs(truth - shell.rest_positions).max()
    assert drop > 1e-3
    assert np.abs(truth - model).max() < 0.02 * drop


def test_split_folds_take_fewer_factors_to_the_same_equilibrium():
    mesh = flat_beam(length=1.0, width=0.2, cells=(24, 6))
    shell = Shell(mesh, Isotropic(1e9, 0.3, 1e-3, 1000.0), mesh.vertices[:, 0] < 1e-9)
    load = shell.gravity_force((0.0, 0.0, -2.0))
    problem = DiscreteShell(shell, backend="cholesky")._statics(load)
    with counted() as fewer:
        found = equilibrium(problem, None)
    with counted() as more:
        exact = equilibrium(replace(problem, kept_within=0.0), None)
    assert found.converged
    assert found.stable
    assert fewer.factorisations < more.factorisations
    assert np.abs(found.point - exact.point).max() < 1e-8 * np.abs(exact.point - shell.rest_positions).max()


def test_a_factor_far_from_the_end_does_not_show_a_minimum():
    shell = cantilever()
    problem = replace(full(shell, shell.gravity_force((0.0, 0.0, -0.5))), kept_within=1e-5)
    result = mixed_newton(problem, problem.origin, problem.scale_at(None))
    used, result.factored_at = result.factor, problem.origin
    assert is_minimum(problem, result, exactly=False)
    assert result.factor is not used
    used, result.factored_at = result.factor, result.point
    assert is_minimum(problem, result, exactly=False)
    assert result.factor is used
    assert is_minimum(problem, result)
    assert result.factor is not used
