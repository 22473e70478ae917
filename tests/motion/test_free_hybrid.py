"""The hybrid without supports: what it does in its frames, and what it hands over to its coarse shell."""

from itertools import pairwise

import numpy as np
import pytest
from test_free_shells import GRAVITY, MATERIALS, arms_of, centres, couple, model_of, momenta, run_of, shell_of, stepped

import modalshell as ms
from modalshell.integrators.state import MotionState

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore:no basis")]


@pytest.fixture(scope="module", params=MATERIALS)
def flying(request):
    """A hybrid, and a weak load under which it flies by itself."""
    shell = shell_of(request.param)
    model = model_of(request.param, "hybrid")
    return shell, model, 0.2 * couple(shell)


def states_under(model, load, steps=30, dt=1.0 / 60.0, damping=(0.0, 0.0)):
    """States of a motion under a dead load."""
    states = [model.start_motion()]
    for _ in range(steps):
        state, solved = model.step(states[-1], dt, load, ms.Damping(*damping))
        assert solved
        states.append(state)
    return states


def tumbling(model, spin, velocity):
    """State at rest whose frame is set in motion."""
    state = model.start_motion()
    rates = model.flight.frames.with_poses(state.rates, np.array([[velocity, spin]]))
    return MotionState(state.coordinates, rates, state.memory)


def test_a_tumbling_hybrid_keeps_its_momenta(flying):
    shell, model, _ = flying
    frames, _ = stepped(model, tumbling(model, (1.0, 0.4, 3.0), (0.3, 0.0, 0.1)), 1.0 / 60.0, 60)
    found, scale = momenta(shell, frames, 1.0 / 60.0)
    np.testing.assert_allclose(found, found[:1].repeat(len(found), axis=0), rtol=0, atol=1e-6 * scale)
    moved = centres(shell, frames) - centres(shell, frames[:1])
    np.testing.assert_allclose(moved, np.arange(61)[:, None] / 60.0 * [0.3, 0.0, 0.1], rtol=0, atol=1e-9)


def test_tumbling_of_a_hybrid_is_of_second_order():
    model = model_of("hinges", "hybrid")
    ends = [stepped(model, tumbling(model, (1.0, 0.4, 3.0), (0.0, 0.0, 0.0)), 0.5 / n, n) for n in (10, 20, 40, 80)]
    assert all(state.coordinates.ndim == 1 for _, state in ends)  # not handed over
    errors = [np.linalg.norm(a[-1] - b[-1]) for (a, _), (b, _) in pairwise(ends)]
    np.testing.assert_allclose(np.log2([a / b for a, b in pairwise(errors)]), 2.0, rtol=0, atol=0.2)


def test_a_hybrid_turns_by_itself_as_its_coarse_shell(flying):
    shell, model, load = flying
    weight = shell.gravity_force(GRAVITY)
    own, coarse = (states_under(one, load + weight) for one in (model, model.coarse))
    assert all(state.coordinates.ndim == 1 for state in own)  # not handed over
    ends = model.positions(own[-1]), model.coarse.positions(coarse[-1])
    bent = np.abs(model._shape.at(own[-1].coordinates[6:]) - shell.rest_positions).max()
    np.testing.assert_allclose(*ends, rtol=0, atol=max(2e-3, 0.5 * bent))


def test_states_of_a_flying_hybrid_keep_their_momenta_to_its_coarse_shell_and_back(flying):
    _, model, load = flying
    state = states_under(model, load)[-1]
    below = model.as_coarse(state)
    back = model._states.reduced(below)
    parts = model.coarse.free_parts
    given = model.flight.momenta(state.coordinates, state.rates)
    assert np.abs(given).max() > 1e-3
    np.testing.assert_allclose(parts.momenta(below.coordinates, below.rates), given, rtol=0, atol=1e-9)
    np.testing.assert_allclose(model.flight.momenta(back.coordinates, back.rates), given, rtol=0, atol=1e-9)
    np.testing.assert_allclose(back.coordinates, state.coordinates, rtol=0, atol=1e-9)
    np.testing.assert_allclose(back.rates, state.rates, rtol=0, atol=1e-7)
    for name in ("move", "gain"):
        np.testing.assert_allclose(back.memory[name], state.memory[name], rtol=0, atol=1e-7)
    np.testing.assert_allclose(model.coarse.positions(below), model.positions(state), rtol=0, atol=1e-12)
    v = model.velocities(state, model.positions(state), 1e-6)
    np.testing.assert_allclose(model.coarse.velocities(below, model.coarse.positions(below), 1e-6), v, atol=1e-5)


def test_a_hybrid_flies_in_a_wind_as_ds(flying):
    shell, model, _ = flying
    rungs, wind = (model, model.coarse, ms.DiscreteShell(shell, integrator="bdf2")), ms.Wind((2.0, 1.0, 3.0))
    own, coarse, exact = (run_of(one, gravity=GRAVITY, loads=[wind], time=0.3).positions for one in rungs)
    moved = np.abs(exact[-1] - shell.rest_positions - 0.5 * GRAVITY * 0.3**2).max()
    assert moved > 0.1
    floor = np.abs(coarse - exact).max()  # of the coarse mesh
    assert np.abs(own - exact).max() <= 1.2 * floor + 5e-3 * moved


def test_a_free_hybrid_rests_under_balanced_loads_alone(flying):
    shell, model, _ = flying
    assert model.equilibrium(gravity=GRAVITY).outcome is ms.Outcome.NO_EQUILIBRIUM
    x = arms_of(shell, shell.rest_positions)[:, 0]
    load = np.zeros_like(shell.rest_positions)
    load[:, 2] = 2e-3 * shell.mass * (x**2 - shell.mass @ x**2 / shell.mass.sum())
    answer, exact = model.equilibrium(force=load), ms.ModalDerivatives(shell, 16).equilibrium(force=load)
    assert answer.converged
    assert answer.coordinates.ndim == 1
    works = [np.vdot(load, one.positions - shell.rest_positions) for one in (answer, exact)]
    np.testing.assert_allclose(works[0], works[1], rtol=0.1)  # of the coarse mesh


def test_damping_of_a_free_hybrid_slows_its_fall_alone(flying):
    shell, model, _ = flying
    states = states_under(model, shell.gravity_force(GRAVITY), damping=(0.8, 2e-3))
    moved = centres(shell, [model.positions(state) for state in states])[:, 2]
    time, drag = np.arange(len(states)) / 60.0, 0.8
    exact = -9.81 / drag * (time - (1.0 - np.exp(-drag * time)) / drag)
    np.testing.assert_allclose(moved - moved[0], exact, rtol=0, atol=3e-3 * np.abs(exact).max())
    flat = model.positions(states[-1]) - shell.rest_positions
    np.testing.assert_allclose(flat, flat[:1].repeat(len(flat), axis=0), rtol=0, atol=1e-9)
