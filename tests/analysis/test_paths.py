"""Paths of equilibria of shells: every model that has a potential, against its own statics."""

import numpy as np
import pytest
from scenes import PLAIN, cantilever, held, strip

import modalshell as ms
from modalshell.modes import lowest_tangent_eigenvalue

STIFF = ms.Material(2000.0, 2000.0, 0.05, 0.2)


def stiff_v(cells=(20, 4)):
    """The V-beam whose fold flattens and snaps, of the study ``v_beam_accuracy``."""
    mesh = ms.v_beam(length=1.0, width=0.2, fold=150.0, cells=cells)
    return ms.Shell(mesh, STIFF, mesh.vertices[:, 0] < 1.5 / cells[0])


@pytest.fixture(scope="module")
def snapping():
    shell = stiff_v()
    return shell, ms.equilibrium_path(shell, gravity=(0, 0, -1), until=70.0)


@pytest.mark.slow
def test_the_path_of_a_v_beam_is_that_of_load_steps_where_both_exist(snapping):
    shell, path = snapping
    assert path.converged
    assert [event.kind for event in path.events] == ["limit", "limit"]
    snap, back = (event.factor for event in path.events)
    assert back < snap
    assert path.stable[: path.events[0].index].all()
    assert not path.stable[path.events[0].index + 1 : path.events[1].index].any()
    assert path.stable[path.events[1].index + 1 :].all()
    model, load = ms.DiscreteShell(shell), shell.gravity_force((0, 0, -1))
    up = [k for k in range(1, path.events[0].index) if path.factors[k] < 0.99 * snap]
    far = [k for k in range(path.events[1].index + 1, len(path.factors)) if path.factors[k] > 1.05 * snap]
    for chosen in (up[::4], far[::3]):
        assert chosen
        last = None
        for k in chosen:  # as the load grows: from rest, and after the snap from wherever DS has come
            answer = model.equilibrium(force=path.factors[k] * load, start=last)
            assert answer.converged
            np.testing.assert_allclose(answer.positions, path.positions[k], rtol=0, atol=1e-6)
            last = answer.positions


def test_points_balance_and_know_whether_they_are_stable(snapping):
    shell, path = snapping
    load = shell.gravity_force((0, 0, -1))
    assert (path.residuals < 1e-7).all()
    for k in range(1, len(path.factors), 3):
        out = (shell.force(path.positions[k]) + path.factors[k] * load)[shell.free]
        assert np.linalg.norm(out) < 2e-7 * 70.0 * np.linalg.norm(load[shell.free])
        if k not in {event.index for event in path.events}:
            assert (lowest_tangent_eigenvalue(shell, path.positions[k]) > 0.0) == path.stable[k]
    moved = path.positions - shell.rest_positions
    weight = load[shell.free] / np.linalg.norm(load[shell.free], axis=1).sum()
    np.testing.assert_allclose(path.displacements, np.tensordot(moved[:, shell.free], weight, 2), atol=1e-12)


def test_watched_displacements_and_crossings(snapping):
    shell, path = snapping
    tip = int(np.argmax(shell.rest_positions[:, 0] - 10.0 * np.abs(shell.rest_positions[:, 1])))
    watched = ms.equilibrium_path(shell, gravity=(0, 0, -1), until=30.0, watch=([tip], (0, 0, -2)))
    drop = shell.rest_positions[tip, 2] - watched.positions[:, tip, 2]
    np.testing.assert_allclose(watched.displacements, drop, atol=1e-14)
    between = 0.5 * sum(event.factor for event in path.events)
    assert len(path.crossings(between)) == 3
    assert len(path.crossings(60.0)) == 1
    assert path.crossings(0.0) == pytest.approx([0.0])


def test_turning_scene_and_load_turns_the_path(snapping):
    shell, path = snapping
    angle = np.radians(40.0)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    turn = turn @ np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    shift = np.array([3.0, -20.0, 7.0])
    mesh = ms.TriangleMesh(shell.rest_positions @ turn.T + shift, shell.mesh.faces)
    turned = ms.Shell(mesh, STIFF, shell.clamped)
    other = ms.equilibrium_path(turned, gravity=turn @ np.array([0, 0, -1.0]), until=70.0)
    np.testing.assert_allclose([e.factor for e in other.events], [e.factor for e in path.events], rtol=1e-6)
    np.testing.assert_allclose(other.positions[-1], path.positions[-1] @ turn.T + shift, rtol=0, atol=1e-6 * shell.size)


