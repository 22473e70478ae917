"""DS in motion: explicit and implicit Euler, their limits, their orders, and what they conserve."""

import re

import numpy as np
import pytest
from scenes import held

from modalshell import (
    DiscreteShell,
    flat_beam,
    leaf,
    sheet,
    simulate,
)
from modalshell.core.errors import OptionError
from modalshell.integrators.state import MotionState
from modalshell.shell.damping import Damping


def small_shell():
    mesh = flat_beam(length=1.0, width=0.25, cells=(8, 2), family="equilateral")
    return held(mesh, 0.19)


DAMPINGS = [Damping(), Damping(3.0, 1e-3), Damping(0.0, 1e-2), Damping(50.0, 0.0)]


@pytest.mark.by_default("damping0", "damping3")
@pytest.mark.parametrize("damping", DAMPINGS)
def test_stable_step_is_the_limit_of_explicit_euler(damping):
    """A rounding-size disturbance stays small 4 % below the estimate and grows 4 % above it."""
    shell = small_shell()
    rung = DiscreteShell(shell, integrator="explicit")
    limit = rung.stable_step(damping)
    noise = 1e-9 * np.random.default_rng(0).standard_normal(shell.rest_positions.shape)
    still = np.zeros_like(noise)
    largest = {}
    for share in (0.96, 1.04):
        state = rung.start_motion(shell.rest_positions + noise)
        for _ in range(400):
            state, _ = rung.step(state, share * limit, still, damping)
            largest[share] = np.abs(state.coordinates - shell.rest_positions).max()
            if largest[share] > 1e-3:
                break
    assert largest[0.96] < 1e-7
    assert largest[1.04] > 1e-3


@pytest.mark.parametrize("damping", DAMPINGS)
def test_stable_step_solves_its_formula(damping):
    """h^2 omega^2 + 2 h c = 4 with the largest eigenvalue of the rest shape, found densely."""
    shell = small_shell()
    free = shell.free_unknowns
    root = np.sqrt(np.repeat(shell.mass, 3)[free])
    largest = np.linalg.eigvalsh(shell.stiffness().toarray()[np.ix_(free, free)] / np.outer(root, root))[-1]
    h = DiscreteShell(shell).stable_step(damping)
    c = damping.mass_factor + damping.stiffness_factor * largest
    assert h**2 * largest + 2.0 * h * c == pytest.approx(4.0, rel=1e-3)
    assert DiscreteShell(shell).stable_step() == pytest.approx(2.0 / np.sqrt(largest), rel=1e-3)


def test_explicit_steps_above_the_limit_are_refused():
    shell = small_shell()
    explicit = DiscreteShell(shell, integrator="explicit")
    limit = explicit.stable_step(Damping(0.5, 1e-4))
    scene = {"gravity": (0.0, 0.0, -1.0), "damping": (0.5, 1e-4)}
    with pytest.raises(OptionError, match="explicit Euler") as refused:
        simulate(explicit, duration=10.5 * limit, dt=1.01 * limit, **scene)
    named = float(re.search(r"at most (\S+) s", str(refused.value))[1])
    assert 0.99 * limit < named <= limit
    run = simulate(explicit, duration=10.0 * limit, dt=0.99 * limit, **scene)
    assert run.status == "completed"
    brave = DiscreteShell(shell, integrator="explicit", allow_unstable_step=True)
    assert simulate(brave, duration=3.1 * limit, dt=1.01 * limit, **scene).times.size > 1
    assert simulate(DiscreteShell(shell), duration=100 * limit, dt=50 * limit, **scene).status == "completed"


def test_an_unstable_motion_says_so():
    shell = small_shell()
    brave = DiscreteShell(shell, integrator="explicit", allow_unstable_step=True)
    limit = brave.stable_step()
    run = simulate(brave, duration=2000 * limit, dt=2.0 * limit, gravity=(0.0, 0.0, -1.0))
    assert "diverged" in run.status
    assert np.isfinite(run.positions).all()


@pytest.mark.slow
@pytest.mark.parametrize("damping", [(0.0, 0.0), (0.5, 1e-3)])
def test_implicit_and_explicit_motion_agree_to_first_order(damping):
    shell = small_shell()
    scene = {"duration": 0.5, "gravity": (0.0, 0.0, -2.0), "damping": damping}

    def end(integrator, steps):
        run = simulate(DiscreteShell(shell, integrator=integrator), dt=0.5 / steps, store_every=steps, **scene)
        assert run.status == "completed"
        assert run.times[-1] == pytest.approx(0.5)
        return run.positions[-1]

    coarse, fine = end("explicit", 4000), end("explicit", 8000)
    reference = 2.0 * fine - coarse
    steps = np.array([50, 100, 200])
    errors = [np.abs(end("implicit", n) - reference).max() for n in steps]
    assert -np.polyfit(np.log(steps), np.log(errors), 1)[0] == pytest.approx(1.0, abs=0.15)
    assert np.abs(fine - reference).max() < 0.1 * errors[-1]
    assert np.abs(reference - shell.rest_positions).max() > 0.1


