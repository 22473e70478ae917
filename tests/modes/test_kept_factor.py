"""Solutions by the factor of a matrix that has changed since."""

import numpy as np
import pytest
import scipy.sparse as sps
from scipy.spatial.transform import Rotation

import modalshell as ms
from modalshell.core.cost import counted
from modalshell.modes import Factoriser, condensed_factor
from modalshell.modes.kept_factor import solution_by_kept_factor, unsymmetric_by_kept_factor
from modalshell.statics.newton import Iterate


def step_matrix(stiffer=1.0, heavier=1.0):
    """Stiffness and inertia of a sheet, large enough that a factor is worth several solves."""
    mesh = ms.sheet(cells=(40, 40))
    shell = ms.Shell(mesh, ms.Material(20.0, 20.0, 0.05, 0.2), clamped=mesh.vertices[:, 0] < 0.01)
    data = stiffer * shell.energy_gradient_hessian(shell.rest_positions, 0)[2]
    data[shell.pattern.diagonal] += heavier * np.repeat(shell.mass, 3) * 3600.0
    return shell.pattern.free_matrix(data)


@pytest.fixture(scope="module")
def matrix():
    return step_matrix()


@pytest.mark.parametrize("accuracy", [1e-1, 1e-2])
def test_a_nearby_matrix_is_solved_to_the_accuracy(matrix, accuracy):
    kept, near = Factoriser("cholesky").definite(matrix), step_matrix(0.8, 1.25)
    right_side = np.random.default_rng(1).standard_normal(matrix.shape[0])
    with counted() as work:
        solution = solution_by_kept_factor(kept, near, right_side, accuracy)
    assert np.linalg.norm(near @ solution - right_side) <= 1.001 * accuracy * np.linalg.norm(right_side)
    assert work.factorisations == 0
    assert 0 < work.solves <= kept.solves_a_factorisation


def test_the_same_matrix_takes_one_solve(matrix):
    kept = Factoriser("cholesky").definite(matrix)
    right_side = np.random.default_rng(1).standard_normal(matrix.shape[0])
    with counted() as work:
        solution = solution_by_kept_factor(kept, matrix, right_side, 1e-8)
    assert work.solves == 1
    np.testing.assert_allclose(solution, kept.solve(right_side), rtol=0, atol=1e-12 * np.abs(solution).max())


def test_a_condensed_factor_serves_the_whole_matrix(matrix):
    internal = 30
    kept = condensed_factor(Factoriser("cholesky").definite(matrix), internal)
    right_side = np.random.default_rng(1).standard_normal(matrix.shape[0] - internal)
    solution = solution_by_kept_factor(kept, matrix, right_side, 1e-8)
    np.testing.assert_allclose(solution, kept.solve(right_side), rtol=0, atol=1e-12 * np.abs(solution).max())


def test_indefinite_and_far_matrices_are_left_to_a_new_factor(matrix):
    kept = Factoriser("cholesky").definite(matrix)
    right_side = np.random.default_rng(1).standard_normal(matrix.shape[0])
    assert solution_by_kept_factor(kept, sps.csc_array(-matrix), right_side, 1e-2) is None
    assert solution_by_kept_factor(kept, step_matrix(100.0, 0.01), right_side, 1e-2) is None
    assert solution_by_kept_factor(kept, matrix, np.zeros_like(right_side), 1e-2) is None


def test_a_factor_turns_with_the_vertices(matrix):
    random = np.random.default_rng(2)
    count = matrix.shape[0] // 3
    turns = 0.3 * np.repeat(random.standard_normal((1, 3)), count, axis=0) + 1e-3 * random.standard_normal((count, 3))
    axes = np.stack([Rotation.from_rotvec(turns).apply(unit) for unit in np.eye(3)])
    blocks = sps.block_diag([sps.coo_array(Rotation.from_rotvec(turn).as_matrix()) for turn in turns], format="csc")
    near = sps.csc_array(blocks @ matrix @ blocks.T)
    near.sort_indices()
    kept, right_side = Factoriser("cholesky").definite(matrix), random.standard_normal(matrix.shape[0])
    solves = []
    for turned in (axes, axes.transpose(2, 1, 0).copy(), None):
        with counted() as work:
            found = solution_by_kept_factor(kept, near, right_side, 1e-8, turned)
        solves.append(np.inf if found is None else work.solves)
    assert solves[0] == 1
    assert min(solves[1:]) > 2