@pytest.mark.slow
def test_the_finer_v_beam_twists_before_it_snaps():
    """A bifurcation before the limit point; both sides of its branch are stable at first, and mirror images."""
    shell = stiff_v((40, 8))
    path = ms.equilibrium_path(shell, gravity=(0, 0, -1), until=70.0, branches=1)
    assert [event.kind for event in path.events] == ["bifurcation", "limit", "bifurcation", "limit"]
    left, right = path.branches
    for branch in (left, right):
        assert branch.parent == path.events[0].index
        assert branch.stable[:3].all()
        assert branch.factors[0] > path.events[0].factor
        assert "joins the path again" in branch.message
    mirror = np.array([1.0, -1.0, 1.0])
    order = [
        int(np.argmin(np.linalg.norm(shell.rest_positions - vertex, axis=1)))
        for vertex in shell.rest_positions * mirror
    ]
    np.testing.assert_allclose(left.positions[2], right.positions[2][order] * mirror, atol=1e-5)
    assert np.abs(left.positions[2] - left.positions[2][order] * mirror).max() > 1e-3
    for k in range(4):
        answer = ms.DiscreteShell(shell).equilibrium(gravity=(0, 0, -left.factors[k]), start=left.positions[k])
        assert answer.converged
        np.testing.assert_allclose(answer.positions, left.positions[k], atol=1e-5)


def isotropic(_):
    mesh = ms.flat_beam(length=1.0, width=0.1, cells=(16, 2))
    sheet = ms.Isotropic(young=1e9, poisson=0.3, thickness=5e-3, density=1000.0)
    return ms.DiscreteShell(ms.Shell(mesh, sheet, mesh.vertices[:, 0] < 1e-9))


MODELS = {
    "DS": (ms.DiscreteShell, 12.0),
    "DS, Isotropic": (isotropic, 8.0),
    "RSW": (lambda shell: ms.RotationStrain(ms.solve_modes(shell, 6)), 12.0),
    "consistent MWTS": (lambda shell: ms.ModalWarping(ms.solve_modes(shell, 6), consistent_force=True), 4.0),
    "MD-ROM": (lambda shell: ms.ModalDerivatives(shell, 4), 12.0),
}
"""By name: how each is made of a shell, and the gravity [m/s^2] it is followed to."""


@pytest.mark.by_default("consistent MWTS", "MD-ROM")
@pytest.mark.parametrize("name", MODELS)
def test_paths_end_at_the_models_own_answers(name):
    make, gravity = MODELS[name]
    model = make(cantilever(fold=150.0))
    path = ms.equilibrium_path(model, gravity=(0, 0, -gravity), steps=6)
    answer = model.equilibrium(gravity=(0, 0, -gravity))
    assert path.converged
    assert answer.converged
    assert path.stable.all()
    assert not path.events
    drop = np.abs(answer.positions - model.shell.rest_positions).max()
    assert drop > 0.1 * model.shell.size
    np.testing.assert_allclose(path.positions[-1], answer.positions, rtol=0, atol=1e-5 * drop)
    half = len(path.factors) // 2
    there = model.equilibrium(gravity=(0, 0, -gravity * path.factors[half]))
    np.testing.assert_allclose(path.positions[half], there.positions, rtol=0, atol=1e-5 * drop)


@pytest.mark.slow
def test_md_rom_buckles_and_snaps_on_a_panel_as_ds_does():
    """A shallow panel held along both straight edges, pushed down: it turns unstable aside first, then snaps."""
    mesh = ms.cylinder_panel(cells=(6, 8), angle=40.0)
    across = np.abs(mesh.vertices[:, 1])
    shell = ms.Shell(mesh, ms.Material(200.0, 200.0, 0.05, 0.2), across > across.max() - 1e-9)
    model = ms.ModalDerivatives(shell, 8)
    exact, reduced = (ms.equilibrium_path(one, gravity=(0, 0, -1), until=1000, steps=30) for one in (shell, model))
    assert exact.converged
    assert reduced.converged
    assert [event.kind for event in exact.events[:2]] == ["bifurcation", "limit"]
    assert [event.kind for event in exact.events] == [event.kind for event in reduced.events]
    for one, other in zip(exact.events[:2], reduced.events[:2], strict=True):
        assert other.factor == pytest.approx(one.factor, rel=0.005)


