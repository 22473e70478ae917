"""Rules of full models: what they keep from step to step, and what they refuse."""

import numpy as np
import pytest

import modalshell as ms
from modalshell.core.errors import OptionError
from modalshell.integrators.full import FullIntegrator, Verlet, implicit_rule
from modalshell.integrators.state import MotionState
from modalshell.shell.damping import Damping
from modalshell.springs.conjugate_gradients import ConjugateGradientEuler

TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@pytest.fixture(scope="module")
def shell():
    mesh = ms.flat_beam(cells=(6, 2))
    return ms.Shell(mesh, ms.Material(20.0, 20.0, 0.05, 0.2), clamped=mesh.vertices[:, 0] < 0.2)


class Quarter:
    """A quarter turn about z of the whole scene."""

    rotation = TURN

    def to_world(self, positions):
        return positions @ TURN.T

    def world_velocities(self, _, velocities):
        return velocities @ TURN.T


@pytest.mark.parametrize(
    ("make", "kept"),
    [
        (lambda shell: ms.DiscreteShell(shell, integrator="verlet"), "force"),
        (lambda shell: ms.SpringSheet(shell, integrator="linear_implicit", solver="cg"), "change"),
    ],
)
def test_what_a_rule_keeps_goes_along_with_a_turn_of_the_scene(shell, make, kept):
    """A turned state steps to the turned answer, memory and all; and is as good as new from its arrays."""
    model = make(shell)
    x = shell.rest_positions + 0.01 * np.sin(7.0 * shell.rest_positions[:, ::-1])
    load, damping, dt = shell.gravity_force((0.0, 1.0, -2.0)), Damping(0.5, 1e-4), 1e-4
    state, _ = model.step(model.start_motion(x), dt, load, damping)
    assert list(state.memory) == [kept]
    held = shell.rest_positions[shell.clamped] @ TURN.T
    turned, _ = model.step(model.placed(state, Quarter()), dt, load @ TURN.T, damping, held)
    plain, _ = model.step(state, dt, load, damping)
    expected = model.placed(plain, Quarter())
    for name, array in expected.arrays().items():
        np.testing.assert_allclose(turned.arrays()[name], array, rtol=0, atol=1e-9 * np.abs(array).max())
    copied = model.start_motion().with_arrays({name: array.copy() for name, array in state.arrays().items()})
    again, _ = model.step(copied, dt, load, damping)
    for name, array in plain.arrays().items():
        np.testing.assert_array_equal(again.arrays()[name], array)


def test_verlet_starts_from_any_state(shell):
    model = ms.DiscreteShell(shell, integrator="verlet")
    x = shell.rest_positions + 0.01 * np.sin(7.0 * shell.rest_positions[:, ::-1])
    x[shell.clamped] = shell.rest_positions[shell.clamped]
    load = np.zeros_like(x)
    known, _ = model.step(model.start_motion(x), 1e-4, load, Damping())
    bare, _ = model.step(MotionState(x, np.zeros_like(x)), 1e-4, load, Damping())
    np.testing.assert_array_equal(known.coordinates, bare.coordinates)


def test_full_models_take_a_key_or_a_rule(shell):
    assert {"implicit", "linear_implicit", "explicit", "verlet"} <= set(FullIntegrator.known)
    for kind in (ms.DiscreteShell, ms.SpringSheet):
        assert isinstance(kind(shell, integrator=Verlet()).integrator, Verlet)
        with pytest.raises(OptionError, match="integrator must be one of"):
            kind(shell, integrator="implicit_midpoint")


def test_conjugate_gradients_of_one_sheet_serve_no_other_model(shell):
    rule = ms.SpringSheet(shell, integrator="linear_implicit", solver="cg").integrator
    assert isinstance(rule, ConjugateGradientEuler)
    for other in (ms.DiscreteShell(shell, integrator=rule), ms.SpringSheet(shell, integrator=rule)):
        with pytest.raises(OptionError, match="belongs to another sheet"):
            other.start_motion()


def explicit_step(h, stiffness, xi, zeta, q, v, _):
    v = v - h * (stiffness * q + (xi + zeta * stiffness) * v)
    return q + h * v, v, 0.0


def verlet_step(h, stiffness, xi, zeta, q, v, force):
    middle = v * (1.0 - 0.5 * h * xi) + 0.5 * h * force
    q = q + h * middle
    force = -stiffness * (q + zeta * middle)
    return q, (middle + 0.5 * h * force) / (1.0 + 0.5 * h * xi), force


