"""The rigid rung: free fall, a torque-free top, steps under a torque, supports, and what it refuses."""

import numpy as np
import pytest
from scenes import leaf, strip
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import modalshell as ms
from modalshell.integrators.state import MotionState
from modalshell.shell.damping import Damping


@pytest.fixture(scope="module")
def free():
    return ms.RigidShell(leaf())


def spinning(spin):
    return MotionState(np.zeros(6), np.concatenate([np.zeros(3), spin]))


def run(model, state, dt, steps, load=None, damping=None):
    load = np.zeros_like(model.shell.rest_positions) if load is None else load
    for _ in range(steps):
        state, converged = model.step(state, dt, load, damping or Damping())
        assert converged
    return state


def inertia(shell):
    r = shell.rest_positions - shell.mass @ shell.rest_positions / shell.mass.sum()
    return np.einsum(
        "n,nij->ij", shell.mass, np.einsum("n,ij->nij", (r**2).sum(1), np.eye(3)) - r[:, :, None] * r[:, None]
    )


def test_free_fall_is_a_parabola(free):
    gravity, dt, steps = np.array([1.0, -2.0, -9.81]), 0.01, 100
    run_ = ms.simulate(free, duration=dt * steps, dt=dt, gravity=gravity)
    expected = free.shell.rest_positions + 0.5 * gravity
    np.testing.assert_allclose(run_.positions[-1], expected, rtol=0, atol=1e-10)
    assert run_.unconverged_steps == 0


@pytest.mark.slow
def test_torque_free_top_conserves_angular_momentum(free):
    state = spinning((0.3, 5.0, 1.0))
    momentum, energy = free.angular_momentum(state), free.kinetic_energy(state)
    energies = []
    for _ in range(1000):
        state = run(free, state, 0.01, 1)
        np.testing.assert_allclose(
            free.angular_momentum(state), momentum, rtol=0, atol=1e-10 * np.linalg.norm(momentum)
        )
        energies.append(free.kinetic_energy(state))
    assert np.abs(np.array(energies) / energy - 1.0).max() < 0.05  # bounded: no drift
    assert np.mean(energies[500:]) == pytest.approx(np.mean(energies[:500]), rel=5e-3)


def test_spin_about_a_principal_axis_is_steady(free):
    shell = free.shell
    _, axes = np.linalg.eigh(inertia(shell))
    state = run(free, spinning(2.0 * axes[:, 2]), 0.01, 100)
    centre = shell.mass @ shell.rest_positions / shell.mass.sum()
    # The discrete top turns by asin(h w) a step about a principal axis, second order in h.
    turned = Rotation.from_rotvec(100 * np.arcsin(0.02) * axes[:, 2])
    np.testing.assert_allclose(
        free.positions(state), turned.apply(shell.rest_positions - centre) + centre, rtol=0, atol=1e-9
    )
    np.testing.assert_allclose(state.rates[3:], 2.0 * axes[:, 2], rtol=0, atol=1e-9)


@pytest.mark.slow
def test_tumbling_meets_eulers_equations_at_second_order(free):
    body = inertia(free.shell)
    spin = np.array([0.5, 3.0, 2.0])

    def slope(_, y):
        vector, scalar, w = y[:3], y[3], y[4:]
        quaternion = 0.5 * np.append(scalar * w + np.cross(vector, w), -vector @ w)
        return np.concatenate([quaternion, np.linalg.solve(body, -np.cross(w, body @ w))])

    exact = solve_ivp(slope, (0.0, 1.0), np.concatenate([[0, 0, 0, 1], spin]), rtol=1e-11, atol=1e-12).y[:4, -1]
    errors = []
    for steps in (100, 200, 400):
        state = run(free, spinning(spin), 1.0 / steps, steps)
        errors.append((Rotation.from_quat(exact).inv() * Rotation.from_rotvec(state.coordinates[3:])).magnitude())
    np.testing.assert_allclose(np.log2([errors[0] / errors[1], errors[1] / errors[2]]), 2.0, rtol=0, atol=0.1)
    assert errors[2] < 1e-3


