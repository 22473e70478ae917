"""Reduced RSW against the full model: where it is exact, how far it is off within its training, and what it refuses."""

import numpy as np
import pytest
from scenes import held

import modalshell as ms
from modalshell import ReducedRotationStrain, RotationStrain, leaf, measure, solve_modes
from modalshell.core.errors import OptionError
from modalshell.integrators.state import MotionState
from modalshell.shell.damping import Damping
from studies.benchmarks.modes import large_shell


def directions(count, seed):
    vectors = np.random.default_rng(seed).standard_normal((count, 3))
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


def loads(count, largest, seed):
    return directions(count, seed) * largest * np.random.default_rng(seed + 1).uniform(0.1, 1.0, (count, 1))


@pytest.fixture(scope="module")
def models(v_basis):
    full = RotationStrain(v_basis)
    return full, ReducedRotationStrain.trained(full, loads(40, 12.0, seed=0))


def map_error(reduced, full, q):
    rest = full.shell.rest_positions
    return measure.displacement_error(rest + reduced.displacement(q), rest + full.displacement(q), full.shell)


@pytest.mark.slow
def test_held_out_loads_and_motions_are_within_one_percent(models):
    """Trained on 40 gravities up to 12 m/s^2 (tips down to -0.5 L) and mixtures of their answers; tested on others."""
    full, reduced = models
    rng = np.random.default_rng(100)
    static, mixed = [], []
    for gravity in loads(20, 12.0, seed=50):
        q = full.equilibrium(gravity=gravity).coordinates
        static.append(map_error(reduced, full, q))
        mixed.append(map_error(reduced, full, q * rng.uniform(-1.5, 1.5, 8)))
    assert max(static) < 2e-3
    assert max(mixed) < 0.01
    assert reduced.training_error < 0.01
    down = [model.equilibrium(gravity=(0.0, 0.0, -12.0)).positions for model in models]
    assert np.abs(down[0] - full.shell.rest_positions).max() > 0.5


def test_its_own_statics_is_that_of_the_full_model(models):
    full, reduced = models
    for gravity in loads(8, 12.0, seed=70):
        answers = [model.equilibrium(gravity=gravity) for model in (reduced, full)]
        assert all(answer.converged for answer in answers)
        assert measure.displacement_error(answers[0].positions, answers[1].positions, full.shell) < 0.01


def test_small_displacements_are_linear_to_second_order(models):
    full, reduced = models
    q = full.equilibrium(gravity=(0.0, 5.0, -5.0)).coordinates
    sizes = np.logspace(-1.0, -4.0, 4)
    gaps = [np.linalg.norm(reduced.displacement(s * q) - s * (full.basis.modes @ q).reshape(-1, 3)) for s in sizes]
    assert np.polyfit(np.log(sizes), np.log(gaps), 1)[0] == pytest.approx(2.0, abs=0.05)
    assert not reduced.displacement(0.0 * q).any()
    assert not reduced.displacement(q)[full.shell.clamped].any()


def test_force_and_curvature_are_derivatives_of_the_work(models):
    full, reduced = models
    rng = np.random.default_rng(3)
    load = rng.standard_normal(full.shell.rest_positions.shape)
    q, step = (full.equilibrium(gravity=g).coordinates for g in loads(2, 10.0, seed=4))
    work, force = reduced.work(q, load)
    assert work == pytest.approx(float(np.sum(load * reduced.displacement(q))), rel=1e-10)
    curvature = reduced.work_curvature(q, load)
    remainders = []
    for size in (0.04, 0.02, 0.01):
        d = size * step
        remainders.append(abs(reduced.work(q + d, load)[0] - work - force @ d - 0.5 * d @ curvature @ d))
    assert np.polyfit(np.log([4.0, 2.0, 1.0]), np.log(remainders), 1)[0] == pytest.approx(3.0, abs=0.15)


