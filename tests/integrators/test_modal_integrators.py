"""Rules of modal models: theory that is read off the step against closed forms, orders, and names."""

import numpy as np
import pytest
from scipy.linalg import expm

import modalshell as ms
from modalshell.core.errors import OptionError
from modalshell.integrators.modal import Exponential, ImplicitEuler, ImplicitMidpoint, ModalIntegrator
from modalshell.integrators.modal.base import ModalStep
from modalshell.integrators.modal.flow import flow

STIFFNESS = np.array([1e-3, 0.5, 30.0, 4e4, 1e9])
DAMP = 0.2 + 1e-3 * np.sqrt(STIFFNESS)
STEP = 1.0 / 30.0


def zero(q):
    return np.zeros_like(q)


def test_implicit_euler_shrinks_oscillations_by_the_root_of_its_denominator():
    expected = (1.0 + STEP * DAMP + STEP**2 * STIFFNESS) ** -0.5
    np.testing.assert_allclose(ImplicitEuler().amplification(STIFFNESS, DAMP, STEP)[1:], expected[1:], rtol=1e-9)


def test_midpoint_rule_keeps_the_amplitude_and_turns_the_phase_by_twice_an_arctangent():
    rule, root = ImplicitMidpoint(), np.sqrt(STIFFNESS)
    np.testing.assert_allclose(rule.amplification(STIFFNESS, 0.0, STEP), 1.0, rtol=1e-9)
    np.testing.assert_allclose(rule.frequency(STIFFNESS, 0.0, STEP), 2.0 * np.arctan(0.5 * STEP * root) / STEP)
    steps = np.geomspace(1e-4, 10.0, 20)
    np.testing.assert_allclose(rule.frequency(4.0, 0.0, steps), 2.0 * np.arctan(steps) / steps)


def test_impulse_is_the_answer_to_a_unit_force():
    euler = STEP**2 / (1.0 + STEP * DAMP + STEP**2 * STIFFNESS)
    midpoint = 0.5 * STEP**2 / (1.0 + 0.5 * STEP * DAMP + 0.25 * STEP**2 * STIFFNESS)
    np.testing.assert_allclose(ImplicitEuler().impulse(STIFFNESS, DAMP, STEP)[0], euler, rtol=1e-14)
    np.testing.assert_allclose(ImplicitMidpoint().impulse(STIFFNESS, DAMP, STEP)[0], midpoint, rtol=1e-14)


@pytest.mark.parametrize(
    ("stiffness", "damp"),
    [
        (0.0, 0.0),
        (0.0, 3.0),
        (0.0, 600.0),
        (1e-3, 0.2),
        (1e-3, 900.0),
        (30.0, 0.2),
        (4e3, 0.0),
        (4e3, 126.5),
        (4e3, 900.0),
    ],
)
def test_exact_flow_is_that_of_the_matrix_exponential(stiffness, damp):
    """Free, overdamped, rigid and near critical, under a force that goes straight from p_0 to p_1."""
    matrix = np.zeros((4, 4))  # of q, v, p and what p grows by in the step
    matrix[0, 1], matrix[1, :3], matrix[2, 3] = 1.0, (-stiffness, -damp, 1.0), 1.0 / STEP
    exact, c = expm(STEP * matrix), flow(stiffness, damp, STEP)
    found = np.array([[c.e11, c.e12, c.a1, c.a2], [c.e21, c.e22, c.b1, c.b2]])
    np.testing.assert_allclose(found, exact[:2], rtol=1e-9, atol=1e-14)


def test_the_exponential_rule_keeps_the_damping_and_the_frequency_of_free_motion():
    stiffness, ratio = np.array([1.0, 4e3, 1e5]), 0.03
    damp = 2.0 * ratio * np.sqrt(stiffness)
    for step in (1e-3, 1.0 / 30.0, 0.3):
        decay = np.exp(-ratio * np.sqrt(stiffness) * step)
        np.testing.assert_allclose(Exponential().amplification(stiffness, damp, step), decay, rtol=1e-9)
    turn = np.sqrt((1.0 - ratio**2) * stiffness[:1])
    np.testing.assert_allclose(Exponential().frequency(stiffness[:1], damp[:1], 0.3), turn, rtol=1e-9)


