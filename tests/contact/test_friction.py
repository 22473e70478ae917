"""Smoothed Coulomb friction of discrete shells in motion: slope, creep, energy, its own derivatives, resume."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import modalshell as ms
from modalshell.contact.active_set import ActiveSet
from modalshell.contact.descent import descend
from modalshell.contact.friction import SLIP, Friction
from modalshell.contact.touching import Touching
from modalshell.motion.stepping import Motion

MU, STEP = 0.4, 1 / 60


def strip(thickness=1e-3):
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(12, 2))
    return ms.Shell(mesh, ms.Isotropic(young=1e8, poisson=0.3, thickness=thickness, density=500.0))


def on_slope(slope, thickness=1e-3, integrator="bdf2"):
    """Speed at the end of half a second on a slope, and the motion."""
    gravity = 9.81 * np.array([np.sin(slope), 0.0, -np.cos(slope)])
    contact = ms.Contact(ms.Plane(), friction=MU)
    model = ms.DiscreteShell(strip(thickness), integrator=integrator)
    run = ms.simulate(model, duration=0.5, dt=STEP, gravity=gravity, contacts=[contact])
    x = run.positions[..., 0].mean(axis=1)
    return (x[-1] - x[-2]) / STEP, run


@pytest.mark.slow
@pytest.mark.parametrize("thickness", [1e-2, 1e-3])
def test_a_strip_slides_down_a_steep_slope_as_a_block(thickness):
    slope = np.arctan(1.3 * MU)
    speed, run = on_slope(slope, thickness)
    assert run.unconverged_steps == 0
    # The mean speed of the last step is that of its middle.
    assert speed == pytest.approx((0.5 - STEP / 2.0) * 9.81 * (np.sin(slope) - MU * np.cos(slope)), rel=1e-3)
    assert np.diff(run.energies.sum(axis=1)).max() <= 1e-12


@pytest.mark.slow
@pytest.mark.parametrize(("integrator", "steps"), [("bdf2", 1), ("composite", 2)])
def test_a_strip_on_a_gentle_slope_creeps_as_the_message_says(integrator, steps):
    speed, run = on_slope(np.arctan(0.9 * MU), integrator=integrator)
    creep = SLIP * 1.0 / STEP * steps  # two steps of implicit Euler stand in for one of the composite rule
    assert speed == pytest.approx(creep * (1.0 - np.sqrt(0.1)), rel=1e-3)
    assert f"creeps at {creep:.2g} m/s" in run.message


def gone(share, *, rung="full", **given):
    """Way of a plate in 0.05 s on a slope at a share of the threshold, and the speed that the message states."""
    slope, mesh = np.arctan(share * MU), ms.flat_beam(length=1.0, width=1.0, cells=(2, 2))
    shell = ms.Shell(mesh, ms.Isotropic(young=1e8, poisson=0.3, thickness=0.05, density=500.0))
    gravity = 9.81 * np.array([np.sin(slope), 0.0, -np.cos(slope)])
    model = {
        "full": lambda: ms.DiscreteShell(shell, integrator="bdf2"),
        "sdirk2": lambda: ms.DiscreteShell(shell),
        "modal": lambda: ms.ModalWarping(ms.solve_modes(shell, count=8)),
    }[rung]()
    run = ms.simulate(model, duration=0.05, gravity=gravity, contacts=[ms.Contact(ms.Plane(), friction=MU)], **given)
    assert run.unconverged_steps == 0
    way = (run.positions[-1] - run.positions[0])[:, 0].mean() * 0.05 / run.times[-1]
    return way, float(run.message.split("creeps at ")[1].split(" m/s")[0])


@pytest.mark.slow
@pytest.mark.parametrize("rung", ["full", "sdirk2", "modal"])
def test_friction_stays_in_short_steps(rung):
    """The slip of full friction was one for all steps: in 1920 a second a block slid twice as far as it does."""
    share = 1.5
    block = 0.5 * 9.81 * (share - 1.0) * MU * np.cos(np.arctan(share * MU)) * 0.05**2
    off = [abs(gone(share, rung=rung, dt=1 / rate)[0] / block - 1.0) for rate in (240, 960)]
    assert off[0] < 0.2
    assert off[1] < 0.3 * off[0]
    crept = [gone(0.75, rung=rung, dt=1 / rate)[0] for rate in (240, 960)]
    assert crept[1] < 0.3 * crept[0]


@pytest.mark.by_default("full")
@pytest.mark.parametrize("rung", ["full", "modal"])
def test_steps_divided_by_a_tolerance_creep_no_faster_than_whole_ones(rung):
    """Each part had the slip of a whole step: what sticks crept ten times as fast as the message said."""
    way, told = gone(0.75, rung=rung, dt=1 / 30, tolerance=2e-4)
    assert 0.2 * told * 0.05 < way < 0.51 * told * 0.05  # at 1 - sqrt(1 - 3/4) of what is told


@pytest.mark.parametrize("rule", ["linear_implicit", "explicit", "verlet"])
def test_what_sticks_is_put_back_where_it_was(rule):
    """Friction stopped the speed along the surface at each step's end alone: what stuck crept at dt g sin(slope)."""
    slope = np.arctan(0.75 * MU)
    gravity = 9.81 * np.array([np.sin(slope), 0.0, -np.cos(slope)])
    shell = ms.Shell(ms.flat_beam(length=1.0, width=1.0, cells=(2, 2)), ms.Material(20.0, 20.0, 1e-3, 1.0))
    model, contact = ms.DiscreteShell(shell, integrator=rule), ms.Contact(ms.Plane(), friction=MU)
    run = ms.simulate(model, duration=0.05, dt=STEP, gravity=gravity, contacts=[contact])
    assert np.abs(run.positions[-1] - run.positions[0]).max() < 1e-3 * STEP * gravity[0] * 0.05