def test_motion_follows_the_full_model(models):
    full, reduced = models
    load = full.shell.gravity_force((0.0, 3.0, -6.0))
    states = [model.start_motion() for model in (full, reduced)]
    largest = 0.0
    for _ in range(120):
        states = [
            m.step(s, 1.0 / 60.0, load, Damping(0.5, 0.0))[0] for m, s in zip((full, reduced), states, strict=True)
        ]
        a, b = (model.positions(state) for model, state in zip((full, reduced), states, strict=True))
        largest = max(largest, float(np.abs(a - b).max()))
    assert np.abs(a - full.shell.rest_positions).max() > 0.2
    assert largest < 0.01


@pytest.mark.slow
def test_training_repeats(models):
    full, reduced = models
    again = ReducedRotationStrain.trained(full, loads(40, 12.0, seed=0))
    np.testing.assert_array_equal(again.triangles, reduced.triangles)
    assert len(np.unique(reduced.triangles)) == 128


def test_a_mesh_of_few_triangles_is_sampled_whole():
    shell = held(leaf(cells=(6, 4)), 0.2)
    full = RotationStrain(solve_modes(shell, 4))
    assert len(shell.mesh.faces) < 128
    reduced = ReducedRotationStrain.trained(full, loads(12, 8.0, seed=1), rank=12)
    assert reduced.triangles.size == len(shell.mesh.faces)
    q = full.equilibrium(gravity=(0.0, 2.0, -6.0)).coordinates
    assert map_error(reduced, full, q) < 5e-3


@pytest.mark.parametrize(
    ("coordinates", "rank", "words"),
    [
        (np.zeros((40, 7)), 32, r"shape \(40, 8\)"),
        (np.full((40, 8), np.nan), 32, "finite"),
        (np.zeros((5, 8)), 32, "at least rank"),
        (np.zeros((40, 8)), 32, "move the shell"),
        ("many", 32, "coordinates"),
        (np.zeros((40, 8)), 0, "rank"),
    ],
    ids=["modes", "nan", "few", "rest", "text", "rank"],
)
def test_bad_training_is_refused(models, coordinates, rank, words):
    with pytest.raises(OptionError, match=words):
        ReducedRotationStrain(models[0], coordinates, rank=rank)


def test_training_on_no_load_is_refused():
    shell = ms.Shell(ms.flat_beam(cells=(8, 2)), ms.Isotropic(1e8, 0.3, 5e-3, 100.0), clamped="x < 1e-9")
    model = ms.RotationStrain(ms.solve_modes(shell, 4))
    with pytest.raises(ms.OptionError, match="at least one of gravities"):
        ms.ReducedRotationStrain.trained(model, gravities=np.zeros((0, 3)))
    with pytest.raises(ms.OptionError, match="at least one of loads"):
        ms.ReducedRotationStrain.trained(model, loads=np.zeros((0, len(shell.mass), 3)))


def test_rest_may_be_among_the_training(models):
    full, reduced = models
    answers = [full.equilibrium(gravity=gravity).coordinates for gravity in loads(40, 12.0, seed=0)]
    again = ReducedRotationStrain(full, np.vstack([np.zeros(8), answers]))
    assert again.training_error < 0.01
    assert map_error(again, reduced, answers[3]) < 0.01


def test_supports_that_leave_a_turn_are_refused():
    mesh = ms.sheet(cells=(6, 6))
    full = RotationStrain(solve_modes(held(mesh, mesh.vertices[:, 0] < 0.1), 10))
    with pytest.raises(OptionError, match=r"got 1 rigid modes, 0 of them of such parts\): hold more vertices"):
        ReducedRotationStrain(full, np.ones((40, 10)))


@pytest.mark.slow
def test_the_creature_is_within_a_hundredth_of_the_full_model():
    """13,000 vertices, 8 modes, swings of 30 % of its length."""
    shell = large_shell(13000)
    full = RotationStrain(solve_modes(shell, 8))
    reduced = ReducedRotationStrain.trained(full, loads(12, 300.0, seed=0))
    errors = [map_error(reduced, full, full.equilibrium(gravity=g).coordinates) for g in loads(3, 300.0, seed=20)]
    assert max(errors) < 0.01
    state = MotionState(full.equilibrium(gravity=(0.0, 300.0, 0.0)).coordinates, np.zeros(8))
    moved = np.abs(reduced.positions(state) - shell.rest_positions).max()
    assert moved > 0.25 * np.ptp(shell.rest_positions, axis=0).max()