def test_free_motion_of_a_rigid_mode_does_not_decay():
    for rule in (Exponential(), ImplicitEuler(), ImplicitMidpoint()):
        assert rule.decay_rate(np.array([0.0, 5.0]), np.array([3.0, 3.0]), STEP) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.by_default("rule1-1.0")
@pytest.mark.parametrize(("rule", "order"), [(Exponential(), 2.0), (ImplicitEuler(), 1.0), (ImplicitMidpoint(), 2.0)])
def test_order_under_a_force_that_couples_the_modes(rule, order):
    stiffness, damp = np.array([4.0, 9.0]), np.array([0.3, 0.5])
    ends = []
    for count in (200, 400, 800):
        q, v = np.array([1.0, -0.5]), np.array([0.0, 2.0])
        for _ in range(count):
            q, v = rule.step(q, v, lambda q: np.sin(q[::-1]), stiffness, damp, 1.0 / count)
        ends.append(q)
    slopes = np.log2(np.abs(ends[1] - ends[0]) / np.abs(ends[2] - ends[1]))
    np.testing.assert_allclose(slopes, order, atol=0.1)


@pytest.fixture(scope="module")
def strips():
    """Bases of a strip that is held at one end, and of one that flies."""
    mesh = ms.sheet(length=0.3, width=0.1, cells=(5, 2))
    material = ms.Isotropic(young=1e8, poisson=0.3, thickness=2e-3, density=1400.0)
    held = ms.Shell(mesh, material, clamped=mesh.vertices[:, 0] < 1e-6)
    return {"held": ms.solve_modes(held, 4), "free": ms.solve_modes(ms.Shell(mesh, material), 10)}


def moved_support(time):
    return (0.0, 0.0, 0.05 * np.sin(7.0 * time) ** 2), (0.0, 0.5 * np.sin(5.0 * time) ** 2, 0.0)


@pytest.mark.by_default("held-wind")
@pytest.mark.parametrize(
    ("which", "what"),
    [("held", "gust"), ("held", "wind"), ("held", "supports"), ("free", "gust"), ("free", "wind")],
)
def test_the_midpoint_rule_is_of_order_two_under_forces_that_change(strips, which, what):
    """It took loads, moving supports and velocities at the steps' ends: of order one, whatever its theory says."""
    asked = {
        "gust": {"loads": [ms.Scaled(ms.Pressure(10.0), lambda time: np.sin(20.0 * time) ** 2)]},
        "wind": {"loads": [ms.Wind((3.0, 1.0, 4.0))]},
        "supports": {"supports": ms.SupportPath.from_function(moved_support, 1.2, step=0.01)},
    }[what]

    def ended(rule, count):
        model = ms.ModalWarping(strips[which], integrator=rule)
        return ms.simulate(model, duration=0.4, dt=0.4 / count, damping=(0.2, 1e-3), **asked).positions[-1]

    truth = ended("exponential", 400)
    errors = [np.abs(ended("implicit_midpoint", count) - truth).max() for count in (25, 50)]
    assert errors[0] > 3.5 * errors[1]


@pytest.mark.slow
@pytest.mark.parametrize("rule", ["exponential", "implicit_midpoint"])
def test_water_stops_a_flying_sheet_within_a_frame(strips, rule):
    """A drag that takes all speed within a step would throw a sheet back, were it kept over the step."""
    model = ms.ModalWarping(strips["free"], integrator=rule)
    water = ms.Wind((0.2, 0.0, 0.3), density=1000.0, normal=1.5)
    ends = []
    for count in (60, 240):
        run = ms.simulate(model, duration=2.0, dt=2.0 / count, gravity=(0.0, 0.0, -3.0), loads=[water])
        assert run.outcome is ms.Outcome.COMPLETED
        ends.append(run.positions[-1] - strips["free"].shell.rest_positions)
    assert np.abs(ends[0] - ends[1]).max() < 0.1 * np.abs(ends[1]).max()


