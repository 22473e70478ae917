"""Motion of discrete shells with contacts: energy, depth, restitution, moving colliders, resume."""

import numpy as np
import pytest

import modalshell as ms
from modalshell.core.outcome import Outcome
from modalshell.core.touched import TouchedFrame
from modalshell.models.base.contact_motion import ContactMotion
from modalshell.motion.colliders import ColliderAccount
from modalshell.motion.step_error import Tolerance
from modalshell.motion.stepping import Motion

GRAVITY = (0.0, 0.0, -9.81)
FLOOR = ms.Contact(ms.Plane())


def strip(thickness=1e-2, cells=16, **sheet):
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(cells, 2))
    material = ms.Isotropic(**{"young": 1e8, "poisson": 0.3, "thickness": thickness, "density": 500.0} | sheet)
    return mesh, material


def tilted(mesh, angle, height):
    """Positions of a strip turned about y, its lowest vertex at ``height``."""
    x = mesh.vertices[:, 0] - 0.5
    z = x * np.sin(angle)
    return np.stack([x * np.cos(angle), mesh.vertices[:, 1], z - z.min() + height], axis=1)


def rise(run):
    """Largest rise of the whole energy from frame to frame, over the work of the load."""
    return np.diff(run.energies.sum(axis=1)).max() / np.ptp(run.energies[:, 2])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("integrator", "thickness"),
    [
        ("implicit", 1e-2),
        ("bdf2", 1e-3),
        ("composite", 1e-3),
        ("composite", 1e-2),
        ("bdf2", 1e-2),
        ("implicit", 1e-3),
    ],
)
def test_a_falling_strip_neither_enters_the_floor_nor_gains_energy(integrator, thickness):
    mesh, material = strip(thickness)
    model = ms.DiscreteShell(ms.Shell(mesh, material), integrator=integrator)
    run = ms.simulate(model, duration=0.6, dt=1 / 60, gravity=GRAVITY, start=tilted(mesh, 0.3, 0.05), contacts=[FLOOR])
    assert run.unconverged_steps == 0
    assert run.positions[..., 2].min() >= -1e-9
    assert run.positions[-1, :, 2].min() <= 1e-9
    assert rise(run) <= 1e-10


@pytest.mark.slow
def test_a_strip_on_a_ball_and_through_a_motion_of_it():
    mesh, material = strip()
    shell = ms.Shell(mesh, material, clamped="x < 1e-9")
    path = ms.SupportPath([0.0, 0.5], [(0.0, 0.0, 0.0), (0.0, 0.0, 0.2)])
    ball = ms.Contact(ms.Sphere((0.8, 0.0, -0.21), 0.2), motion=path)
    run = ms.simulate(ms.DiscreteShell(shell, integrator="bdf2"), duration=0.6, dt=1 / 60, contacts=[ball])
    assert run.unconverged_steps == 0
    gaps = [ball.distance(x, t).min() for x, t in zip(run.positions, run.times, strict=True)]
    assert min(gaps) >= -1e-9
    assert run.positions[-1, mesh.vertices[:, 0].argmax(), 2] > 0.1


@pytest.mark.slow
@pytest.mark.parametrize(("thickness", "friction"), [(1e-3, 0.0), (1e-2, 0.3)])
def test_a_strip_gains_no_energy_where_it_slides_over_a_rounded_edge(thickness, friction):
    mesh, material = strip(thickness, 20)
    box = ms.Contact(ms.Box((0, 0, 0), (0.2, 0.3, 0.15), rounding=0.05), friction=friction)
    model = ms.DiscreteShell(ms.Shell(mesh, material), integrator="implicit")
    given = {"duration": 1.0, "dt": 1 / 60, "gravity": GRAVITY, "start": tilted(mesh, 0.3, 0.2)}
    run = ms.simulate(model, contacts=[box], **given)
    assert run.unconverged_steps == 0
    normals = box.gap(run.positions[run.in_contact])[1]
    assert ((np.abs(normals[:, 0]) > 0.1) & (np.abs(normals[:, 2]) > 0.1)).sum() > 3  # it does slide over an edge
    slid = np.flatnonzero(run.in_contact.any(axis=1))
    work = np.ptp(run.energies[: slid[-1] + 1, 2])
    assert np.diff(run.energies.sum(axis=1))[: slid[-1] + 1].max() <= 1e-10 * work