def test_a_torque_changes_the_angular_momentum(free):
    load = np.zeros_like(free.shell.rest_positions)
    load[0], load[-1] = (0.0, 0.0, 1e-3), (0.0, 0.0, -1e-3)
    state = free.start_motion()
    before = free.positions(state)
    state = run(free, state, 0.01, 1, load)
    after = free.positions(state)
    lever = 0.5 * (before[0] - before[-1] + after[0] - after[-1])
    np.testing.assert_allclose(free.angular_momentum(state), 0.01 * np.cross(lever, load[0]), rtol=0, atol=1e-13)
    np.testing.assert_allclose(state.coordinates[:3], 0.0, atol=1e-15)


def test_damping_slows_both_velocities(free):
    state = MotionState(np.zeros(6), np.array([1.0, 0.0, 0.0, 0.0, 2.0, 0.0]))
    momentum = free.angular_momentum(state)
    state = run(free, state, 0.1, 1, damping=Damping(5.0, 1.0))
    assert state.rates[0] == pytest.approx(np.exp(-0.5), rel=1e-12)
    np.testing.assert_allclose(
        free.angular_momentum(state), momentum * np.exp(-0.5), rtol=0, atol=1e-12 * np.abs(momentum).max()
    )


def test_edges_keep_their_lengths_and_a_start_is_met(free):
    turned = free.shell.rest_positions @ Rotation.from_rotvec((0.4, -1.0, 0.7)).as_matrix().T + (1.0, 2.0, 3.0)
    state = free.start_motion(turned)
    np.testing.assert_allclose(free.positions(state), turned, rtol=0, atol=1e-12)
    moved = free.positions(run(free, MotionState(state.coordinates, np.full(6, 2.0)), 0.02, 50))
    edges = free.shell.mesh.edges
    lengths = np.linalg.norm(moved[edges[:, 1]] - moved[edges[:, 0]], axis=1)
    np.testing.assert_allclose(lengths, free.shell.mesh.edge_lengths, rtol=1e-12)


def test_free_statics_asks_for_balance(free):
    rest = free.shell.rest_positions
    assert free.equilibrium().converged
    falling = free.equilibrium(gravity=(0.0, 0.0, -1.0))
    assert not falling.converged
    assert "no equilibrium" in falling.status
    assert falling.residual == pytest.approx(1.0)
    pulled = np.zeros_like(rest)
    direction = (rest[-1] - rest[0]) / np.linalg.norm(rest[-1] - rest[0])
    pulled[0], pulled[-1] = -direction, direction
    assert free.equilibrium(force=pulled).converged


def test_a_supported_shell_stays():
    shell = leaf(clamped=np.arange(20))
    model = ms.RigidShell(shell)
    answer = model.equilibrium(gravity=(0.0, 0.0, -9.81))
    assert answer.converged
    np.testing.assert_array_equal(answer.positions, shell.rest_positions)
    still = ms.simulate(model, duration=0.5, gravity=(0.0, 0.0, -9.81))
    np.testing.assert_array_equal(still.positions[-1], shell.rest_positions)


def test_a_supported_shell_follows_its_supports():
    shell = leaf(clamped=np.arange(20))
    path = ms.SupportPath([0.0, 1.0], [(0, 0, 0), (1.0, 2.0, 3.0)], [(0, 0, 0), (0.0, 0.0, 1.0)])
    moved = ms.simulate(ms.RigidShell(shell), duration=1.0, supports=path).positions[-1]
    expected = shell.rest_positions @ Rotation.from_rotvec((0.0, 0.0, 1.0)).as_matrix().T + (1.0, 2.0, 3.0)
    np.testing.assert_allclose(moved, expected, rtol=0, atol=1e-12)


def test_half_held_shells_are_refused():
    with pytest.raises(ms.OptionError, match="leave free a turn about"):
        ms.RigidShell(leaf(clamped=[0]))


def test_longest_step_of_a_spin_is_one_radian_and_longer_ones_say_so():
    """About a principal axis the discrete momentum is that of sin c, which reaches ``h omega`` up to one."""
    model = ms.RigidShell(strip())
    for dt, good in ((0.49, True), (0.51, False), (50.0, False)):
        state = model.start_motion()
        state.rates[3:] = (2.0, 0.0, 0.0)
        for _ in range(5):
            state, converged = model.step(state, dt, np.zeros_like(model.shell.rest_positions), Damping())
            assert converged is good
            assert np.isfinite(model.positions(state)).all()
