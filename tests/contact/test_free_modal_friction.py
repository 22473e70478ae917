"""Friction and restitution of modal models of shells that no support holds."""

import numpy as np
import pytest
from test_free_modal_contact import DT, FLOOR, GRAVITY, G, falling, tilted

import modalshell as ms

FRICTION = 0.4
RUNGS = {"LMA": ms.LinearModal, "MWTS": ms.ModalWarping, "RSW": ms.RotationStrain}


@pytest.fixture(scope="module")
def shell():
    return ms.Shell(
        ms.sheet(length=0.4, width=0.3, cells=(6, 4)),
        ms.Isotropic(young=1e8, poisson=0.3, thickness=3e-3, density=300.0),
    )


@pytest.fixture(scope="module")
def basis(shell):
    with pytest.warns(ms.ModalShellWarning, match="edges a half wave"):
        return ms.solve_modes(shell, count=12)


def floor(**given):
    return ms.Contact(FLOOR.collider, **given)


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.5, 0.9, 1.5])
@pytest.mark.parametrize("name", ["MWTS", "RSW"])
def test_a_panel_slides_and_sticks_on_a_slope_as_a_block(shell, basis, name, share):
    """It slides with ``g (sin a - mu cos a)``; below the threshold it creeps at the speed that DS states."""
    angle = np.arctan(share * FRICTION)
    slope = ms.Contact(ms.Plane(), friction=FRICTION)
    gravity = G * np.array([np.sin(angle), 0.0, -np.cos(angle)])
    run = ms.simulate(RUNGS[name](basis), duration=30 * DT, dt=DT, gravity=gravity, contacts=[slope])
    assert run.unconverged_steps == 0
    speed = np.diff(run.positions[..., 0].mean(axis=1)) / DT
    if share > 1.0:
        block = G * (np.sin(angle) - FRICTION * np.cos(angle))
        assert np.diff(speed)[5:] / DT == pytest.approx(block, rel=5e-3)
    else:
        # The slip of full friction, at most what friction by itself makes of a step.
        most = min(2e-4 * shell.size / DT, FRICTION * G * np.cos(angle) * DT)
        creep = most * (1.0 - np.sqrt(1.0 - share))
        assert speed[-1] == pytest.approx(creep, rel=1e-3)
        assert abs(speed[-1] - speed[-2]) < 1e-5 * creep
        assert f"creeps at {2e-4 * shell.size / DT:.2g} m/s" in run.message
    assert run.deepest.max() <= 1e-9 * shell.size
    assert np.diff(run.energies.sum(axis=1)).max() <= 0.0


@pytest.mark.slow
@pytest.mark.parametrize("name", RUNGS)
def test_momenta_of_a_rubbing_panel_change_by_its_contact_forces_and_friction(shell, basis, name):
    """On a floor the vertical one changes by the normal forces exactly, the others within Coulomb's cone."""
    model, weight = RUNGS[name](basis), shell.mass.sum() * np.array(GRAVITY)
    contact = floor(friction=FRICTION)
    motion, frames = falling(model, contact, start=tilted(shell), dt=1 / 120), model.frames

    def momentum():
        return frames.momenta(motion.state.coordinates, motion.state.rates, model.warped_positions)[0, 0]

    rubbed, energy = 0, motion.energies().sum()
    for _ in range(60):
        before = momentum()
        motion.advance()
        found, last, energy = motion.touched(), energy, motion.energies().sum()
        if not found.touches.any():
            continue
        change = (momentum() - before) * 120 - weight
        pushed = found.forces.sum(axis=0)
        assert abs(change[2] - pushed[2]) <= 1e-9 * np.linalg.norm(weight)
        rubbed += np.linalg.norm(change[:2]) > 1e-3 * pushed[2]
        assert found.deepest <= 1e-9 * shell.size
        assert energy - last <= 1e-12
    assert rubbed > 5
    assert motion.unconverged == 0


def speeds_to_strike(motion):
    """Vertical speeds of the frame after every step, up to the one in which it strikes."""
    speeds = []
    for _ in range(54):
        motion.advance()
        speeds.append(motion.model.frames.poses(motion.state.rates)[0, 0, 2])
        if motion.touched().touches.any():
            break
    return speeds