@pytest.mark.slow
def test_a_plate_bounces_as_often_halved():
    mesh, material = strip(young=1e10)
    contact = ms.Contact(ms.Plane(), restitution=0.5)
    model = ms.DiscreteShell(ms.Shell(mesh, material))
    start = mesh.vertices + np.array([0.0, 0.0, 0.01])
    run = ms.simulate(model, duration=0.13, dt=1e-3, gravity=GRAVITY, start=start, contacts=[contact])
    height = run.positions[..., 2].mean(axis=1)
    hit = int(np.argmax(height < 5e-4))
    peak = height[hit:].max()
    assert peak == pytest.approx(0.01 * 0.25, rel=0.1)  # first order in the step
    assert rise(run) <= 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0])
def test_a_rod_turns_as_the_impulse_says(restitution):
    """Only the vertices that struck were thrown back, and the rod took them along: it turned as without a rebound."""
    mesh, material = strip(young=1e13)
    angle, height, dt = 0.6, 0.02, 1e-3
    shell = ms.Shell(mesh, material)
    given = {"dt": dt, "gravity": GRAVITY, "start": tilted(mesh, angle, height)}
    contact = ms.Contact(ms.Plane(), restitution=restitution)
    run = ms.simulate(ms.DiscreteShell(shell, integrator="bdf2"), duration=0.08, contacts=[contact], **given)
    hit = int(np.argmax(run.in_contact.any(axis=1)))
    along = run.positions[:, mesh.vertices[:, 0].argmax()] - run.positions[:, mesh.vertices[:, 0].argmin()]
    turn = np.arctan2(along[:, 2], along[:, 0])
    after = slice(hit + 1, hit + 13)
    # Gravity turns it further: what the impulse gave is the spin as it began.
    spin = -np.polyfit(run.times[after] - run.times[hit - 1], turn[after], 2)[1]
    share = (1.0 + restitution) / (1.0 + 3.0 * np.cos(angle) ** 2)
    expected = 6.0 * np.cos(angle) * share * np.sqrt(2.0 * 9.81 * height)
    assert spin == pytest.approx(expected, rel=0.03)
    if restitution:  # it leaves the floor: all that this gave is one impulse
        impulse = dt * run.contact_forces[..., 2].sum()
        assert impulse == pytest.approx(shell.mass.sum() * share * np.sqrt(2.0 * 9.81 * height), rel=0.03)
    assert rise(run) <= 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.0, 0.3])
@pytest.mark.parametrize("integrator", ["bdf2", "sdirk2"])
def test_a_rod_that_a_moving_floor_strikes_bounces_as_one_that_strikes(integrator, friction):
    """Weightless, it leaves by the impulse of the relative speed; friction then works against the slip alone."""
    mesh, material = strip(young=1e13)
    angle, dt, times = 0.6, 1e-3, np.linspace(-1.0, 1.0, 81)
    path = ms.SupportPath(times, times[:, None] * [0.0, 0.0, 1.0])
    contact = ms.Contact(ms.Plane(), restitution=1.0, friction=friction, motion=path)
    model = ms.DiscreteShell(ms.Shell(mesh, material), integrator=integrator)
    run = ms.simulate(model, duration=0.04, dt=dt, start=tilted(mesh, angle, 0.02), contacts=[contact])
    centre = np.einsum("fnd,n->fd", run.positions, model.shell.mass) / model.shell.mass.sum()
    gained = (centre[-1] - centre[-11]) / (10.0 * dt)
    if friction:
        impulse = dt * run.contact_forces[..., 2].sum() / model.shell.mass.sum()
        assert gained[2] == pytest.approx(impulse, rel=1e-6)
        assert 0.0 < abs(gained[0]) <= 0.3 * gained[2] * (1.0 + 1e-9)
    else:
        assert gained[2] == pytest.approx(2.0 / (1.0 + 3.0 * np.cos(angle) ** 2), rel=0.03)
        assert abs(gained[0]) <= 1e-6