@pytest.mark.parametrize("accuracy", [1e-1, 1e-3])
def test_an_unsymmetric_matrix_nearby_is_solved_to_the_accuracy(matrix, accuracy):
    """By a factor whose vertices have turned since, too; indefinite matrices are left to other factors."""
    kept, near = Factoriser("cholesky").definite(matrix), step_matrix(0.9, 1.1)
    skew = sps.random_array(near.shape, density=1e-3, rng=np.random.default_rng(0), format="csc")
    near = sps.csc_array(near + 1e-3 * near.diagonal().min() * (skew - skew.T))
    axes = np.tile(Rotation.from_rotvec([0.3, -0.8, 0.5]).as_matrix().T[:, None], (1, near.shape[0] // 3, 1))
    turn = sps.block_diag([sps.coo_array(axes[:, 0].T)] * (near.shape[0] // 3), format="csc")
    right_side = np.random.default_rng(1).standard_normal(matrix.shape[0])
    for A, given in ((near, None), (sps.csc_array(turn @ near @ turn.T), axes)):
        with counted() as work:
            solution = unsymmetric_by_kept_factor(kept, A, right_side, accuracy, given)
        assert np.linalg.norm(A @ solution - right_side) <= 1.001 * accuracy * np.linalg.norm(right_side)
        assert work.factorisations == 0
    assert unsymmetric_by_kept_factor(kept, sps.csc_array(-near), right_side, accuracy) is None
    assert unsymmetric_by_kept_factor(kept, near, 0.0 * right_side, accuracy) is None


@pytest.mark.slow
@pytest.mark.parametrize("load", [ms.Pressure(3.0), ms.Wind((1.0, 0.0, 3.0))])
def test_motions_under_loads_that_follow_take_few_factors_to_the_same_answer(monkeypatch, load):
    """As few as under dead loads; once three in each step of implicit Euler."""
    mesh = ms.sheet(cells=(10, 10))
    shell = ms.Shell(mesh, ms.Isotropic(young=1e7, poisson=0.3, thickness=2e-3, density=300.0), clamped="x < 1e-6")

    def moved():
        with counted() as work:
            run = ms.simulate(ms.DiscreteShell(shell), duration=0.3, dt=0.03, loads=[load])
        assert run.status == "completed"
        return run.positions, work.factorisations

    positions, few = moved()
    monkeypatch.setattr("modalshell.statics.potential.unsymmetric_by_kept_factor", lambda *_: None)
    exact, many = moved()
    assert few < 25 < 60 < many
    assert np.abs(positions - exact).max() < 1e-6 * np.abs(exact - mesh.vertices).max()


@pytest.mark.slow
def test_single_precision_serves_where_it_can(matrix):
    factoriser, right_side = Factoriser("cholesky"), np.random.default_rng(1).standard_normal(matrix.shape[0])
    rough, exact = factoriser.rough(matrix), factoriser.definite(matrix)
    assert rough._factor._values.nbytes == exact._factor._values.nbytes // 2
    found = exact.solve(right_side)
    assert 1e-9 < np.abs(rough.solve(right_side) - found).max() / np.abs(found).max() < 1e-3
    sides = np.random.default_rng(3).standard_normal((matrix.shape[0], 20))  # more than a register holds
    np.testing.assert_allclose(
        rough.solve(sides)[:, 7], rough.solve(sides[:, 7]), rtol=0, atol=1e-4 * np.abs(found).max()
    )
    for size in (1e-30, 1.0, 1e30):  # beyond what single precision holds
        near = solution_by_kept_factor(rough, matrix, size * right_side, 1e-8)
        np.testing.assert_allclose(near / size, found, rtol=0, atol=1e-7 * np.abs(found).max())
    for beyond in (1e40, 1e-60):
        huge = sps.csc_array(beyond * matrix)
        lost = factoriser.rough(huge)
        assert lost is None or solution_by_kept_factor(lost, huge, right_side, 1e-2) is None
    assert factoriser.rough(sps.csc_array(-matrix)) is None
    assert Factoriser().rough(sps.csc_array(matrix[:300, :300])) is None


def test_other_factors_are_not_kept(matrix):
    kept = Factoriser("superlu").definite(matrix)
    assert solution_by_kept_factor(kept, matrix, np.ones(matrix.shape[0]), 1e-2) is None


@pytest.mark.slow
def test_implicit_steps_take_fewer_factors_to_the_same_answer():
    mesh = ms.sheet(cells=(40, 40))
    shell = ms.Shell(mesh, ms.Material(20.0, 20.0, 1e-3, 0.2), clamped=mesh.vertices[:, 0] < 0.01)
    runs, work = [], []
    for backend in ("cholesky", "superlu"):
        with counted() as done:
            model = ms.DiscreteShell(shell, backend=backend)
            runs.append(ms.simulate(model, duration=3 / 60, dt=1 / 60, gravity=(0, 0, -9.81)))
        work.append(done)
    assert all(run.status == "completed" for run in runs)
    assert work[0].factorisations <= 0.6 * work[1].factorisations
    travel = np.abs(runs[1].positions[-1] - runs[1].positions[0]).max()
    np.testing.assert_allclose(runs[0].positions, runs[1].positions, rtol=0, atol=1e-6 * travel)


@pytest.mark.slow
def test_a_hessian_serves_again_to_the_same_answer(monkeypatch):
    mesh = ms.sheet(cells=(30, 30))
    shell = ms.Shell(mesh, ms.Isotropic(1e5, 0.3, 2e-3, 100.0), clamped=mesh.vertices[:, 0] < 0.01)
    whole, made, runs = ms.Shell.hessian, [], []
    monkeypatch.setattr(ms.Shell, "hessian", lambda *arguments: (made.append(1), whole(*arguments))[1])
    for again in (True, False):
        if not again:
            monkeypatch.setattr(Iterate, "_stays", lambda *_: False)
        made.clear()
        model = ms.DiscreteShell(shell, backend="cholesky")
        run = ms.simulate(model, duration=6 / 60, dt=1 / 60, gravity=(0, 0, -9.81), damping=(0.1, 0.0))
        assert run.status == "completed"
        runs.append((len(made), run))
    (some, mine), (all_of_them, plain) = runs
    assert some <= all_of_them - 3  # of 31
    travel = np.abs(plain.positions[-1] - plain.positions[0]).max()
    np.testing.assert_allclose(mine.positions, plain.positions, rtol=0, atol=1e-6 * travel)
    elastic = plain.energies[:, 1]
    np.testing.assert_allclose(mine.energies[:, 1], elastic, rtol=0, atol=1e-5 * elastic.max())


@pytest.mark.slow
def test_stiff_steps_go_on_in_double_precision():
    mesh = ms.sheet(cells=(30, 30))
    shell = ms.Shell(mesh, ms.Isotropic(2e11, 0.3, 1e-3, 1000.0), clamped=mesh.vertices[:, 0] < 0.01)
    runs = [
        ms.simulate(ms.DiscreteShell(shell, backend=backend), duration=2 / 60, dt=1 / 60, gravity=(0, 0, -9.81))
        for backend in ("cholesky", "superlu")
    ]
    assert all(run.status == "completed" for run in runs)
    travel = np.abs(runs[1].positions[-1] - runs[1].positions[0]).max()
    np.testing.assert_allclose(runs[0].positions, runs[1].positions, rtol=0, atol=1e-5 * travel)