@pytest.mark.by_default("0.3-MWTS", "1.0-LMA", "1.0-RSW")
@pytest.mark.parametrize("name", RUNGS)
@pytest.mark.parametrize("restitution", [0.3, 1.0])
def test_a_flat_panel_rebounds_by_its_restitution(basis, name, restitution):
    """From rest 0.2 m above the floor it strikes at ``sqrt(2 g 0.2)`` and leaves with that share of its speed."""
    motion = falling(RUNGS[name](basis), floor(restitution=restitution))
    speeds = speeds_to_strike(motion)
    weight = G * motion.shell.mass.sum()
    change = (speeds[-1] - speeds[-2]) / motion.setup.dt * motion.shell.mass.sum()
    assert motion.touched().forces[:, 2].sum() == pytest.approx(change + weight, rel=1e-8)  # the rebound's with them
    assert speeds[-1] == pytest.approx(restitution * np.sqrt(2.0 * G * 0.2), rel=1e-8)
    assert speeds[-2] == pytest.approx(-np.sqrt(2.0 * G * 0.2), rel=0.02)


@pytest.mark.by_default("MWTS")
@pytest.mark.parametrize("name", RUNGS)
def test_a_flat_panel_rebounds_from_a_floor_that_rises(basis, name):
    """Its rebound was kept from energy that the floor gives: there was none."""
    times = 0.05 * np.arange(-40, 41)
    rising = ms.SupportPath(times, 0.3 * times[:, None] * (0.0, 0.0, 1.0))
    contact = ms.Contact(ms.Plane((0.0, 0.0, 1.0), -0.2), restitution=0.6, motion=rising)
    motion = falling(RUNGS[name](basis), contact)
    speeds = speeds_to_strike(motion)
    assert speeds[-1] - 0.3 == pytest.approx(0.6 * np.sqrt(0.3**2 + 2.0 * G * 0.2), rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("angle", [0.3, 0.9])
def test_a_rod_rebounds_with_the_impulse_of_a_rigid_one(angle):
    """``(1 + e) m v / (1 + 3 cos^2 a)``, and the spin ``6 (1 + e) cos a (v / L) / (1 + 3 cos^2 a)``."""
    length, dt, restitution = 1.0, 1e-4, 0.5
    stiff = ms.Isotropic(young=1e17, poisson=0.3, thickness=1e-2, density=100.0)
    rod = ms.Shell(ms.flat_beam(length=length, width=0.02, cells=(40, 1)), stiff)
    model = ms.ModalWarping(ms.solve_modes(rod, count=10))
    start = tilted(rod, (0.0, angle, 0.0))
    below = ms.Contact(ms.Plane((0, 0, 1), start[:, 2].min() - 0.02), restitution=restitution)
    motion, frames, mass = falling(model, below, dt=dt, start=start), model.frames, rod.mass.sum()

    def momenta():
        return frames.momenta(motion.state.coordinates, motion.state.rates, model.warped_positions)[0]

    while not motion.touched().touches.any():
        speed = -momenta()[0, 2] / mass
        motion.advance()
    impulse = momenta()[0, 2] + mass * (speed + G * dt)
    spin = np.abs(frames.spins(motion.state.coordinates, motion.state.rates)[0]).max()
    share = (1.0 + restitution) / (1.0 + 3.0 * np.cos(angle) ** 2)
    assert impulse == pytest.approx(mass * speed * share, rel=2e-3)
    assert spin == pytest.approx(6.0 * np.cos(angle) * speed / length * share, rel=2e-3)


@pytest.mark.by_default("ball")
@pytest.mark.parametrize("contact", [FLOOR.collider, ms.Sphere((0.25, 0.1, -0.4), 0.2)], ids=["floor", "ball"])
def test_a_panel_on_its_corner_gains_no_energy_by_restitution(shell, basis, contact):
    motion = falling(ms.ModalWarping(basis), ms.Contact(contact, restitution=1.0), start=tilted(shell), dt=1 / 480)
    energy, struck = motion.energies().sum(), 0
    for _ in range(150):
        motion.advance()
        last, energy = energy, motion.energies().sum()
        if motion.touched().touches.any():
            struck += 1
            assert energy - last <= 1e-12
    assert struck > 3


@pytest.mark.slow
def test_a_panel_that_falls_into_a_rough_corner_gains_no_energy_and_solves_its_steps(basis, shell):
    """Steps went round between ends, and were given up: 4 of these, with 4 % more energy."""
    start = tilted(shell, (0.5, 0.3, 0.2))
    start -= start.min(axis=0) - [0.02, 0.02, 0.03]
    walls = {(0.0, 0.0, 1.0): 0.3, (1.0, 0.0, 0.2): 0.9, (0.0, 1.0, 0.3): 0.8}
    corner = [ms.Contact(ms.Plane(normal, 0.0), friction=friction) for normal, friction in walls.items()]
    given = {"gravity": (-3.0, -3.0, -9.0), "start": start, "contacts": corner}
    run = ms.simulate(ms.ModalWarping(basis), duration=0.25, dt=1 / 120, **given)
    assert run.unconverged_steps == 0
    assert np.diff(run.energies.sum(axis=1)).max() <= 1e-9 * np.ptp(run.energies[:, 2])
    assert (run.contact_forces.sum(axis=(0, 1)) > 0.0).all()


@pytest.mark.slow
@pytest.mark.parametrize("rung", ["MWTS", "DS"])
def test_a_panel_that_keeps_its_speed_keeps_its_height(basis, shell, rung):
    """Each rebound lost what the load had given within its step: after seven of them half of the energy was left."""
    model, height = RUNGS[rung](basis) if rung in RUNGS else ms.DiscreteShell(shell, integrator="bdf2"), 0.05
    contact = ms.Contact(ms.Plane((0, 0, 1), -height), restitution=1.0)
    run = ms.simulate(model, duration=1.5, dt=DT, gravity=GRAVITY, contacts=[contact])
    peaks = run.positions[..., 2].mean(axis=1)
    peaks = peaks[1:-1][(peaks[1:-1] > peaks[:-2]) & (peaks[1:-1] >= peaks[2:])] + height
    assert len(peaks) == 7
    assert peaks == pytest.approx(height, rel=0.03)
    assert peaks.max() <= height


@pytest.mark.slow
def test_the_error_of_steps_counts_rebounds_as_that_of_discrete_shells_does(basis, shell):
    """Modal models stated 1/20 of it: a step's error was that of one without contacts."""
    given = {"duration": 0.4, "dt": DT, "gravity": GRAVITY, "contacts": [ms.Contact(ms.Plane((0, 0, 1), -0.05))]}
    bouncing = {**given, "contacts": [ms.Contact(ms.Plane((0, 0, 1), -0.05), restitution=1.0)]}
    for one in (given, bouncing):
        modal, full = (ms.simulate(model, **one) for model in (ms.ModalWarping(basis), ms.DiscreteShell(shell)))
        assert np.abs(modal.positions - full.positions).max() < 1e-4
        assert modal.step_error == pytest.approx(full.step_error, rel=1e-2)


@pytest.mark.slow
def test_a_rubbing_motion_resumes_with_the_same_bits(shell, basis):
    contact = floor(friction=FRICTION, restitution=0.5)
    whole, second = (falling(ms.ModalWarping(basis), contact, start=tilted(shell)) for _ in range(2))
    for _ in range(45):
        whole.advance()
    second.restore(whole.snapshot())
    for _ in range(6):
        for one in (whole, second):
            one.advance()
    assert whole.touched().touches.any()
    assert whole.positions().tobytes() == second.positions().tobytes()


def test_what_is_not_taken_is_refused_before_any_work(shell, basis):
    model, held = ms.ModalWarping(basis), ms.Shell(shell.mesh, shell.material, clamped="x < 1e-6")
    anchored = ms.ModalWarping(ms.solve_modes(held, count=4))
    rough, patch = floor(friction=FRICTION), ms.PositionConstraint([5], (0.4, 0.0, 0.0))
    with pytest.raises(ms.OptionError, match=r"statics of MWTS take contacts of shells that supports hold: .*take DS"):
        model.equilibrium(gravity=GRAVITY, contacts=[FLOOR])
    with pytest.raises(ms.OptionError, match=r"statics of MWTS take contacts without friction .* take DS"):
        anchored.equilibrium(gravity=GRAVITY, contacts=[rough])
    for contact in (rough, floor(restitution=0.2)):
        with pytest.raises(ms.OptionError, match=r"friction or restitution, which motions of MWTS .* DS or coarse DS"):
            ms.simulate(anchored, duration=0.1, contacts=[contact])
    with pytest.raises(ms.OptionError, match=r"all six rigid modes \(got 2 rigid modes\)"):
        ms.simulate(ms.LinearModal(ms.solve_modes(shell, count=2)), duration=0.1, contacts=[rough])
    with pytest.raises(ms.OptionError, match="takes contacts or constraints of free parts, not both: hold some"):
        ms.simulate(model, duration=0.1, contacts=[FLOOR], constraints=[patch])
    with pytest.raises(ms.OptionError, match=r"MD-ROM takes contacts of shells that supports hold: .* the hybrid"):
        ms.simulate(ms.ModalDerivatives(shell, 8), duration=0.1, contacts=[FLOOR])