def fall(thickness=1e-3, **options):
    """Motion of a strip that falls onto its end, and then over."""
    shell = strip(thickness)
    x = shell.mesh.vertices[:, 0] - 0.5
    start = np.stack([x * np.cos(0.3), shell.mesh.vertices[:, 1], x * np.sin(0.3) + 0.2], axis=1)
    contact = ms.Contact(ms.Plane(), friction=MU)
    model = ms.DiscreteShell(shell, integrator="bdf2", **options)
    return ms.simulate(model, duration=0.7, dt=STEP, gravity=(0, 0, -9.81), start=start, contacts=[contact])


@pytest.mark.slow
@pytest.mark.parametrize(("thickness", "options"), [(1e-3, {}), (2e-3, {"step_tolerance": 1e-9})])
def test_a_falling_strip_with_friction_gains_no_energy(thickness, options):
    run = fall(thickness, **options)
    assert run.unconverged_steps == 0
    assert run.positions[..., 2].min() >= -1e-9
    assert np.diff(run.energies.sum(axis=1)).max() <= 1e-10 * np.ptp(run.energies[:, 2])


@pytest.mark.slow
def test_a_step_under_better_forces_begins_at_the_answer_under_those_before(monkeypatch):
    solves, iterate = [], ActiveSet.iterate

    def noted(solver, *given):
        solves.append((solver.problem, iterate(solver, *given)))
        return solves[-1][1]

    monkeypatch.setattr(ActiveSet, "iterate", noted)
    assert fall().unconverged_steps == 0
    pairs = [(a[1], b[1]) for a, b in pairwise(solves) if a[0] is b[0]]
    first, again = np.array([(one.iterations, other.iterations) for one, other in pairs]).sum(axis=0)
    assert len(pairs) > 8
    assert again < 1.5 * first
    assert sum(other.converged for _, other in pairs) > 0.8 * len(pairs)