def test_a_step_solves_its_own_equation():
    """M (v+ - v) / h = f - C v+ - grad E(x+), x+ = x + h v+, on every free vertex; C v+ of changes of measures."""
    shell = small_shell()
    rng = np.random.default_rng(1)
    x = shell.rest_positions + 0.02 * rng.standard_normal(shell.rest_positions.shape)
    rung = DiscreteShell(shell, step_tolerance=1e-7, integrator="implicit")
    state = rung.start_motion(x)
    np.testing.assert_array_equal(state.coordinates[shell.clamped], shell.rest_positions[shell.clamped])
    state.rates = np.where(shell.clamped[:, None], 0.0, 0.5 * rng.standard_normal(x.shape))
    load = shell.gravity_force((1.0, -2.0, -9.81))
    h, damping = 1.0 / 30.0, Damping(0.7, 3e-3)
    after, converged = rung.step(MotionState(state.coordinates, state.rates), h, load, damping)
    assert converged
    mass = shell.mass[:, None]
    damped = shell.damped(shell.changes(state.coordinates), damping.stiffness_factor, h)
    damper = shell.energy_gradient(after.coordinates)[1] - damped.energy_gradient(after.coordinates)[1]
    damper = damper - damping.mass_factor * mass * after.rates
    left = mass * (after.rates - state.rates) / h - load - damper - shell.force(after.coordinates)
    scale = np.linalg.norm((mass * state.rates / h + load)[shell.free])
    assert np.linalg.norm(left[shell.free]) < 1e-7 * scale
    np.testing.assert_allclose(after.coordinates, state.coordinates + h * after.rates, rtol=0, atol=1e-13)
    np.testing.assert_array_equal(after.coordinates[shell.clamped], shell.rest_positions[shell.clamped])


def test_free_fall_is_exact():
    """x_0 + g t^2 / 2 at any step, of any shell without supports."""
    shell = held(leaf(cells=(6, 4)))
    gravity = np.array([0.0, 1.0, -9.81])
    run = simulate(DiscreteShell(shell), duration=2.0, dt=0.1, gravity=gravity)
    k = np.arange(21)
    fallen = (0.1**2 * k**2 / 2)[:, None] * gravity
    assert run.status == "completed"
    np.testing.assert_allclose(run.positions, shell.rest_positions + fallen[:, None], rtol=0, atol=2e-12 * 20.0)


@pytest.mark.by_default("20.0-0.001", "200.0-1e-05")
@pytest.mark.parametrize(("speed", "dt"), [(20.0, 1e-3), (20.0, 1e-6), (200.0, 1e-5)])
def test_short_steps_of_a_fast_shell_feel_gravity(speed, dt):
    """The inertia of a step grows as speed over dt; what counts as balanced must not swallow the load for it."""
    shell = held(leaf(cells=(6, 4)))
    rung = DiscreteShell(shell)
    state = rung.start_motion()
    state.rates = np.tile((0.0, 0.0, -speed), (len(shell.mass), 1))
    for _ in range(20):
        state, _ = rung.step(state, dt, shell.gravity_force((0.0, 0.0, -9.81)), Damping())
    gained = -(state.rates[:, 2].mean() + speed)
    assert gained == pytest.approx(9.81 * dt * 20, rel=1e-3)


@pytest.mark.parametrize("integrator", ["implicit", "explicit"])
def test_a_thrown_shell_keeps_its_momentum(integrator):
    """Linear momentum in both integrators; angular momentum exactly in the explicit one, and ever less in the other."""
    shell = held(sheet(cells=(4, 4)))
    rung = DiscreteShell(shell, integrator=integrator)
    state = rung.start_motion()
    arms = shell.rest_positions - shell.rest_positions.mean(axis=0)
    state.rates = np.cross((0.5, 2.0, -1.0), arms) + np.array([0.3, 0.0, 1.0])
    mass, still = shell.mass[:, None], np.zeros_like(arms)

    def momenta(state):
        return (mass * state.rates).sum(axis=0), np.cross(state.coordinates, mass * state.rates).sum(axis=0)

    linear, angular = momenta(state)
    dt = 0.9 * rung.stable_step() if integrator == "explicit" else 0.02
    for _ in range(200 if integrator == "explicit" else 10):
        state, _ = rung.step(state, dt, still, Damping())
    np.testing.assert_allclose(momenta(state)[0], linear, rtol=0, atol=1e-9)
    assert np.abs(shell.force(state.coordinates)).max() > 1e-3
    if integrator == "explicit":
        np.testing.assert_allclose(momenta(state)[1], angular, rtol=0, atol=1e-12)
    else:
        assert np.linalg.norm(momenta(state)[1] - angular) < 0.1 * np.linalg.norm(angular)


@pytest.mark.slow
def test_damped_motion_comes_to_rest_in_the_static_answer():
    shell = small_shell()
    static = DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -2.0))
    run = simulate(DiscreteShell(shell), duration=10.0, dt=0.1, gravity=(0.0, 0.0, -2.0), damping=(3.0, 0.01))
    assert run.status == "completed"
    np.testing.assert_allclose(run.positions[-1], static.positions, rtol=0, atol=1e-5)
    assert np.abs(static.positions - shell.rest_positions).max() > 0.1


@pytest.mark.slow
def test_stiffness_damping_leaves_rigid_motion_alone():
    """zeta K acts on strain rates only: a falling, spinning shell is slowed by xi M and not by it."""
    shell = held(sheet(cells=(3, 3)))
    gravity = (0.0, 0.0, -9.81)
    free, damped = (
        simulate(DiscreteShell(shell), duration=0.5, dt=0.05, gravity=gravity, damping=damping).positions[-1]
        for damping in ((0.0, 0.0), (0.0, 0.1))
    )
    np.testing.assert_allclose(damped, free, rtol=0, atol=1e-10)
    slowed = [
        simulate(DiscreteShell(shell), duration=0.5, dt=dt, gravity=gravity, damping=(2.0, 0.0)).positions[-1][:, 2]
        for dt in (0.05, 0.025, 0.0125)
    ]
    z = -9.81 / 2.0 * (0.5 - (1.0 - np.exp(-1.0)) / 2.0)
    errors = [np.abs(end - z).max() for end in slowed]
    np.testing.assert_allclose(np.log2([errors[0] / errors[1], errors[1] / errors[2]]), 2.0, rtol=0, atol=0.2)
    assert errors[2] < 1e-3 * abs(z)