def test_what_has_no_path_is_refused():
    basis = ms.solve_modes(cantilever(), 4)
    for model in (ms.LinearModal(basis), ms.ModalWarping(basis), ms.RigidShell(cantilever())):
        with pytest.raises(ms.OptionError, match="take DS, RSW or MD-ROM"):
            ms.equilibrium_path(model, gravity=(0, 0, -1))
    with pytest.raises(ms.OptionError, match="supports hold"):
        ms.equilibrium_path(strip(), gravity=(0, 0, -1))
    with pytest.raises(ms.LoadError, match="no load"):
        ms.equilibrium_path(cantilever())
    with pytest.raises(ms.OptionError, match="must be a Model"):
        ms.equilibrium_path("beam.toml")
    for watch in (3, ([0], (0, 0, 0)), ("x > 9", (0, 0, 1))):
        with pytest.raises(ms.OptionError, match="watch"):
            ms.equilibrium_path(cantilever(), gravity=(0, 0, -1), watch=watch)
    with pytest.raises(ms.LoadError, match="positions"):
        ms.equilibrium_path(cantilever(), gravity=(0, 0, -1), start=np.zeros((2, 3)))


def test_a_path_that_ends_early_says_so():
    path = ms.equilibrium_path(held(ms.v_beam(cells=(8, 2)), 0.2, PLAIN), gravity=(0, 0, -5), steps=20, points=5)
    assert path.outcome is ms.Outcome.NOT_CONVERGED
    assert "in 5 points" in path.message
    assert len(path.factors) == 5


@pytest.mark.slow
def test_a_path_of_a_sheet_under_much_stress_begins_at_its_equilibrium():
    """It said that there is none: Newton's method from the shape at rest did not find it."""
    mesh = ms.cylinder_panel(length=0.5, radius=0.4, angle=60.0, cells=(8, 6))
    x, strain, bent = mesh.vertices[:, 0], np.zeros((3, 3)), np.zeros((3, 3))
    strain[:2, :2], bent[:2, :2] = [[3e-4, 1e-4], [1e-4, -2e-4]], [[0.0, 0.2], [0.2, 0.5]]
    shell = ms.Shell(
        mesh,
        ms.Isotropic(young=3e9, poisson=0.3, thickness=8e-4, density=1000.0),
        supports=[ms.Clamp(x < 1e-6), ms.Roller(x > 0.4999, (1, 0, 0))],
        prestrain=strain,
        rest_curvature=bent,
        temperature=ms.Temperature(5.0, 1e-5, through=2.0),
    )
    path = ms.equilibrium_path(shell, gravity=(1.0, 2.0, -9.81), until=0.2)
    assert path.converged
    still = ms.DiscreteShell(shell).equilibrium()
    np.testing.assert_allclose(path.positions[0], still.positions, rtol=0, atol=1e-12)


@pytest.mark.by_default("30.0-1.0")
@pytest.mark.parametrize(("load", "side"), [(-30.0, -1.0), (30.0, 1.0), (-0.01, -1.0)])
def test_a_path_begins_where_a_strip_has_buckled_by_its_own_stresses_to_the_side_of_the_load(load, side):
    """From the straight strip, which is no stable state, it ran back to a factor of -1.02, all of it unstable."""
    mesh = ms.flat_beam(length=1.0, width=0.1, cells=(20, 2))
    sheet, grown = ms.Isotropic(2e9, 0.3, 2e-3, 1000.0), np.diag([1e-3, 0.0, 0.0])
    shell = ms.Shell(mesh, sheet, "x < 1e-6 or x > 0.999999", prestrain=grown)
    path = ms.equilibrium_path(shell, gravity=(0.0, 0.0, load))
    assert path.converged
    assert path.stable.all()
    assert (np.diff(path.factors) > 0.0).all()
    middle = np.abs(mesh.vertices[:, 0] - 0.5) < 1e-6
    assert side * path.positions[0, middle, 2].mean() > 0.01
    straight = ms.equilibrium_path(shell, gravity=(0.0, 0.0, load), start=mesh.vertices, points=2)
    assert not straight.stable.any()
