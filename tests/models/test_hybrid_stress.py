"""The trained rung with assumed membrane stresses: through a snap, on loads that were not in training."""

import contextlib
import pickle
import warnings

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from snaps import coarse_beam, frames_through, motion_error, snapping_beam, snapping_loads

import modalshell as ms
from modalshell.models.hybrid import training as hybrid_training
from modalshell.models.hybrid.assumed_stress import measures_of, reduce_energy
from modalshell.models.hybrid.energy_kernels import evaluate
from modalshell.models.hybrid.hinge_measures import HingeMeasures
from modalshell.models.hybrid.training import GROWING, Trained

DAMPING = (2.0, 0.0)


def stiff_beam(cells, fold=150.0, membrane=2000.0):
    mesh = ms.v_beam(length=1.0, width=0.2, fold=fold, cells=cells)
    return ms.Shell(mesh, ms.Material(membrane, membrane, 0.05, 0.2), mesh.vertices[:, 0] < 1.5 / cells[0])


@pytest.fixture(scope="module")
def shell():
    return stiff_beam((16, 4))


@pytest.fixture(scope="module")
def hybrid(shell):
    return ms.HybridStress.trained(shell, gravity=(0, 0, -70), modes=44, motions=24)


def distance(a, b, shell):
    return np.linalg.norm(a - b) / np.linalg.norm(b - shell.rest_positions)


def terms(reduced, z):
    modes = reduced.membrane.modes
    value, strains, _, gradient, _ = evaluate(reduced, z, np.zeros(modes))
    return value, gradient, strains[:modes]


@pytest.mark.slow
@pytest.mark.parametrize("damping", [(2.0, 0.0), (0.5, 0.001), (0.0, 0.005)])
def test_it_follows_the_shell_through_its_snap_and_back(shell, hybrid, damping):
    truth = ms.DiscreteShell(shell, step_tolerance=1e-3, integrator=hybrid.integrator)
    tilt = np.radians(15.0)
    load = shell.gravity_force((0.0, 70.0 * np.sin(tilt), -70.0 * np.cos(tilt)))
    exact, state, frames = truth.start_motion(), hybrid.start_motion(), []
    for frame in range(30):
        force = load if frame < 20 else np.zeros_like(load)
        exact, _ = truth.step(exact, 1 / 30, force, ms.Damping(*damping))
        state, solved = hybrid.step(state, 1 / 30, force, ms.Damping(*damping))
        assert solved
        frames.append((hybrid.positions(state), truth.positions(exact)))
    own, other = (np.array(part) for part in zip(*frames, strict=True))
    assert other[:, :, 2].min() < -0.6
    assert distance(own, other, shell) < 0.03
    assert state.coordinates.ndim == 1
    assert 0.0 < hybrid.held_out_error < 0.1


def test_its_statics_is_that_of_the_shell_before_and_after_the_snap(shell, hybrid):
    for gravity in (25.0, 70.0):
        answer = hybrid.equilibrium(gravity=(0, 0, -gravity))
        exact = hybrid.coarse.equilibrium(gravity=(0, 0, -gravity))
        assert answer.converged
        assert f"{100 * hybrid.held_out_error:.1f} %" in answer.message
        assert distance(answer.positions, exact.positions, shell) < 0.02


def every_stress(shell):
    """Stresses of all small strains of the edges, orthonormal: the membrane energy of quadratic strains itself."""
    stretch, shear, _ = shell.elements
    weight = np.concatenate([stretch.weight, shear.weight])
    along = HingeMeasures(shell)._along(np.eye(len(weight)))
    strains = (along / shell.elements[1].rest[:, None]).T  # of triangles and edges, by those of edges
    stresses = 2.0 * weight[:, None] * strains
    return np.linalg.solve(np.linalg.cholesky(strains.T @ stresses), stresses.T).T


