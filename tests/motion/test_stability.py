"""Long motions of the modal models: energy, rest at the static answer, bounds, and the outcomes that are named."""

import re
from itertools import pairwise, product

import numpy as np
import pytest
from scenes import strip

import modalshell as ms
from modalshell.core.outcome import Outcome
from modalshell.integrators.modal import ImplicitEuler
from modalshell.integrators.modal.flow import flow, turning_flow
from modalshell.shell.damping import Damping
from studies.integrator_drift import SummedWarp

STEP = 1.0 / 30.0
STEPS, BOUNDED_STEPS = 10_000, 2_000
INTEGRATORS = ("exponential", "implicit_euler", "implicit_midpoint")


def strip_basis(ratio, modes=8, cells=(12, 2)):
    """Modes of a clamped strip, ``ratio`` times as stiff in stretch and shear as in flexure (all in N)."""
    mesh = ms.flat_beam(cells=cells)
    material = ms.Material(0.05 * ratio, 0.05 * ratio, 0.05, 0.2)
    return ms.solve_modes(ms.Shell(mesh, material, clamped=mesh.vertices[:, 0] < 1.5 / cells[0]), modes)


@pytest.fixture(scope="module")
def basis():
    return strip_basis(100.0)


def gravity_at(gamma, shell):
    """Gravity downwards at Gamma = (mass per area) g L^3 / D, with the flexure 0.2 D of this mesh family."""
    return (0.0, 0.0, -gamma * 5.0 * float(shell.material.flexure) / float(shell.material.density))


def models(basis, integrator):
    """Every model on a modal basis, by name."""
    return {
        "LMA": ms.LinearModal(basis, integrator=integrator),
        "MWTS": ms.ModalWarping(basis, integrator=integrator),
        "MWTS, consistent": ms.ModalWarping(basis, integrator=integrator, consistent_force=True),
        "MWTS, sum": SummedWarp(basis, integrator=integrator),
        "RSW": ms.RotationStrain(basis, integrator=integrator),
    }


def run(model, gamma, damping, steps=STEPS, store_every=20, **options):
    gravity = gravity_at(gamma, model.shell)
    return ms.simulate(
        model, duration=steps * STEP, dt=STEP, gravity=gravity, damping=damping, store_every=store_every, **options
    )


def reach(trajectory):
    """Largest distance of a vertex from its place at the start, in each frame [m]."""
    return np.linalg.norm(trajectory.positions - trajectory.positions[0], axis=2).max(axis=1)


# ---- energy


@pytest.mark.slow
@pytest.mark.parametrize(("ratio", "gamma"), [(1.0, 4.0), (100.0, 0.0), (1e8, 4.0)])
@pytest.mark.parametrize("integrator", ["exponential", "implicit_midpoint"])
def test_undamped_linear_motion_holds_its_energy(ratio, gamma, integrator):
    basis = strip_basis(ratio)
    bent = np.random.default_rng(0).standard_normal(basis.count) / np.sqrt(basis.eigenvalues)
    start = basis.shell.rest_positions + 0.1 * (basis.modes @ bent).reshape(-1, 3)
    motion = run(ms.LinearModal(basis, integrator=integrator), gamma, (0.0, 0.0), start=start)
    total = motion.energies.sum(axis=1)
    assert np.abs(total - total[0]).max() < 1e-10 * np.abs(total[0])


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [1.0, 1e8])
def test_implicit_euler_only_loses_energy(ratio):
    model = ms.LinearModal(strip_basis(ratio), integrator="implicit_euler")
    motion = run(model, 4.0, (0.0, 0.0), store_every=1)
    total = motion.energies.sum(axis=1)
    assert np.diff(total).max() <= 1e-14 * np.abs(motion.energies).max()
    assert total[-1] < -0.2 * np.abs(motion.energies).max()


