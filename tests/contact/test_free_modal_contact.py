"""Contacts of modal models of shells that no support holds: they fall on floors and balls."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import modalshell as ms
from modalshell.motion.step_error import Tolerance
from modalshell.motion.stepping import Motion

G = 9.81
GRAVITY = (0.0, 0.0, -G)
FLOOR = ms.Contact(ms.Plane((0, 0, 1), -0.2))
BALL = ms.Contact(ms.Sphere((0.25, 0.1, -0.4), 0.2))
DT = 1 / 240


@pytest.fixture(scope="module")
def shell():
    return ms.Shell(
        ms.sheet(length=0.4, width=0.3, cells=(8, 6)),
        ms.Isotropic(young=1e8, poisson=0.3, thickness=3e-3, density=300.0),
    )


@pytest.fixture(scope="module")
def models(shell):
    basis = ms.solve_modes(shell, count=14)
    full = ms.RotationStrain(basis)
    reduced = ms.ReducedRotationStrain.trained(full, [GRAVITY], mixtures=40)
    return {"LMA": ms.LinearModal(basis), "MWTS": ms.ModalWarping(basis), "RSW": full, "reduced RSW": reduced}


def tilted(shell, angles=(0.3, 0.2, 0.1)):
    rest = shell.rest_positions
    centre = rest.mean(axis=0)
    return (rest - centre) @ Rotation.from_euler("xyz", angles).as_matrix().T + centre


def falling(model, contact, **given):
    return Motion(model, model.shell.loading(GRAVITY, None, None), contacts=[contact], **({"dt": DT} | given))


@pytest.mark.slow
@pytest.mark.parametrize("contact", [FLOOR, BALL], ids=["floor", "ball"])
@pytest.mark.parametrize("name", ["LMA", "MWTS", "RSW", "reduced RSW"])
def test_momenta_change_by_the_impulses_of_contact_and_gravity(shell, models, name, contact):
    model, weight = models[name], shell.mass.sum() * np.array(GRAVITY)
    frames, motion = model.frames, falling(model, contact, start=tilted(shell))

    def momenta():
        return frames.momenta(motion.state.coordinates, motion.state.rates, model.warped_positions)[0]

    touched, energy = 0, motion.energies().sum()
    for _ in range(80):
        before = momenta()
        motion.advance()
        found, last, energy = motion.touched(), energy, motion.energies().sum()
        if found.touches.any():
            touched += 1
            centre = frames.centres[0] + frames.poses(motion.state.coordinates)[0, 0]
            arms = motion.positions() - centre
            impulse = DT * np.array([found.forces.sum(axis=0) + weight, np.cross(arms, found.forces).sum(axis=0)])
            off = np.abs(momenta() - before - impulse).max(axis=1)
            assert off[0] <= 1e-9 * DT * np.linalg.norm(weight)
            assert off[1] <= 1e-9 * DT * np.linalg.norm(weight) * shell.size
            assert found.deepest <= 1e-9 * shell.size
            assert energy - last <= 1e-12
    assert touched > 10
    assert motion.unconverged == 0


@pytest.mark.filterwarnings("ignore:no basis")
def test_a_hybrid_in_flight_changes_its_momentum_by_the_impulses_of_a_ball_and_flies_on():
    shell = ms.Shell(
        ms.sheet(length=0.4, width=0.3, cells=(4, 3)),
        ms.Isotropic(young=1e9, poisson=0.3, thickness=3e-3, density=300.0),
    )
    bent = np.zeros_like(shell.rest_positions)
    bent[:, 2] = (shell.rest_positions[:, 0] - 0.2) ** 2
    bent[:, 2] -= bent[:, 2].mean()
    model = ms.HybridStress.trained(shell, force=bent, modes=8, motions=4)
    motion, mass = falling(model, BALL, start=tilted(shell), dt=1 / 120), shell.mass
    weight, energy, touched = mass.sum() * np.array(GRAVITY), motion.energies().sum(), 0
    for _ in range(60):
        before = motion.state
        motion.advance()
        found, last, energy = motion.touched(), energy, motion.energies().sum()
        if found.touches.any():
            touched += 1
            # While it touches, its coarse shell moves, here of the same vertices.
            first, second = (mass @ model.as_coarse(state).rates for state in (before, motion.state))
            off = np.abs((second - first) * 120 - found.forces.sum(axis=0) - weight).max()
            assert off <= 1e-5 * np.linalg.norm(found.forces.sum(axis=0) + weight)
            assert found.deepest <= 1e-9 * shell.size
            assert energy - last <= 1e-12
    assert 3 < touched < 50
    assert not found.touches.any()
    assert motion.unconverged == 0
    assert motion.state.coordinates.ndim == 1  # the hybrid's own again


@pytest.mark.slow
@pytest.mark.parametrize("name", ["LMA", "MWTS", "RSW"])
def test_a_panel_falls_on_its_corner_as_its_discrete_shell(shell, models, name):
    given = {"duration": 0.5, "dt": 1 / 120, "gravity": GRAVITY, "damping": (1.0, 0.0), "contacts": [FLOOR]}
    given["start"] = tilted(shell)
    run, wanted = ms.simulate(models[name], **given), ms.simulate(ms.DiscreteShell(shell), **given)
    assert run.unconverged_steps == 0
    assert run.in_contact[-1].all()
    np.testing.assert_allclose(run.positions[-1][:, 2], -0.2, atol=1e-4)
    off = np.sqrt(((run.positions - wanted.positions) ** 2).sum(axis=2).mean(axis=1)) / shell.size
    assert off.max() < 0.01
    assert np.diff(run.energies.sum(axis=1)).max() <= 1e-12 * np.ptp(run.energies[:, 2])
    assert run.contact_forces[-1, :, 2].sum() == pytest.approx(G * shell.mass.sum(), rel=1e-3)


@pytest.mark.by_default("0.0")
@pytest.mark.parametrize("restitution", [0.0, 0.6])
def test_forces_of_steps_taken_in_parts_are_means_that_change_the_momentum(shell, models, restitution):
    """Those of the last part alone were told: up to 12 weights off."""
    floor = ms.Contact(FLOOR.collider, restitution=restitution)
    motion = falling(
        models["MWTS"],
        floor,
        dt=1 / 120,
        start=shell.rest_positions + np.array([0, 0, -0.18]),
        tolerance=Tolerance(0.02, 0.2),
    )
    weight, touched = shell.mass.sum() * G, 0
    for _ in range(24):
        before = shell.mass @ motion.stepper.velocities(motion.state, 1e-6)[:, 2]
        motion.advance()
        given = shell.mass @ motion.stepper.velocities(motion.state, 1e-6)[:, 2] - before + weight * motion.setup.dt
        pushed = motion.touched().forces[:, 2].sum()
        assert given / motion.setup.dt == pytest.approx(pushed, abs=1e-9 * weight)
        touched += pushed > 0.0
    assert touched > 1


@pytest.mark.slow
def test_a_flat_fall_is_that_of_a_point(models):
    run = ms.simulate(models["MWTS"], duration=0.4, dt=DT, gravity=GRAVITY, contacts=[FLOOR])
    first = int(run.in_contact.any(axis=1).argmax())
    assert run.in_contact[first].all()
    assert run.times[first] == pytest.approx(np.sqrt(2 * 0.2 / G), abs=DT)
    np.testing.assert_allclose(run.positions[first:, :, 2], -0.2, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("angle", [0.3, 0.9])
def test_a_rod_strikes_the_floor_with_the_impulse_of_a_rigid_one(angle):
    """``m v / (1 + 3 cos^2 a)``, and the spin ``6 cos a (v / L) / (1 + 3 cos^2 a)``."""
    length, dt = 1.0, 1e-4
    stiff = ms.Isotropic(young=1e17, poisson=0.3, thickness=1e-2, density=100.0)
    rod = ms.Shell(ms.flat_beam(length=length, width=0.02, cells=(40, 1)), stiff)
    model = ms.ModalWarping(ms.solve_modes(rod, count=10))
    start = tilted(rod, (0.0, angle, 0.0))
    floor = ms.Contact(ms.Plane((0, 0, 1), start[:, 2].min() - 0.02))
    motion, frames = falling(model, floor, dt=dt, start=start), model.frames

    def momenta():
        return frames.momenta(motion.state.coordinates, motion.state.rates, model.warped_positions)[0]

    while not motion.touched().touches.any():
        speed = -momenta()[0, 2] / rod.mass.sum()
        motion.advance()
    motion.advance()
    motion.advance()
    impulse = momenta()[0, 2] + rod.mass.sum() * (speed + 3 * G * dt)
    spin = np.abs(frames.spins(motion.state.coordinates, motion.state.rates)[0]).max()
    share = 1.0 + 3.0 * np.cos(angle) ** 2
    assert impulse == pytest.approx(rod.mass.sum() * speed / share, rel=0.01)
    assert spin == pytest.approx(6.0 * np.cos(angle) * speed / length / share, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["MWTS", "reduced RSW"])
def test_a_resumed_motion_has_the_same_bits(shell, models, name):
    whole, second = (falling(models[name], FLOOR, start=tilted(shell)) for _ in range(2))
    for _ in range(40):
        whole.advance()
    second.restore(whole.snapshot())
    for _ in range(8):
        for one in (whole, second):
            one.advance()
    assert whole.touched().touches.any()
    assert whole.positions().tobytes() == second.positions().tobytes()


@pytest.mark.slow
def test_parts_that_fly_and_parts_that_are_held_touch_alike():
    """A panel falls beside a cantilever, each on the floor as it does alone."""
    held = ms.flat_beam(length=0.4, width=0.1, cells=(8, 2))
    loose = ms.sheet(length=0.3, width=0.2, cells=(4, 3))
    apart = loose.vertices + np.array([0.0, 0.5, 0.0])
    mesh = ms.TriangleMesh(np.vstack([held.vertices, apart]), np.vstack([held.faces, loose.faces + len(held.vertices)]))
    soft = ms.Isotropic(young=2e6, poisson=0.3, thickness=2e-3, density=200.0)
    floor = ms.Contact(ms.Plane((0, 0, 1), -0.1))
    given = {"duration": 0.4, "dt": DT, "gravity": GRAVITY, "damping": (2.0, 0.0), "contacts": [floor]}
    clamped = np.append(held.vertices[:, 0] < 1e-6, np.zeros(len(apart), bool))
    both = ms.Shell(mesh, soft, clamped=clamped, loose_parts=True)
    alone = ms.Shell(held, soft, clamped="x < 1e-6")
    with pytest.warns(ms.ModalShellWarning, match="modes are spent on rigid motion"):
        basis = ms.solve_modes(both, count=16)
    own = np.count_nonzero(np.abs(basis.modes[: held.vertices.size]).max(axis=0) > 1e-6 * np.abs(basis.modes).max())
    models = [ms.ModalWarping(each, integrator="implicit_euler") for each in (basis, ms.solve_modes(alone, count=own))]
    run, wanted = (ms.simulate(model, **given) for model in models)  # held shells keep order two by others
    assert run.unconverged_steps == 0
    assert run.in_contact[-1, len(held.vertices) :].all()
    beam = run.positions[:, : len(held.vertices)]
    assert wanted.in_contact.any()
    assert np.abs(beam - wanted.positions).max() < 1e-4 * 0.4


def test_statics_of_free_shells_are_refused_by_name(models):
    with pytest.raises(ms.OptionError, match="statics of MWTS take contacts of shells that supports hold"):
        models["MWTS"].equilibrium(gravity=GRAVITY, contacts=[FLOOR])