@pytest.mark.parametrize("membrane", [2000.0, 200.0])
def test_the_reduced_energy_is_exact_to_second_order_and_free_of_rigid_strain(membrane):
    shell = stiff_beam((8, 2), membrane=membrane)
    basis = ms.solve_modes(shell, 6).modes
    rng = np.random.default_rng(0)
    turned = Rotation.from_rotvec([0.3, -0.5, 0.2]).apply(np.array(shell.rest_positions)) - shell.rest_positions
    basis = np.column_stack([basis, turned.ravel()])
    stresses = every_stress(shell)
    weight = np.concatenate([elements.weight for elements in shell.elements[:2]])
    reduced = reduce_energy(measures_of(shell), basis, stresses)
    value, gradient, strains = terms(reduced, np.append(np.zeros(6), 1.0))
    np.testing.assert_allclose(strains, 0.0, atol=1e-12)
    assert value < 1e-12 * weight.max()
    assert np.abs(gradient).max() < 1e-9 * weight.max()
    z = np.append(rng.standard_normal(6), 0.0)
    errors, slopes = [], []
    for size in (1e-4, 5e-5):
        x = shell.rest_positions + size * (basis @ z).reshape(-1, 3)
        exact = shell.elastic_energy.energy(x)
        errors.append(abs(terms(reduced, size * z)[0] - exact) / exact)
        value, gradient, _ = terms(reduced, 1e-3 * z)
        slopes.append(abs(terms(reduced, (1e-3 + size) * z)[0] - value - size * z @ gradient))
    assert errors[0] < 1e-2
    assert errors[1] < 0.55 * errors[0]
    assert np.log2(slopes[0] / slopes[1]) == pytest.approx(2.0, abs=0.1)


def test_flat_hinges_bend_as_their_angle_where_the_sheet_keeps_its_lengths():
    """A cylinder of angle 0.1 between its strips: 2 (1 - cos theta) in place of the angle's square."""
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(10, 2))
    shell = ms.Shell(mesh, ms.Material(20.0, 20.0, 0.05, 0.2), mesh.vertices[:, 0] < 0.15)
    x = np.array(mesh.vertices)
    turns = 0.1 * np.arange(10)
    chain = np.concatenate([[[0.0, 0.0]], np.cumsum(0.1 * np.column_stack([np.cos(turns), np.sin(turns)]), axis=0)])
    rolled = x.copy()
    column = np.rint(x[:, 0] / 0.1).astype(int)
    rolled[:, 0], rolled[:, 2] = chain[column, 0], chain[column, 1]
    rows = np.isclose(x[:, 0], 0.1 * column)
    assert rows.all()
    basis = (rolled - x).reshape(-1, 1)
    stretch, shear, flexure = shell.elements
    none = np.zeros((len(stretch.rest) + len(shear.rest), 0))
    reduced = reduce_energy(measures_of(shell), basis, none)
    exact = flexure.kernel.energy(rolled, flexure.stencils, flexure.rest, flexure.weight)
    assert terms(reduced, np.ones(1))[0] == pytest.approx(exact * 2.0 * (1.0 - np.cos(0.1)) / 0.01, rel=1e-6)


def test_loads_and_states_that_it_cannot_hold_go_to_the_coarse_shell(shell, hybrid):
    load = 0.05 * np.random.default_rng(0).standard_normal(shell.rest_positions.shape)
    answer = hybrid.equilibrium(force=load)
    assert "answered by coarse DS: the basis misses" in answer.message
    state, solved = hybrid.step(hybrid.start_motion(), 1 / 30, load, ms.Damping(*DAMPING))
    assert solved
    assert state.coordinates.shape == shell.rest_positions.shape
    exact, _ = hybrid.coarse.step(hybrid.coarse.start_motion(), 1 / 30, load, ms.Damping(*DAMPING))
    np.testing.assert_allclose(hybrid.positions(state), hybrid.coarse.positions(exact), atol=1e-9)
    weight = shell.gravity_force((0.0, 0.0, -60.0))
    for _ in range(12):  # taken back under a load that it knows
        state, solved = hybrid.step(state, 1 / 30, weight, ms.Damping(*DAMPING))
        assert solved
    assert state.coordinates.ndim == 1