@pytest.mark.slow
def test_what_lies_higher_than_where_a_step_begins_is_no_answer(monkeypatch):
    floor, shell, iterate, count = (
        ms.Contact(ms.Plane(offset=-0.02)),
        strip().holding(np.arange(3)),
        ActiveSet.iterate,
        0,
    )

    def sagging():
        return ms.simulate(ms.DiscreteShell(shell), duration=0.15, dt=STEP, gravity=(0, 0, -9.81), contacts=[floor])

    def stretched(solver, start, active, rules, stresses=None):
        nonlocal count
        count, rest = count + 1, iterate(solver, start, active, rules, stresses)
        return replace(rest, point=1.01 * rest.point + [0.0, 0.0, 1e-3]) if count == 3 else rest

    expected = sagging()
    monkeypatch.setattr(ActiveSet, "iterate", stretched)
    run = sagging()
    assert count > 3
    assert expected.in_contact[-1].any()
    assert np.allclose(run.positions, expected.positions, rtol=0.0, atol=1e-7)


@pytest.mark.slow
def test_a_moving_floor_drags_a_strip_along():
    path = ms.SupportPath([0.0, 0.5, 1.0], [(0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.2, 0.0, 0.0)])
    contact = ms.Contact(ms.Plane(), friction=1.0, motion=path)
    model = ms.DiscreteShell(strip(), integrator="implicit")
    run = ms.simulate(model, duration=0.5, dt=STEP, gravity=(0, 0, -9.81), contacts=[contact])
    moved = run.positions[-1, :, 0].mean() - run.positions[0, :, 0].mean()
    assert moved == pytest.approx(0.1, rel=0.05)


def test_derivatives_of_the_smoothed_work():
    shell = strip()
    contact = ms.Contact(ms.Sphere((0.5, 0.0, -3.0), 3.0), friction=MU)
    touching = Touching([contact], shell)
    random = np.random.default_rng(0)
    pushes = random.uniform(0.0, 2.0, touching.vertices.size)
    x = shell.rest_positions
    friction = Friction(touching, pushes, x, STEP, STEP)
    y = x + SLIP * random.standard_normal(x.shape)
    way = random.standard_normal(x.shape)
    for step in (1e-7,):
        slope = (friction.value(y + step * way) - friction.value(y - step * way)) / (2 * step)
        assert slope == pytest.approx(np.vdot(friction.forces(y), way), rel=1e-5)
        change = (friction.forces(y + step * way) - friction.forces(y - step * way)) / (2 * step)
        data = np.zeros(shell.pattern.size)
        hessian = shell.pattern.free_matrix(data)
        friction.add(y, np.zeros(x.size), hessian)
        size = x.size
        np.testing.assert_allclose((hessian @ np.pad(way.ravel(), (0, hessian.shape[0] - size)))[:size],
                                   change.ravel(), rtol=1e-4, atol=1e-4 * np.abs(change).max())  # fmt: skip


@pytest.mark.slow
def test_a_resumed_motion_with_friction_has_the_same_bits():
    shell = strip()
    gravity = 9.81 * np.array([0.4, 0.0, -0.9])

    def motion():
        loading = shell.loading(gravity, None, None)
        contacts = [ms.Contact(ms.Plane(), friction=MU)]
        return Motion(ms.DiscreteShell(shell, integrator="bdf2"), loading, dt=STEP, contacts=contacts)

    whole, first, second = motion(), motion(), motion()
    for _ in range(8):
        whole.advance()
    for _ in range(5):
        first.advance()
    second.restore(first.snapshot())
    for _ in range(3):
        second.advance()
    assert whole.positions().tobytes() == second.positions().tobytes()