@pytest.mark.parametrize("rule", [ImplicitEuler(), ImplicitMidpoint()])
def test_matrix_takes_any_state_over_a_step(rule):
    random = np.random.default_rng(0)
    stiffness, damp, slope = np.array([4.0, 9.0, 50.0]), np.array([0.3, 0.5, 0.0]), random.standard_normal((3, 3))
    q, v = random.standard_normal((2, 3))
    after = np.concatenate(rule.step(q, v, lambda q: slope @ q, stiffness, damp, 0.1))
    np.testing.assert_allclose(rule.matrix(stiffness, damp, 0.1, slope) @ np.concatenate([q, v]), after, rtol=1e-12)
    uncoupled = np.linalg.eigvals(rule.matrix(stiffness, damp, 0.1, np.zeros((3, 3))))
    np.testing.assert_allclose(
        np.sort(np.abs(uncoupled)), np.sort(np.abs(rule.multipliers(stiffness, damp, 0.1)), None)
    )


@pytest.mark.parametrize(("push", "count"), [(1e-3, 1), (10.0, 2)])
@pytest.mark.parametrize("steps", [2.9, 3.5, 4.1])
def test_forces_that_turn_are_taken_again_where_they_are_large_and_modes_hardly_followed(steps, push, count):
    """The push is over the stiffness and the size; without a hardly followed mode one force is enough."""
    rule, stiffness, asked = Exponential(turning=True), np.array([0.0, 1.0, (2.0 * np.pi / steps) ** 2]), []

    def force(*state):
        asked.append(state)
        return np.array([1e3, 3e-3 * push * stiffness[2], 0.0])

    state = rule.at_rest(np.zeros(3))
    for _ in range(5):
        state = rule.advance(state, force, ModalStep(stiffness, np.zeros(3), 1.0, 1.0))
    assert len(asked) == 1 + 5 * (count if steps == 3.5 else 1)


@pytest.mark.parametrize("rule", [Exponential(), ImplicitEuler(), ImplicitMidpoint()])
def test_many_motions_step_as_one_by_one(rule):
    q, v = np.random.default_rng(1).standard_normal((2, 4, 5))
    together = rule.step(q, v, zero, STIFFNESS, DAMP, STEP)
    for row in range(4):
        alone = rule.step(q[row], v[row], zero, STIFFNESS, DAMP, STEP)
        for a, b in zip(together, alone, strict=True):
            np.testing.assert_array_equal(a[row], b)


def test_models_take_a_key_or_a_rule():
    mesh = ms.flat_beam(cells=(6, 2))
    shell = ms.Shell(mesh, ms.Material(20.0, 20.0, 0.05, 0.2), clamped=mesh.vertices[:, 0] < 0.2)
    basis = ms.solve_modes(shell, 3)
    assert tuple(ModalIntegrator.known)[:3] == ("exponential", "implicit_euler", "implicit_midpoint")
    for choice in ("implicit_midpoint", ImplicitMidpoint()):
        assert isinstance(ms.LinearModal(basis, integrator=choice).integrator, ImplicitMidpoint)
    for wrong in ("verlet", None, 3, ImplicitMidpoint):
        with pytest.raises(OptionError, match="integrator must be one of 'exponential', 'implicit_euler'"):
            ms.LinearModal(basis, integrator=wrong)


def test_a_key_is_given_once():
    with pytest.raises(OptionError, match="'implicit_euler' exists already, as modalshell"):

        class Other(ModalIntegrator, key="implicit_euler"):
            pass