@pytest.mark.by_default("20-0.1-direction0", "70-0.3-direction1")
@pytest.mark.parametrize("direction", [(0, 0, -1), (0, 0, 1), (0, 1, 0), (1, 0, 0)])
@pytest.mark.parametrize(("gravity", "share"), [(0, 0.1), (20, 0.1), (20, 0.3), (70, 0.3)])
def test_a_corner_force_is_handed_over_before_the_start_or_met(shell, hybrid, gravity, share, direction):
    corner = np.argmax(shell.rest_positions[:, :2].sum(axis=1))
    load = np.array(shell.gravity_force((0, 0, -gravity)))
    load[corner] += share * 70.0 * shell.mass.sum() * np.array(direction)
    run, exact = (
        ms.simulate(model, duration=0.8, dt=0.04, force=load, damping=DAMPING) for model in (hybrid, hybrid.coarse)
    )
    assert distance(run.positions, exact.positions, shell) < 0.05
    answer = hybrid.equilibrium(force=load)
    assert distance(answer.positions, hybrid.coarse.equilibrium(force=load).positions, shell) < 0.05
    trained = f"error {100 * hybrid.held_out_error:.1f} % on held-out loads"
    before = "the basis misses", "the assumed stresses are"
    if gravity == 0 or any(f"answered by coarse DS: {reason}" in answer.message for reason in before):
        assert answer.coordinates is None
        assert "answered by coarse DS: the trained model does not hold the load" in run.message
    elif answer.coordinates is None:  # what a load along the beam bends shows at its equilibrium alone
        assert "answered by coarse DS: the assumed stresses do not see the membrane there" in answer.message
        assert direction == (1, 0, 0)
    else:
        assert trained in answer.message or "next to a snap" in answer.message
        assert trained in run.message


def test_saved_and_pickled_it_answers_alike(shell, hybrid, tmp_path):
    hybrid.save(tmp_path / "trained.npz")
    read = ms.HybridStress.load(tmp_path / "trained.npz", shell)
    run = {"duration": 0.4, "dt": 0.05, "gravity": (0, 0, -70), "damping": DAMPING}
    exact = ms.simulate(hybrid, **run).positions
    for other in (read, pickle.loads(pickle.dumps(hybrid))):
        assert np.array_equal(ms.simulate(other, **run).positions, exact)
    assert read.held_out_error == hybrid.held_out_error
    again = ms.Shell(
        ms.TriangleMesh(shell.mesh.vertices, shell.mesh.faces[::-1]), shell.material, clamped=shell.clamped
    )
    constants = {name: getattr(shell.material, name) for name in ("stretch", "shear", "flexure", "density")}
    others = [
        shell.with_material(ms.Material(**constants | {name: 1.1 * constants[name]})) for name in ("flexure", "density")
    ]
    held = shell.mesh.vertices[:, 0] < shell.mesh.vertices[shell.clamped, 0].max() + 0.1
    others += [again, ms.Shell(shell.mesh, shell.material, clamped=held), stiff_beam((8, 2))]
    for other in others:
        with pytest.raises(ms.FileFormatError, match="another coarse shell"):
            ms.HybridStress.load(tmp_path / "trained.npz", other)
    (tmp_path / "trained.npz").write_bytes(b"nothing")
    with pytest.raises(ms.FileFormatError):
        ms.HybridStress.load(tmp_path / "trained.npz", shell)


@pytest.mark.slow
def test_training_counts_and_repeats_itself():
    shell, done = stiff_beam((8, 2)), []
    options = {"gravity": (0, 0, -20), "modes": 8, "motions": 4}
    first = ms.HybridStress.trained(shell, **options, on_step=lambda *counts: done.append(counts))
    assert done[-1] == (14, 14)
    assert ms.HybridStress.trained(shell, **options).held_out_error == first.held_out_error
    assert isinstance(first._trained, Trained)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:no basis of up to 24 vectors")
@pytest.mark.parametrize("rates", [(1.0, 60.0), (1.0, 1e-3)])
def test_training_depends_neither_on_how_fast_a_shell_is_nor_on_the_unit_of_time(rates):
    """In frames of 1/30 s a shell of steel, or one in milliseconds, was trained on other motions."""
    mesh, found = stiff_beam((8, 2)).mesh, []
    for rate in rates:
        stiffness = np.array([2000.0, 2000.0, 0.05]) * rate**2
        shell = ms.Shell(mesh, ms.Material(*stiffness, 0.2), mesh.vertices[:, 0] < 0.19)
        gravity = (0, 0, -60.0 * rate**2)
        found.append(ms.HybridStress.trained(shell, gravity=gravity, modes=24, motions=4).held_out_error)
    assert found[0] == pytest.approx(found[1], rel=1e-4)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:no basis of up to .. vectors")