@pytest.mark.slow
def test_a_resumed_motion_has_the_same_bits():
    mesh, material = strip(1e-3)
    given = {"gravity": GRAVITY, "contacts": [FLOOR], "start": tilted(mesh, 0.2, 0.01)}

    def motion():
        model = ms.DiscreteShell(ms.Shell(mesh, material), integrator="bdf2")
        shell = model.shell
        loading = shell.loading(given["gravity"], None, None)
        return Motion(model, loading, dt=1 / 60, start=given["start"], contacts=given["contacts"])

    whole, first, second = motion(), motion(), motion()
    for _ in range(12):
        whole.advance()
    for _ in range(7):
        first.advance()
    second.restore(first.snapshot())
    for _ in range(5):
        second.advance()
    assert whole.positions()[:, 2].min() <= 1e-9
    assert whole.positions().tobytes() == second.positions().tobytes()


def test_a_start_inside_is_pushed_out_without_gaining_energy():
    mesh, material = strip()
    model = ms.DiscreteShell(ms.Shell(mesh, material), integrator="implicit")
    start = mesh.vertices - np.array([0.0, 0.0, 0.1])
    with pytest.raises(ms.OptionError, match=r"vertex \d+ begins 0\.1 m inside contact 0 \(Plane\)"):
        ms.simulate(model, duration=0.1, dt=1 / 60, start=start, contacts=[FLOOR])
    slow = ms.Contact(ms.Plane(), push_out=1.0)
    run = ms.simulate(model, duration=0.2, dt=1 / 60, start=start, contacts=[slow])
    assert run.unconverged_steps == 0
    assert np.diff(run.positions[..., 2].min(axis=1)).max() <= 1.0 / 60.0 + 1e-9
    assert run.positions[-1, :, 2].min() == pytest.approx(0.0, abs=1e-9)
    assert run.energies[-1, :2].sum() < 1e-9