@pytest.mark.by_default("RSW-exponential")
@pytest.mark.parametrize("integrator", ["exponential", "implicit_midpoint"])
@pytest.mark.parametrize("model", ["MWTS", "RSW"])
def test_second_order_holds_under_loads_that_turn(model, integrator):
    """Also where the modal force depends on q; the force at each step's beginning would leave first order."""
    chosen = models(strip_basis(1e4, modes=3), integrator)[model]
    gravity = gravity_at(4.0, chosen.shell)
    ends = [
        ms.simulate(chosen, duration=1.0, dt=1.0 / n, gravity=gravity, store_every=n).positions[-1]
        for n in (240, 480, 960)
    ]
    change = [np.abs(a - b).max() for a, b in pairwise(ends)]
    assert np.log2(change[0] / change[1]) == pytest.approx(2.0, abs=0.15)


@pytest.mark.slow
@pytest.mark.parametrize("integrator", ["exponential", "implicit_midpoint"])
def test_rules_of_second_order_feed_no_energy_into_moderate_motion(basis, integrator):
    for name in ("MWTS", "RSW"):
        far = reach(run(models(basis, integrator)[name], 1.0, (0.0, 0.0), steps=5000))
        assert far[len(far) // 2 :].max() < 1.02 * far[: len(far) // 2].max()


@pytest.mark.parametrize("modes", [8, 6])
def test_forces_that_turn_do_not_feed_modes_that_steps_do_not_resolve(modes):
    """Without a force for the step's end these strips leave their equilibrium as exp(10 t) and faster."""
    model = ms.ModalWarping(strip_basis(100.0, modes=modes), consistent_force=True)
    still = model.equilibrium(gravity=gravity_at(44.0, model.shell))
    turned = still.positions + 1e-6 * np.random.default_rng(0).standard_normal(still.positions.shape)
    motion = run(model, 44.0, (2.0, 0.0), steps=300, start=turned)
    assert np.abs(motion.positions[-1] - still.positions).max() < 1e-4  # 1.4e-2 without


def test_modes_of_less_than_three_steps_a_period_take_implicit_eulers_coefficients():
    h, steps = 0.1, np.array([2.0, 2.999, 3.0, 5.0])
    stiffness, damp = (2.0 * np.pi / (steps * h)) ** 2, np.full(4, 0.3)
    exact, turning, euler = flow(stiffness, damp, h), turning_flow(stiffness, damp, h), ImplicitEuler()
    q, v = np.array([1.0, -2.0, 3.0, 0.5]), np.array([4.0, 3.0, -1.0, 2.0])
    expected = euler.step(q, v, np.ones_like, stiffness, damp, h)
    found = turning.e11 * q + turning.e12 * v + turning.a1, turning.e21 * q + turning.e22 * v + turning.b1
    np.testing.assert_allclose(np.array(found)[:, :2], np.array(expected)[:, :2], rtol=1e-14)
    for name in exact._fields:
        np.testing.assert_array_equal(getattr(exact, name)[2:], getattr(turning, name)[2:])


# ---- rest at the static answer


@pytest.mark.by_default("1.0-1.0-exponential")
@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize(("gamma", "damping"), [(1.0, 1.0), (16.0, 1.0), (100.0, 8.0)])
def test_damped_motion_ends_at_the_static_equilibrium(basis, integrator, gamma, damping):
    model = ms.ModalWarping(basis, integrator=integrator)
    still = model.equilibrium(gravity=gravity_at(gamma, basis.shell))
    assert still.converged
    motion = run(model, gamma, (damping, 0.0), steps=3000, store_every=50)
    assert motion.status == "completed"
    moved = still.positions - basis.shell.rest_positions
    assert np.linalg.norm(motion.positions[-1] - still.positions) < 1e-6 * np.linalg.norm(moved)


@pytest.mark.slow
def test_light_damping_does_not_bring_every_equilibrium_about(basis):
    """The paper's force turns with the shell: by its rule it holds a cycle about a fixed point at Gamma = 80."""
    model = ms.ModalWarping(basis, integrator="implicit_euler")
    assert model.equilibrium(gravity=gravity_at(80.0, basis.shell)).converged
    assert run(model, 80.0, (1.0, 0.0), steps=3000).outcome is Outcome.CYCLING
    assert run(model, 80.0, (8.0, 0.0), steps=3000).status == "completed"


# ---- bounds


def coordinate_bound(model, damping, load):
    """Largest |q_j| that modal forces no larger than ``sum_i |Phi_ij| |f_i|`` can bring about: sums of the response."""
    stiffness, h = model.basis.eigenvalues, STEP
    damp = damping[0] + damping[1] * stiffness
    share = 1.0 if model.integrator.key == "implicit_euler" else 0.5
    inertia = 1.0 + share * h * damp + (share * h) ** 2 * stiffness
    q, total = np.zeros_like(stiffness), np.zeros_like(stiffness)
    rates = np.zeros_like(stiffness)
    for step in range(BOUNDED_STEPS):
        push = 1.0 if step == 0 else 0.0
        middle = (rates + share * h * (push - stiffness * q)) / inertia
        q, rates = q + h * middle, rates + (middle - rates) / share
        total += np.abs(q)
    sizes = np.linalg.norm(model.basis.modes.reshape(-1, 3, stiffness.size), axis=1)
    return total * (sizes.T @ np.linalg.norm(load, axis=1))


def check_bounded(ratio, gamma, integrator, damping):
    """MWTS: bounds that hold at every q, since ``|p|`` is bounded. Others: no growth from the first half to the second.

    The warp makes no displacement longer, so that the bound on the coordinates is one on the displacement. What the
    sum carries along is not bounded: it drifts, see the study integrator_drift.
    """
    for name, model in models(strip_basis(ratio), integrator).items():
        motion = run(model, gamma, (damping, 0.0), steps=BOUNDED_STEPS, store_every=20)
        assert np.isfinite(motion.positions).all()
        assert np.isfinite(motion.energies).all()
        if name in FORCES_THAT_GROW and gamma > 100.0 and (ratio < 100.0 or integrator == "implicit_midpoint"):
            continue
        assert motion.outcome is not Outcome.DIVERGED
        far, energy, half = reach(motion), motion.energies[:, 1], len(motion.times) // 2
        if name in ("MWTS", "MWTS, sum"):
            load = model.shell.gravity_force(gravity_at(gamma, model.shell))
            bound = coordinate_bound(model, (damping, 0.0), load)
            assert energy.max() <= 0.5 * model.basis.eigenvalues @ bound**2
            if name == "MWTS":
                sizes = np.linalg.norm(model.basis.modes.reshape(-1, 3, bound.size), axis=1)
                assert far.max() <= (sizes @ bound).max()
                assert far.max() < 2.0 or gamma > 10.0 or ratio < 100.0
        else:
            # A chaotic motion's largest excursion depends on the last bits of the BLAS, its mean does not.
            size = np.mean if name in FORCES_THAT_GROW else np.max
            assert size(energy[half:]) <= 3.0 * size(energy[:half]), name
            assert size(far[half:]) <= 3.0 * size(far[:half]), name


FORCES_THAT_GROW = ("MWTS, consistent", "RSW")
"""``J^T f`` grows with q; taken before the step, it can run away where linear modes ask for a hundred lengths."""


def bounded_cases():
    """Every pair of ratio, load and rule, the harshest among them."""
    rules = (("implicit_euler", 0.0), ("implicit_midpoint", 0.5))
    axes = (1.0, 1e2, 1e5, 1e8), (0.1, 10.0, 100.0, 1000.0), rules
    for (i, ratio), (j, gamma), (k, rule) in product(*map(enumerate, axes)):
        if (i + j + k) % 2 == 0:
            yield ratio, gamma, *rule


@pytest.mark.slow
@pytest.mark.parametrize(("ratio", "gamma", "integrator", "damping"), list(bounded_cases()))
def test_amplitudes_stay_bounded(ratio, gamma, integrator, damping):
    check_bounded(ratio, gamma, integrator, damping)


@pytest.mark.slow
def test_motion_that_leaves_the_model_is_named():
    """RSW where the membrane is as soft as the bending, under a thousand times a moderate load.

    It winds up at once. Whether it leaves the finite numbers after that depends on the last bits of a processor.
    """
    model = ms.RotationStrain(strip_basis(1.0))
    motion = run(model, 1000.0, (0.0, 0.0), store_every=1)
    assert motion.outcome in (Outcome.WOUND_UP, Outcome.RUNS_AWAY, Outcome.DIVERGED)
    assert re.search(r"at [\d.]+ s", motion.message)
    assert np.isfinite(motion.positions).all()
    assert np.isfinite(motion.energies).all()


def test_motion_that_leaves_the_finite_numbers_is_named(basis):
    """Explicit Euler at twice its limit, on any machine."""
    model = ms.DiscreteShell(basis.shell, integrator="explicit", allow_unstable_step=True)
    dt = 2.0 * model.stable_step()
    motion = ms.simulate(model, duration=2000 * dt, dt=dt, gravity=gravity_at(1.0, basis.shell))
    assert motion.outcome is Outcome.DIVERGED
    assert motion.status == "diverged"
    assert re.fullmatch(r"positions left the finite numbers at [\d.e-]+ s", motion.message)
    assert np.isfinite(motion.positions).all()


# ---- outcomes


@pytest.mark.by_default("factors0-exponential", "factors2-implicit_euler")
@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("factors", [(0.3, 0.0), (0.0, 0.02), (2.0, 0.01), (30.0, 0.0), (0.0, 3.0)])
def test_decay_rate_is_what_the_slowest_mode_does(basis, integrator, factors):
    model = ms.LinearModal(basis, integrator=integrator)
    damping = Damping(*factors)
    state = model.start_motion()
    state.rates = 1.0 / np.sqrt(basis.eigenvalues)
    load = np.zeros_like(basis.shell.rest_positions)
    energies = []
    for _ in range(2000):
        state, _ = model.step(state, STEP, load, damping)
        energies.append(basis.eigenvalues * state.coordinates**2 + state.rates**2)
    slopes = []
    for energy in np.array(energies).T:
        late = np.log(energy[energy > 1e-250])
        late = late[late.size // 2 :]
        slopes.append(-np.polyfit(np.arange(late.size) * STEP, late, 1)[0])
    assert min(slopes) == pytest.approx(model.decay_rate(STEP, damping), rel=0.02)


def test_decay_rate_is_unknown_for_rigid_modes_and_full_models():
    shell = strip()
    for model in (ms.LinearModal(ms.solve_modes(shell, 8)), ms.DiscreteShell(shell)):
        assert model.decay_rate(STEP, Damping(3.0, 0.01)) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.by_default("exponential-53.0-factors0")
@pytest.mark.parametrize(
    ("integrator", "gamma", "factors"),
    [
        ("exponential", 53.0, (0.2, 0.0)),
        ("implicit_euler", 60.0, (0.2, 0.0)),
        ("implicit_euler", 60.0, (0.0, 0.01)),
        ("implicit_euler", 100.0, (1.0, 0.0)),
    ],
)
def test_cycles_are_named_under_either_damping(basis, integrator, gamma, factors):
    motion = run(ms.ModalWarping(basis, integrator=integrator), gamma, factors, steps=6000, store_every=3)
    assert motion.outcome is Outcome.CYCLING
    assert motion.message.split("; ")[0] == "the motion does not settle although it is damped"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("integrator", "gamma"),
    [("exponential", 44.0), ("exponential", 47.0), ("implicit_euler", 44.0), ("implicit_euler", 49.0)],
)
def test_slow_decay_is_no_cycle(basis, integrator, gamma):
    """Towards Gamma = 50 the steps feed nearly what light damping eats: at 49 implicit Euler loses 15 % in 12 s."""
    model = ms.ModalWarping(basis, integrator=integrator)
    assert run(model, gamma, (0.2, 0.0), steps=6000, store_every=3).status == "completed"


FACTORS = (0.0, 0.0), (0.02, 0.0), (0.5, 0.0), (0.0, 1e-3), (100.0, 0.0), (0.0, 10.0), (1000.0, 1.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("factors", "integrator"),
    [(one, rule) for i, one in enumerate(FACTORS) for j, rule in enumerate(INTEGRATORS) if (i + j) % 2 == 0],
)
def test_linear_motion_is_never_called_a_cycle(basis, integrator, factors):
    """Undamped, hardly damped, or creeping: linear motion may be slow to settle, but it does."""
    for steps in (60, 600, 3000):
        motion = run(ms.LinearModal(basis, integrator=integrator), 10.0, factors, steps=steps, store_every=1)
        assert motion.outcome in (ms.Outcome.COMPLETED, ms.Outcome.DISTORTED)
        assert "settle" not in motion.message


@pytest.mark.slow
def test_a_falling_shell_with_drag_is_no_cycle():
    shell = strip()
    for model in (ms.ModalWarping(ms.solve_modes(shell, 8)), ms.DiscreteShell(shell)):
        motion = ms.simulate(model, duration=8.0, dt=0.1, gravity=(0, 0, -9.81), damping=(2.0, 0.0))
        assert motion.status == "completed"


def test_creeping_discrete_shell_is_no_cycle():
    motion = ms.simulate(
        ms.DiscreteShell(strip(below=0.2)), duration=5.0, dt=0.1, gravity=(0, 0, -1.0), damping=(300.0, 0.0)
    )
    assert motion.status == "completed"
    assert motion.energies[-1, 0] > 0.1 * motion.energies[1, 0]


@pytest.mark.slow
def test_motion_settled_to_rounding_is_no_cycle(basis):
    motion = run(ms.ModalWarping(basis), 16.0, (8.0, 0.0), steps=6000)
    assert motion.energies[-1, 0] < 1e-20 * np.abs(motion.energies).max()
    assert motion.status == "completed"


def test_winding_up_is_named_with_its_time(basis):
    """Driven there by a strong load, or started there."""
    driven = run(ms.ModalWarping(basis), 1000.0, (0.2, 0.0), steps=300, store_every=1)
    assert driven.outcome is Outcome.WOUND_UP
    assert driven.message.startswith("a part of the shell turned by more than 2 pi at 0.")
    model = ms.ModalWarping(basis)
    q = np.zeros(basis.count)
    q[0] = 2.2 * np.pi / np.linalg.norm(basis.rotations[:, 0].reshape(-1, 3), axis=1).max()
    start = basis.shell.rest_positions + (basis.modes @ q).reshape(-1, 3)
    wound = run(model, 0.0, (1.0, 0.0), steps=30, start=start)
    assert wound.status == "wound up"
    assert wound.message.startswith("a part of the shell turned by more than 2 pi at 0 s; ")
    assert "% of the start's displacement" in wound.message  # which is no shape of its
    start = basis.shell.rest_positions + model.displacement(0.9 * q)
    assert run(model, 0.0, (1.0, 0.0), steps=30, start=start).status == "completed"


@pytest.mark.by_default("50-0.3", "60-1.5")
@pytest.mark.parametrize("ratio", [0.3, 0.7, 1.0, 1.5])
@pytest.mark.parametrize("steps", [50, 60, 150])
def test_motion_near_critical_damping_that_turns_once_is_no_cycle(basis, ratio, steps):
    damping = 2.0 * ratio * float(np.sqrt(basis.eigenvalues[0]))
    for name in ("LMA", "MWTS", "RSW"):
        motion = run(models(basis, "implicit_euler")[name], 1.0, (damping, 0.0), steps=steps, store_every=1)
        assert motion.status == "completed", name


def test_running_away_is_named_before_the_numbers_end(basis):
    """Explicit Euler just above its limit, for too few steps to overflow; and no such word just below."""
    model = ms.DiscreteShell(basis.shell, integrator="explicit", allow_unstable_step=True)
    for factor, steps, outcome in ((1.05, 60, Outcome.RUNS_AWAY), (0.95, 120, Outcome.COMPLETED)):
        dt = factor * model.stable_step()
        motion = ms.simulate(model, duration=steps * dt, dt=dt, gravity=gravity_at(1.0, basis.shell))
        assert motion.outcome is outcome
        assert np.isfinite(motion.positions).all()
        assert np.isfinite(motion.energies).all()


@pytest.mark.by_default("5.0-unstable")
@pytest.mark.parametrize(("factor", "outcome"), [(0.5, Outcome.COMPLETED), (5.0, Outcome.UNSTABLE)])
def test_a_straight_column_that_stays_straight_is_named(factor, outcome):
    """Nothing pushes it aside, so that motion keeps its symmetry; it buckles near 7.84 D over density and length^3."""
    mesh = ms.flat_beam(cells=(20, 2))
    shell = ms.Shell(mesh, ms.Material(200.0, 200.0, 0.05, 0.2), clamped=mesh.vertices[:, 0] < 0.08)
    model = ms.DiscreteShell(shell)
    buckling = gravity_at(7.84, shell)[2]
    motion = ms.simulate(model, duration=3.0, dt=STEP, gravity=(factor * buckling, 0, 0), damping=(0.5, 0.001))
    assert np.abs(motion.positions[..., 2]).max() == 0.0
    assert motion.outcome is outcome
    assert ("saddle" in motion.message) == (outcome is Outcome.UNSTABLE)


@pytest.mark.slow
def test_free_fall_does_not_run_away():
    shell = strip()
    for model in (ms.LinearModal(ms.solve_modes(shell, 8)), ms.RigidShell(shell)):
        assert ms.simulate(model, duration=100.0, dt=1.0, gravity=(0, 0, -9.81)).status == "completed"


@pytest.mark.parametrize("gravity", [1e60, 1e150])
def test_loads_whose_squares_no_sum_can_hold_are_refused(basis, gravity):
    for model in models(basis, "implicit_euler").values():
        with pytest.raises(ms.LoadError, match="gravity must be at most 1e"):
            ms.simulate(model, duration=5.0, dt=0.5, gravity=(0, 0, -gravity))


@pytest.mark.parametrize("gravity", [1e18, 1e30, 1e39])
def test_frames_that_overflow_single_precision_are_not_stored(basis, gravity):
    for name, model in models(basis, "exponential").items():
        motion = ms.simulate(model, duration=0.3, dt=0.1, gravity=(0, gravity, -2.0), dtype="float32")
        assert np.isfinite(motion.positions).all(), name
        assert len(motion.times) == len(motion.positions)


@pytest.mark.parametrize("gravity", [1e40, 1e50])
def test_absurd_loads_leave_finite_frames_and_a_name(basis, gravity):
    """Coordinates that are finite, but whose squares are not, once made frames of NaN under the status "diverged"."""
    for name, model in models(basis, "implicit_euler").items():
        motion = ms.simulate(model, duration=5.0, dt=0.5, gravity=(0, 0, -gravity))
        assert np.isfinite(motion.positions).all(), name
        assert np.isfinite(motion.energies).all(), name
        assert motion.status != "completed" or name == "LMA"


@pytest.mark.parametrize("dt", [0.0, -1.0, 1e-16, 1e160, np.nan])
def test_steps_that_no_sum_can_hold_are_refused(basis, dt):
    with pytest.raises(ms.OptionError, match="dt must be"):
        ms.simulate(ms.LinearModal(basis), duration=1.0, dt=dt)