def test_its_basis_grows_until_a_wanted_error_is_met():
    shell = stiff_beam((8, 2))
    options = {"gravity": (0, 0, -60), "motions": 12}
    errors = {m: ms.HybridStress.trained(shell, **options, modes=m).held_out_error for m in GROWING}
    assert min(errors.values()) < errors[16]
    between = 0.5 * (errors[16] + min(errors.values()))
    size = next(m for m in GROWING if errors[m] <= between)
    found = ms.HybridStress.trained(shell, **options, error=between)
    assert found._trained.basis.shape[1] == size
    assert found.held_out_error == errors[size] <= between
    with pytest.warns(ms.ModalShellWarning, match="meets an error of 1e-12: the best is"):
        least = ms.HybridStress.trained(shell, **options, error=1e-12)
    assert least.held_out_error == min(errors.values())


@pytest.mark.by_default("20-1e-12-20", "8-10.0-8")
@pytest.mark.parametrize(("modes", "error", "size"), [(20, 1e-12, 20), (50, 1e-12, 50), (20, 10.0, 16), (8, 10.0, 8)])
def test_modes_are_the_most_that_a_wanted_error_takes(modes, error, size, monkeypatch):
    """A wanted error that none meets tries them all; the last one is told."""
    shell, tried = stiff_beam((8, 2)), []
    monkeypatch.setattr(
        hybrid_training, "_held_out", lambda found, *_: (tried.append(found.basis.shape[1]) or 1.0, 0.0)
    )
    options = {"gravity": (0, 0, -20), "motions": 4, "modes": modes, "error": error}
    told = f"no basis of up to {size} vectors meets an error of 1e-12: the best is 1 off; allow more modes"
    with pytest.warns(ms.ModalShellWarning, match=told) if error < 1.0 else contextlib.nullcontext():
        ms.HybridStress.trained(shell, **options)
    allowed = [one for one in GROWING if one < modes]
    assert sorted(set(tried)) == ([*allowed, modes] if error < 1.0 else [size])


@pytest.mark.slow
def test_scenes_name_the_wanted_error(scene_file):
    """A scene's table is that of the training's parameters, with the most modes too."""
    for further, size in (("", 16), ("\nmodes = 12", 12)):
        table = f'name = "hybrid"\ncells = [8, 2]\nmotions = 4\nerror = 10.0{further}'
        file = scene_file(('name = "mwts"', table), ("[motion]\nduration = 1\n", ""))
        model = ms.load_scene(file).build().model
        assert model._trained.basis.shape[1] == size
        assert model.held_out_error <= 10.0


def test_wrong_uses_are_refused():
    shell = stiff_beam((8, 2))
    with pytest.raises(ms.OptionError, match="not zero"):
        ms.HybridStress.trained(shell)
    with pytest.raises(ms.OptionError, match="modes"):
        ms.HybridStress.trained(shell, gravity=(0, 0, -1), modes=0)
    with pytest.raises(ms.OptionError, match="modes"):
        ms.HybridStress.trained(shell, gravity=(0, 0, -1), modes=1, error=0.1)
    with pytest.raises(ms.OptionError, match="error"):
        ms.HybridStress.trained(shell, gravity=(0, 0, -1), error=0.0)
    corner = np.arange(len(shell.rest_positions)) == 0
    with pytest.raises(ms.OptionError, match="a linear basis cannot turn"):
        ms.HybridStress.trained(ms.Shell(shell.mesh, shell.material, corner), gravity=(0, 0, -1))


@pytest.mark.slow
def test_trained_on_a_coarse_shell_it_is_near_the_fine_one_through_the_snap():
    """m = 44, none of the loads in training: 3 % in motion, 2 % at rest after the snap.

    In motion by implicit Euler, which damps what would drift apart in phase after the snap. The study of
    held-out snaps has other loads.
    """
    fine, rule = snapping_beam(150.0, (64, 16)), "implicit_euler"
    coarse = coarse_beam(fine, 150.0, (32, 8))
    training = {"gravity": (0, 0, -70), "modes": 44, "motions": 28}
    hybrid = ms.HybridStress.trained(fine, coarse=coarse, integrator=rule, **training)
    truth = ms.DiscreteShell(fine, step_tolerance=1e-4, integrator=rule)
    _, uneven = snapping_loads(fine, 70.0)
    exact = frames_through(truth, uneven, ms.Damping(*DAMPING))
    assert exact[:30, :, 2].min() < -0.7
    assert motion_error(fine, frames_through(hybrid, uneven, ms.Damping(*DAMPING)), exact) < 0.03
    near_at_rest(fine, hybrid, (70.0,), 0.02)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fold", "width", "cells", "gravities", "motions"),
    [(160.0, 0.2, 20, (30.0, 45.0), 16), (150.0, 0.3, 27, (130.0,), 4)],
)
def test_other_folds_and_flanges_are_as_near_at_rest_after_their_snap(fold, width, cells, gravities, motions):
    """On twice as many cells as the shell that trains."""
    fine = snapping_beam(fold, (2 * cells, round(2 * cells * width)), width=width)
    coarse = coarse_beam(fine, fold, (cells, round(cells * width)), width=width)
    with warnings.catch_warnings():  # of motions: what is asked here are states at rest
        warnings.simplefilter("ignore", ms.ModalShellWarning)
        hybrid = ms.HybridStress.trained(fine, gravity=(0, 0, -gravities[-1]), coarse=coarse, motions=motions)
    near_at_rest(fine, hybrid, gravities, 0.04)