@pytest.mark.parametrize(("name", "step"), [("explicit", explicit_step), ("verlet", verlet_step)])
@pytest.mark.parametrize(("xi", "zeta"), [(0.0, 0.0), (40.0, 0.0), (0.0, 1e-3), (40.0, 1e-3)])
def test_stable_step_is_where_one_mode_ceases_to_be_stable(name, step, xi, zeta):
    """By the matrix of the step of one mode: position, velocity and the inner force that is kept."""
    stiffness = 5e4
    longest = FullIntegrator.chosen(name).stable_step(stiffness, xi, zeta * stiffness)

    def radius(h):
        matrix = np.column_stack([step(h, stiffness, xi, zeta, *start) for start in np.eye(3)])
        return np.abs(np.linalg.eigvals(matrix)).max()

    assert radius(0.999 * longest) <= 1.0 + 1e-9
    assert radius(1.001 * longest) > 1.0


@pytest.mark.by_default("linear_implicit")
@pytest.mark.parametrize("rule", ["linear_implicit", "bdf2"])
def test_a_wind_carries_a_free_sheet_along_to_the_order_of_the_rule(rule):
    """``m v' = c (W - v)^2``; about a sheet at rest it came a quarter less far, by any step."""
    mesh, time, wind = ms.sheet(length=0.3, width=0.2, cells=(3, 2)), 0.4, 3.0
    shell = ms.Shell(mesh, ms.Material(20.0, 20.0, 0.05, 0.2))
    load = ms.Wind((0.0, 0.0, wind), tangential=0.0)
    share = shell.loading(None, None, [load]).force(mesh.vertices)[:, 2].sum() / shell.mass.sum() / wind**2
    way, model = wind * time - np.log1p(share * wind * time) / share, ms.SpringSheet(shell, integrator=rule)
    errors = []
    for steps in (40, 80):
        run = ms.simulate(model, duration=time, dt=time / steps, loads=[load])
        errors.append(abs(shell.mass @ run.positions[-1, :, 2] / shell.mass.sum() - way))
    order = 1.0 if rule == "linear_implicit" else 2.0
    assert np.log2(np.array(errors[:-1]) / errors[1:]) == pytest.approx(order, abs=0.25)


@pytest.mark.by_default("explicit-1.0")
@pytest.mark.parametrize(("rule", "order"), [("verlet", 2.0), ("explicit", 1.0)])
def test_a_load_that_changes_in_time_moves_a_free_sheet_to_the_order_of_an_explicit_rule(rule, order):
    """Both half kicks of Verlet felt the load of the step's end: it was of order one."""
    mesh, time, turn, push = ms.sheet(length=0.3, width=0.2, cells=(3, 2)), 0.1, 21.0, 0.3
    shell = ms.Shell(mesh, ms.Material(2.0, 2.0, 0.005, 2.0))
    load = ms.Scaled(ms.SelfWeight((0.0, 0.0, push)), lambda t: np.sin(turn * t))
    way, errors = push * (time / turn - np.sin(turn * time) / turn**2), []
    for steps in (100, 200, 400):
        run = ms.simulate(ms.SpringSheet(shell, integrator=rule), duration=time, dt=time / steps, loads=[load])
        errors.append(abs(shell.mass @ (run.positions[-1] - mesh.vertices)[:, 2] / shell.mass.sum() - way))
    assert np.log2(np.array(errors[:-1]) / errors[1:]) == pytest.approx(order, abs=0.1)


@pytest.mark.slow
def test_a_hanging_sheet_that_buckles_within_a_step_does_not_creep(monkeypatch):
    """The valley that its fold goes down to is flat within the step's tolerance: it took 1661 iterations."""
    results = []

    def solve(*args):
        results.append(implicit_rule_solve(*args))
        return results[-1]

    implicit_rule_solve = implicit_rule.solve
    monkeypatch.setattr(implicit_rule, "solve", solve)
    mesh = ms.sheet(cells=(49, 49), family="right")
    cloth = ms.Isotropic(young=1e5, poisson=0.3, thickness=2e-3, density=100.0)
    model = ms.DiscreteShell(ms.Shell(mesh, cloth, clamped=[0, 1, 2450, 2451]), integrator="implicit")
    run = ms.simulate(model, duration=0.25, dt=1.0 / 60.0, gravity=(0.0, 0.0, -9.81), damping=(0.1, 0.0))
    assert run.status == "completed"
    assert results[-1].left_saddle
    assert max(result.residual for result in results) <= model.step_tolerance
    assert max(result.iterations for result in results) <= 200