@pytest.mark.slow
@pytest.mark.parametrize("rung", ["modal", "full"])
def test_what_sticks_to_a_turning_table_or_drum_turns_with_it(rung, monkeypatch):
    """In a circle, not along its tangents: it leaves it by no more than it creeps. Newton's steps find that."""
    slow = []
    monkeypatch.setattr(
        "modalshell.contact.steps.descend", lambda *given, **how: slow.append(1) or descend(*given, **how)
    )
    dt, rate, reach, begun = STEP, 3.0, 0.2, 0.3
    times = np.linspace(0.0, 0.8, 65)
    smooth = 0.5 * times - 0.5 * begun / np.pi * np.sin(np.pi * times / begun)
    turns = rate * np.where(times < begun, smooth, times - 0.5 * begun)
    flat = ms.sheet(length=0.1, width=0.1, cells=(2, 2))
    places = flat.vertices - [0.05, 0.0, 0.0]
    bent = np.stack([reach * np.sin(places[:, 0] / reach), places[:, 1], reach * np.cos(places[:, 0] / reach)], axis=1)
    drum = ms.Cylinder((0.0, -1.0, 0.0), (0.0, 1.0, 0.0), reach)
    for body, axis, share, start in (
        (ms.Plane(), np.array([0.0, 0.0, 1.0]), 1.0, places + np.array([reach, 0.0, 0.0])),
        (drum, np.array([0.0, 1.0, 0.0]), 0.25, bent),
    ):
        shell = ms.Shell(ms.TriangleMesh(start, flat.faces), ms.Isotropic(1e8, 0.3, 0.02, 300.0))
        path = ms.SupportPath(times, np.zeros((65, 3)), share * turns[:, None] * axis)
        model = (
            ms.ModalWarping(ms.solve_modes(shell, count=8))
            if rung == "modal"
            else ms.DiscreteShell(shell, integrator="bdf2")
        )
        carried = [ms.Contact(body, friction=0.9, motion=path)]
        run = ms.simulate(model, duration=0.6, dt=dt, gravity=(0.0, 0.0, -9.81), contacts=carried)
        assert run.unconverged_steps == 0
        creeps = SLIP * np.sqrt(0.02) / dt  # by the smoothed law, at the limit
        gone = np.linalg.norm(run.positions[-1].mean(axis=0) - path.at(0.6).to_world(start).mean(axis=0))
        assert gone <= 0.25 * creeps * 0.6  # at less than 0.44 of the limit: 1 - sqrt(1 - 0.44)
    assert len(slow) <= 10  # of 72 steps


@pytest.mark.by_default("mwts-0.0503-0.5")
@pytest.mark.parametrize("restitution", [0.0, 0.5])
@pytest.mark.parametrize("height", [0.05, 0.0503, 0.0511])
@pytest.mark.parametrize("kind", ["ds", "mwts"])
def test_what_strikes_a_slope_is_rubbed_by_its_impulse(kind, height, restitution):
    """A panel that falls flat loses mu times its change of normal speed; it lost up to 1.9 times that."""
    angle, mu, dt = 0.4, 0.2, 1 / 480
    gravity = 9.81 * np.array([np.sin(angle), 0.0, -np.cos(angle)])
    mesh = ms.flat_beam(length=0.1, width=0.1, cells=(3, 3))
    lifted = ms.TriangleMesh(np.array(mesh.vertices) + np.array([0.0, 0.0, height]), mesh.faces)
    shell = ms.Shell(lifted, ms.Isotropic(young=1e9, poisson=0.3, thickness=2e-3, density=300.0))
    model = ms.DiscreteShell(shell) if kind == "ds" else ms.ModalWarping(ms.solve_modes(shell, 8))
    strike = np.sqrt(-2.0 * height / gravity[2])
    frames = int(np.ceil(strike / dt)) + 6
    contact = ms.Contact(ms.Plane(), friction=mu, restitution=restitution)
    run = ms.simulate(model, duration=frames * dt, dt=dt, gravity=gravity, contacts=[contact])
    since, normal = (frames - 0.5) * dt - strike, -gravity[2] * strike
    pressed = -gravity[2] * since if restitution == 0.0 else 0.0
    along = gravity[0] * (strike + since) - mu * ((1.0 + restitution) * normal + pressed)
    speed = np.diff(run.positions[..., 0].mean(axis=1))[-1] / dt
    assert speed == pytest.approx(along, abs=0.03 * mu * normal)