@pytest.mark.parametrize("integrator", ["verlet", "explicit"])
def test_explicit_springs_are_put_back_onto_a_ball(integrator):
    mesh = ms.sheet(length=1.0, width=1.0, cells=(8, 8))
    sheet = {"young": 1e4, "poisson": 0.3, "thickness": 5e-3, "density": 100.0}
    shell = ms.Shell(mesh, ms.Material.from_physical(mesh=mesh, **sheet))
    middle = mesh.vertices.mean(axis=0)
    ball = ms.Contact(ms.Sphere(middle - [0.0, 0.0, 0.31], 0.3), friction=0.3)
    model = ms.SpringSheet(shell, integrator=integrator)
    run = ms.simulate(model, duration=0.3, dt=model.stable_step() / 2, gravity=GRAVITY, contacts=[ball])
    gaps = np.array([ball.distance(x).min() for x in run.positions])
    assert run.status == "completed"
    assert gaps.min() >= -1e-9
    assert np.median(gaps[len(gaps) // 2 :]) < 1e-3
    assert run.positions[-1, :, 2].min() < -0.1  # its corners hang down
    # Energy of symplectic Euler swings by itself, with the step.
    assert rise(run) < (1e-3 if integrator == "verlet" else 2e-2)


@pytest.mark.by_default("linear_implicit")
@pytest.mark.parametrize("integrator", ["bdf2", "linear_implicit"])
def test_implicit_springs_drape_over_a_ball(integrator):
    mesh = ms.sheet(length=1.0, width=1.0, cells=(8, 8))
    sheet = {"young": 1e4, "poisson": 0.0, "thickness": 5e-3, "density": 100.0}
    shell = ms.Shell(mesh, ms.Material.from_physical(mesh=mesh, **sheet))
    ball = ms.Contact(ms.Sphere(mesh.vertices.mean(axis=0) - [0.0, 0.0, 0.31], 0.3))
    model = ms.SpringSheet(shell, integrator=integrator)
    run = ms.simulate(model, duration=0.3, dt=1 / 120, gravity=GRAVITY, damping=(1.0, 0.0), contacts=[ball])
    assert run.status == "completed"
    assert run.in_contact[-1].any()
    assert min(ball.distance(x).min() for x in run.positions) >= -1e-9
    assert run.positions[-1, :, 2].min() < -0.1
    assert rise(run) <= (1e-9 if integrator == "bdf2" else 1e-3)


def test_motions_that_cannot_be_are_refused_by_name():
    mesh, material = strip()
    shell = ms.Shell(mesh, material)
    model, given = ms.DiscreteShell(shell), {"duration": 0.1, "dt": 1 / 60, "gravity": GRAVITY}
    fast = ms.SupportPath([0.0, 0.1], [(0.0, 0.0, -2.0), (0.0, 0.0, 0.0)])
    ball = ms.Contact(ms.Sphere((0.0, 0.0, -0.3), 0.05), motion=fast)
    with pytest.raises(ms.OptionError, match=r"contact 0 \(Sphere\) moves .* more than its smallest radius of 0\.05 m"):
        ms.simulate(model, contacts=[ball], **given)
    explicit = ms.DiscreteShell(shell, integrator="verlet", allow_unstable_step=True)
    with pytest.raises(ms.OptionError, match="contact 0 has push_out, which Verlet does not take"):
        ms.simulate(explicit, contacts=[ms.Contact(ms.Plane(), push_out=1.0)], **given)
    with pytest.raises(ms.OptionError, match="rigid takes no contacts"):
        ms.simulate(ms.RigidShell(shell), contacts=[FLOOR], **given)
    with pytest.raises(ms.OptionError, match="each of contacts must be a Contact"):
        ms.simulate(model, contacts=[ms.Plane()], **given)
    held = ms.DiscreteShell(ms.Shell(mesh, material, supports=[ms.Fix([0, 1, 2], axes="xyz")]))
    with pytest.raises(ms.OptionError, match="sel must name a vertex that supports do not hold"):
        ms.simulate(held, contacts=[ms.Contact(ms.Plane((0, 0, 1), -9.0), sel=[1, 2])], **given)


@pytest.mark.slow
def test_the_thick_fluid_begins_where_supports_have_moved_to(monkeypatch):
    """Steps that are left to the fluid alone end where Newton's steps do, with what is held in its place."""
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(10, 2))
    shell = ms.Shell(mesh, ms.Isotropic(young=1e8, poisson=0.3, thickness=5e-3, density=100.0), clamped="x < 1e-6")
    path = ms.SupportPath([0.0, 0.5], [(0.0, 0.0, 0.0), (0.0, 0.0, -0.1)])
    given = {"duration": 8 / 60, "dt": 1 / 60, "gravity": GRAVITY, "supports": path}
    floor = [ms.Contact(ms.Plane((0, 0, 1), -0.02))]
    plain = ms.simulate(ms.DiscreteShell(shell, integrator="implicit"), contacts=floor, **given)
    monkeypatch.setattr("modalshell.contact.steps._MOST", 0)
    slow = ms.simulate(ms.DiscreteShell(shell, integrator="implicit"), contacts=floor, **given)
    assert plain.in_contact.any()
    assert slow.unconverged_steps == 0
    np.testing.assert_allclose(slow.positions, plain.positions, atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize(
    "body", [ms.Sphere((0.4, 0.1, -0.2), 0.2), ms.Box((0.4, 0.0, -0.15), (0.2, 0.3, 0.15), rounding=0.05)]
)
def test_momentum_changes_by_the_contact_forces_on_curved_bodies(body):
    """Forces of a discrete gradient, which are not along the normals at a step's end."""
    mesh, material = strip()
    shell = ms.Shell(mesh, material)
    model, dt, mass = ms.DiscreteShell(shell, integrator="implicit"), 1 / 120, shell.mass[:, None]
    motion = Motion(
        model, shell.loading(GRAVITY, None, None), dt=dt, start=tilted(mesh, 0.3, 0.05), contacts=[ms.Contact(body)]
    )
    touched, weight = 0, shell.mass.sum() * np.array(GRAVITY)
    for _ in range(45):
        before = (mass * motion.state.rates).sum(axis=0)
        motion.advance()
        found = motion.touched()
        if found.touches.any():
            touched += 1
            change = (mass * motion.state.rates).sum(axis=0) - before
            pushed = found.forces.sum(axis=0)
            off = np.abs(change / dt - pushed - weight).max()
            assert off <= 2e-6 * np.linalg.norm(pushed)  # steps are solved to 2e-7 of their forces
    assert touched > 5


@pytest.mark.by_default("implicit-0.6-None")
@pytest.mark.parametrize("tolerance", [None, 0.02])
@pytest.mark.parametrize("restitution", [0.0, 0.6])
@pytest.mark.parametrize("integrator", ["bdf2", "implicit"])
def test_contact_forces_are_means_of_a_step_that_change_the_momentum(integrator, restitution, tolerance):
    """Those of the last part of a step of BDF2 were told alone: 1.9 times the impulse of a strike, and no rebound."""
    mesh, material = strip(cells=4)
    shell = ms.Shell(mesh, material)
    given = {"dt": 1 / 120, "contacts": [ms.Contact(ms.Plane(), restitution=restitution)]}
    given |= {"start": np.array(mesh.vertices) + np.array([0.0, 0.0, 0.02])}
    model = ms.DiscreteShell(shell, integrator=integrator)
    if tolerance is not None:
        given["tolerance"] = Tolerance(tolerance, 0.25)
    motion, dt, mass = Motion(model, shell.loading(GRAVITY, None, None), **given), given["dt"], shell.mass
    touched, weight = 0.0, shell.mass.sum() * GRAVITY[2]
    for _ in range(30):
        before = mass @ motion.state.rates[:, 2]
        motion.advance()
        pushed, free = motion.touched().forces[:, 2].sum(), motion.touched().touches.any()
        change = mass @ motion.state.rates[:, 2] - before
        assert change / dt - weight == pytest.approx(pushed, abs=2e-6 * (pushed + abs(weight)))
        touched += free
    assert touched > (1 if restitution else 5)


@pytest.mark.slow
def test_a_tolerance_does_not_seek_the_moment_of_each_strike(monkeypatch):
    """Each strike was halved to 1/4096 of a step: 385 steps in place of 43, for a seventh of the error allowed."""
    mesh, material = strip()
    start, taken, advance = tilted(mesh, 0.3, 0.05), [], ContactMotion.advance
    given = {"duration": 0.3, "gravity": GRAVITY, "start": start, "contacts": [FLOOR], "damping": (0.5, 0.0)}
    model = ms.DiscreteShell(ms.Shell(mesh, material))
    truth = ms.simulate(model, dt=1 / 480, store_every=8, **given)
    monkeypatch.setattr(ContactMotion, "advance", lambda *args: taken.append(1) or advance(*args))
    run = ms.simulate(model, dt=1 / 60, tolerance=0.03, **given)
    assert run.in_contact.any()
    assert len(taken) < 90
    assert 0.003 < run.step_error < 0.03
    off = np.linalg.norm(run.positions - truth.positions, axis=2).max() / mesh.moment_length
    assert off < 0.03


def test_forces_of_linear_implicit_steps_overcome_the_drag_in_them():
    """They were told as if there was none: of a damped sheet at rest 8 % less than its weight."""
    mesh, material = strip(cells=4)
    shell = ms.Shell(mesh, material)
    model = ms.DiscreteShell(shell, integrator="linear_implicit")
    contacts = [ms.Contact(ms.Plane(), friction=0.3)]
    given = {"dt": 1 / 60, "contacts": contacts, "damping": (5.0, 0.0)}
    run = ms.simulate(model, duration=1.0, gravity=GRAVITY, start=mesh.vertices + np.array([0.0, 0.0, 0.02]), **given)
    assert run.in_contact[-1].any()
    assert run.contact_forces[-1].sum(axis=0) == pytest.approx(
        -shell.mass.sum() * np.array(GRAVITY), rel=1e-6, abs=1e-9
    )


@pytest.mark.slow
def test_a_patch_led_by_a_constraint_over_a_floor_moves_as_one_led_by_supports():
    mesh, material = strip(cells=12)
    end, times = mesh.vertices[:, 0] > 0.99, np.linspace(0.0, 0.5, 61)
    ways = 0.2 * np.sin(2.0 * np.pi * times)[:, None] * [0.0, 0.0, 1.0]
    options = {"duration": 0.5, "dt": 1 / 60, "gravity": GRAVITY, "contacts": [ms.Contact(ms.Plane((0, 0, 1), -0.02))]}

    def target(sign):
        center = mesh.vertices[end].mean(axis=0)
        return lambda t: center + np.array([0.0, 0.0, sign * np.interp(t, times, ways[:, 2])])

    def led(sign, **others):
        constraint = ms.PositionConstraint(end, target(sign))
        shell = ms.Shell(mesh, material)
        given = options | others
        return ms.simulate(ms.DiscreteShell(shell, integrator="implicit"), constraints=[constraint], **given)

    def moved(sign, **others):
        held = ms.DiscreteShell(ms.Shell(mesh, material, supports=[ms.Fix(end, "xyz")]), integrator="implicit")
        return ms.simulate(held, supports=ms.SupportPath(times, sign * ways), **options | others)

    up = led(1.0)
    assert up.unconverged_steps == 0
    assert up.in_contact.any()
    assert up.deepest.max() <= 1e-9
    # Supports and patches differ without a floor already; it adds nothing to that.
    apart = np.abs(led(1.0, contacts=[]).positions - moved(1.0, contacts=[]).positions).max()
    assert apart <= 2e-3
    assert np.abs(up.positions - moved(1.0).positions).max() <= 1.5 * apart
    assert "contact 0" not in up.message
    # Held vertices have no gap of their own: a patch that is led into the floor is told of.
    assert "constraints lead vertices into contact 0" in led(-1.0).message
    assert "supports lead vertices into contact 0" in moved(-1.0).message


@pytest.mark.slow
def test_a_thin_shelf_is_not_passed_in_a_step():
    """A step whose minimum lies on its other side is taken again from where it began."""
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(20, 4))
    sheet = ms.Isotropic(young=1e6, poisson=0.3, thickness=5e-3, density=1000.0)
    half = 1e-3
    shelf = ms.Contact(ms.Box((0.6, 0.0, -0.199 - half), (0.3, 0.15, half)))
    model = ms.DiscreteShell(ms.Shell(mesh, sheet, clamped="x < 1e-3"))
    run = ms.simulate(
        model, duration=0.22, dt=1 / 480, gravity=(0.0, 0.0, -9.81), damping=(0.5, 0.001), contacts=[shelf]
    )
    assert run.status == "completed"
    x, z = run.positions[..., 0], run.positions[..., 2]
    over = (x > 0.31) & (x < 0.89)
    assert not (over[:-1] & over[1:] & (z[:-1] > -0.2) & (z[1:] < -0.2)).any()
    assert run.in_contact.any()


@pytest.mark.slow
def test_energy_that_steps_on_contacts_add_is_told():
    """Linearised implicit Euler on a ball ended as completed, at a hundred times the energy of the weight."""
    mesh = ms.sheet(length=0.5, width=0.5, cells=(6, 6))
    shell = ms.Shell(mesh, ms.Isotropic(young=1e6, poisson=0.3, thickness=1e-3, density=300.0))
    ball = ms.Contact(ms.Sphere(mesh.vertices.mean(axis=0) + np.array([0.1, 0.0, -0.2]), 0.15))
    given = {"duration": 0.4, "dt": 1 / 60, "gravity": GRAVITY, "contacts": [ball]}
    run = ms.simulate(ms.DiscreteShell(shell), integrator="linear_implicit", **given)
    assert np.ptp(run.energies[:, 1]) > 1.5 * np.ptp(run.energies[:, 2])
    assert run.outcome is ms.Outcome.RUNS_AWAY
    assert "steps on contacts have added" in run.message
    still = ms.simulate(ms.DiscreteShell(shell), integrator="implicit", **given)
    assert still.outcome is ms.Outcome.COMPLETED
    assert "have added" not in still.message


@pytest.mark.slow
def test_energy_that_steps_on_a_moving_collider_add_is_told_and_its_own_work_is_not():
    """A lifted ball threw the sheet aside in such steps, which ended as completed."""
    mesh = ms.sheet(length=0.3, width=0.2, cells=(6, 4))
    material = ms.Isotropic(young=1e7, poisson=0.3, thickness=2e-3, density=400.0)
    shell = ms.Shell(mesh, material, clamped=mesh.vertices[:, 0] < 1e-6)
    lift = ms.SupportPath([0.0, 1.0], [(0, 0, 0), (0, 0, 0.06)])
    ball = ms.Contact(ms.Sphere((0.25, 0.0, -0.06), 0.05), motion=lift)
    given = {"duration": 0.6, "dt": 1 / 60, "gravity": GRAVITY, "contacts": [ball], "damping": (3.0, 0.0)}
    run = ms.simulate(ms.DiscreteShell(shell), integrator="linear_implicit", **given)
    still = ms.simulate(ms.DiscreteShell(shell), integrator="implicit", **given)
    assert "steps on contacts have added" in run.message
    assert still.outcome is ms.Outcome.COMPLETED
    assert "have added" not in still.message
    whole = still.energies.sum(axis=1)
    assert whole.max() - whole[0] > 0.1 * np.ptp(still.energies[:, 2])  # the ball's work


@pytest.fixture(scope="module")
def held_sheet():
    mesh = ms.sheet(length=0.3, width=0.2, cells=(4, 2))
    material = ms.Isotropic(young=1e7, poisson=0.3, thickness=2e-3, density=400.0)
    return ms.Shell(mesh, material, clamped=mesh.vertices[:, 0] < 1e-6)


@pytest.mark.by_default("linear_implicit")
@pytest.mark.parametrize("kind", ["modal", "linear_implicit"])
def test_colliders_that_leave_no_room_are_told(held_sheet, kind):
    """The advice was a finer mesh, at 1e8 times the energy of the weight."""
    press = ms.SupportPath([0.0, 0.5], [(0, 0, 0), (0, 0, -0.1)])
    contacts = [ms.Contact(ms.Plane((0, 0, 1), -0.02)), ms.Contact(ms.Plane((0, 0, -1), -0.05), motion=press)]
    model = ms.ModalWarping(ms.solve_modes(held_sheet, count=6))
    given = {"duration": 0.5, "dt": 1 / 60, "gravity": GRAVITY, "contacts": contacts}
    if kind != "modal":
        model, given["integrator"] = ms.DiscreteShell(held_sheet), kind
    run = ms.simulate(model, **given)
    assert run.outcome is Outcome.CONSTRAINTS_MISSED
    assert "contacts 0 and 1 leave vertex" in run.message
    assert "no room at 0.333333 s" in run.message  # the first frame with the planes past each other
    assert "finer mesh" not in run.message


@pytest.mark.slow
def test_edges_that_dip_into_a_collider_at_the_end_are_told(held_sheet):
    """They were by statics alone; and a coarse shell that a punch had passed through was told to take shorter steps."""
    roller = [ms.Contact(ms.Cylinder((0.26, -1.0, -0.06), (0.26, 1.0, -0.06), 0.05))]
    given = {"duration": 1.0, "dt": 1 / 60, "gravity": GRAVITY, "damping": (20.0, 0.0)}
    run = ms.simulate(ms.DiscreteShell(held_sheet), contacts=roller, **given)
    assert run.in_contact[-1].any()
    ends = held_sheet.mesh.edges
    depth = -roller[0].distance(run.positions[-1][ends].mean(axis=1)).min()
    assert f"at the end edges dip up to {depth:.2g} m into a collider" in run.message
    assert "dip" not in ms.simulate(ms.DiscreteShell(held_sheet), contacts=[FLOOR], **given).message


def test_a_valley_has_room(held_sheet):
    sides = [ms.Contact(ms.Plane((side, 0, 1.0), 0.0)) for side in (-1, 1)]
    x = held_sheet.rest_positions - np.array([0.0, 0.0, 0.05])
    deep = TouchedFrame(np.zeros_like(x), np.zeros(len(x), bool), 0.05)
    account, asked = ColliderAccount(sides, held_sheet.mesh, add=False), []
    account.see(lambda: asked.append("positions") or x, 0.0, deep, beyond=False)
    assert asked == ["positions"]
    assert account.crowded == ""
    account = ColliderAccount([*sides, ms.Contact(ms.Plane((0, 0, -1), 0.02))], held_sheet.mesh, add=False)
    account.see(lambda: x, 0.0, deep, beyond=False)
    assert "leave vertex" in account.crowded  # a lid below its bottom


def test_a_shell_that_a_collider_tears_from_its_clamp_ends_the_motion(held_sheet):
    """It went on to 1e57 m."""
    push = ms.SupportPath([0.0, 1.0], [(0, 0, 0), (0, 0, 0.3)])
    floor = ms.Contact(ms.Plane((0, 0, 1), -0.05), motion=push)
    for kind in (ms.ModalWarping, ms.RotationStrain):
        model = kind(ms.solve_modes(held_sheet, count=8))
        run = ms.simulate(model, duration=1.0, dt=1 / 60, gravity=GRAVITY, contacts=[floor])
        assert run.outcome is Outcome.DIVERGED
        assert "colliders push it where its supports do not let it go" in run.message
        assert len(run.times) < 60
        assert np.abs(run.positions).max() < 1e8