def near_at_rest(fine, hybrid, gravities, limit):
    """Statics after the snap, downwards and, under the greatest load, 15 degrees aside."""
    tilt = np.radians(15.0)
    loads = [(0.0, 0.0, -gravity) for gravity in gravities]
    loads.append((0.0, gravities[-1] * np.sin(tilt), -gravities[-1] * np.cos(tilt)))
    truth = ms.DiscreteShell(fine)
    for gravity in loads:
        exact, answer = (model.equilibrium(gravity=gravity) for model in (truth, hybrid))
        assert exact.converged
        assert exact.positions[:, 2].min() < -0.55
        assert "trained on" in answer.message  # not by the coarse shell
        assert ms.measure.displacement_error(answer.positions, exact.positions, fine) < limit


@pytest.mark.slow
def test_its_frequency_holds_the_stiffness_of_loads_that_follow(hybrid):
    """It was that without, and there was none where the coarse shell had answered."""
    turning = ms.FrameInertia(angular_velocity=(9.0, 0.0, 0.0))
    still, turned = (hybrid.equilibrium(gravity=(0.0, 0.0, -20.0), loads=loads) for loads in ([], [turning]))
    squares = [hybrid.tangent_eigenvalue(one, one.loading.force(one.positions)) for one in (still, turned)]
    exact = [hybrid.coarse.equilibrium(gravity=(0.0, 0.0, -20.0), loads=loads) for loads in ([], [turning])]
    coarse = [hybrid.coarse.tangent_eigenvalue(one, one.loading.force(one.positions)) for one in exact]
    assert turned.coordinates is not None
    assert squares[0] - squares[1] == pytest.approx(coarse[0] - coarse[1], rel=0.05)
    assert squares[0] - squares[1] > 0.05 * squares[0]
    handed = hybrid.equilibrium(gravity=(300.0, 0.0, 0.0))
    assert handed.coordinates is None
    known = hybrid.coarse.equilibrium(gravity=(300.0, 0.0, 0.0))
    load = known.loading.dead
    found = hybrid.tangent_eigenvalue(handed, load)
    assert found == pytest.approx(hybrid.coarse.tangent_eigenvalue(known, load), rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("fold", [150.0, 180.0])
def test_soft_membranes_are_met_where_hinges_resist_their_strains(fold):
    """A membrane a thousand times as stiff as the bending: its strains enter the bending of flat hinges."""
    shell = stiff_beam((16, 4), fold, membrane=50.0)
    hybrid = ms.HybridStress.trained(shell, gravity=(0, 0, -20), modes=28, motions=24)
    assert hybrid.held_out_error < 0.02
    for direction in [(0, 0, -1), (0, 1, 0), (0, 0.3, -1)]:
        load = shell.gravity_force(2.0 * np.array(direction))
        answer, exact = hybrid.equilibrium(force=load), hybrid.coarse.equilibrium(force=load)
        assert answer.coordinates is not None
        assert distance(answer.positions, exact.positions, shell) < 0.01


@pytest.mark.slow
def test_membranes_as_soft_as_the_bending_are_handed_to_the_coarse_shell():
    shell = stiff_beam((16, 4), membrane=5.0)
    with pytest.warns(ms.ModalShellWarning, match=r"no basis of up to 28 vectors meets an error of 0\.1"):
        hybrid = ms.HybridStress.trained(shell, gravity=(0, 0, -20), modes=28, motions=24)
    answer = hybrid.equilibrium(gravity=(0, 0, -2))
    assert answer.coordinates is None
    assert "the assumed stresses are" in answer.message
    np.testing.assert_array_equal(answer.positions, hybrid.coarse.equilibrium(gravity=(0, 0, -2)).positions)
