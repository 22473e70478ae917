"""Stability margins against dense eigenvalues, and what they do not depend on."""

import numpy as np
import pytest
import scipy.linalg
from scipy.spatial.transform import Rotation

import modalshell as ms
from modalshell.statics.error_bar import ErrorEstimator
from modalshell.statics.margin import lowest_ratio


@pytest.mark.parametrize("lowest", [-30.0, -0.9, -0.05, 0.4])
def test_lanczos_finds_the_lowest_ratio(lowest):
    rng = np.random.default_rng(3)
    count = 60
    elastic = rng.standard_normal((count, count))
    elastic = elastic @ elastic.T + np.eye(count)
    taken = np.linspace(abs(lowest) + 0.5, 3.0 * abs(lowest) + 3.0, count)
    taken[0] = lowest
    vectors = scipy.linalg.cholesky(elastic).T @ np.linalg.qr(rng.standard_normal((count, count)))[0]
    softening = vectors @ np.diag(taken) @ vectors.T
    found = lowest_ratio(lambda b: np.linalg.solve(elastic, b), lambda v: softening @ v, rng.standard_normal(count))
    assert found.value == pytest.approx(1.0 + lowest, abs=0.01 * max(abs(lowest), 0.1))
    quotient = found.direction @ softening @ found.direction / (found.direction @ elastic @ found.direction)
    assert 1.0 + quotient == pytest.approx(found.value)


@pytest.mark.parametrize("alone", [0.0, -0.7, -2.0])
def test_early_iterations_are_fewer_and_miss_no_ratio_far_from_others(alone):
    """One that stands alone has two thousandths of the start, as a shape has that buckles at many times the lowest."""
    rng, count = np.random.default_rng(5), 60
    taken, start = rng.uniform(-0.02, 0.02, count), rng.standard_normal(count)
    taken[0], start[0] = alone or taken[0], 2e-3 * np.linalg.norm(start)
    found = [lowest_ratio(np.copy, lambda v: taken * v, start, early=early) for early in (False, True)]
    assert [one.value for one in found] == pytest.approx([1.0 + taken.min()] * 2, abs=0.01)
    assert found[1].products < 6 <= found[0].products


def test_no_stress_takes_nothing():
    found = lowest_ratio(lambda b: 0.5 * b, lambda v: 0.0 * v, np.ones(9))
    assert (found.value, found.products) == (1.0, 1)


@pytest.mark.parametrize("kind", ["hinges", "shell theory"])
def test_the_margin_is_that_of_the_dense_matrices(kind):
    mesh = ms.v_beam(length=1.0, width=0.2, fold=150.0, cells=(8, 2))
    if kind == "hinges":
        shell = ms.Shell(mesh, ms.Material(200.0, 200.0, 0.05, 0.2), "x < 0.13")
    else:
        shell = ms.Shell(mesh, ms.Isotropic(young=1e8, poisson=0.3, thickness=1e-3, density=200.0), "x < 0.001")
    strength = 20.0 if kind == "hinges" else 0.5
    load = shell.gravity_force((0.0, 0.25 * strength, -strength))
    estimator = ErrorEstimator(shell)
    bar = estimator.bar(np.array(shell.rest_positions), load)
    last, restrict = estimator.last, shell.unknowns.restrict
    stiffness, stressed = (
        restrict(restrict(shell.pattern.condensed(data).toarray()).T)
        for data in (shell.energy_gradient_hessian(last.x, 0)[2], last.stressed)
    )
    exact = scipy.linalg.eigh(stressed, stiffness, eigvals_only=True)[0]
    assert -1.0 < exact < 0.9
    assert bar.margin == pytest.approx(exact, abs=0.01)


def test_it_depends_on_neither_rotations_nor_units():
    mesh = ms.v_beam(length=1.0, width=0.2, fold=150.0, cells=(8, 2))
    turn, millimetre = Rotation.from_rotvec([0.4, -1.0, 2.0]).as_matrix(), 1e3
    turned = ms.TriangleMesh(mesh.vertices @ turn.T + [30.0, 0.0, 0.0], mesh.faces)
    small = ms.TriangleMesh(mesh.vertices * millimetre, mesh.faces)
    gravity = np.array([0.0, 3.0, -12.0])
    bars = []
    for body, material, pull in (
        (mesh, ms.Material(200.0, 200.0, 0.05, 0.2), gravity),
        (turned, ms.Material(200.0, 200.0, 0.05, 0.2), turn @ gravity),
        # In mm, t and s: N/m are 1e-3 N/mm, N m are 1e3 N mm, kg/m^2 are 1e-9 t/mm^2.
        (small, ms.Material(0.2, 200.0, 50.0, 0.2e-9), millimetre * gravity),
    ):
        shell = ms.Shell(body, material, np.flatnonzero(mesh.vertices[:, 0] < 0.13))
        bars.append(ms.error_bar(shell, body.vertices, gravity=pull))
    for other in bars[1:]:
        assert other.margin == pytest.approx(bars[0].margin, abs=1e-3)
        assert other.displacement == pytest.approx(bars[0].displacement, rel=1e-5)
