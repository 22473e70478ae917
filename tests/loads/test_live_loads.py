"""Loads that follow the shell: their derivatives, energies, closed forms, and every rung under them."""

import numpy as np
import pytest
from junctions import frame, moebius
from scenes import PLAIN, held, leaf, strip

import modalshell as ms
from modalshell.models.base.model import NO_POTENTIAL
from modalshell.statics.live_loads import LiveLoads

LOADS = {
    "moment": ms.EdgeMoment("y > -9", 0.3),
    "pressure": ms.Pressure(5.0),
    "wind": ms.Wind((1.0, 2.0, 3.0), tangential=0.5),
    "gust": ms.Wind(lambda points, _: np.broadcast_to([1.0, 2.0, 3.0], points.shape), tangential=0.5),
    "follower force": ms.FollowerForce("x > 0.05", (1.0, 2.0, 3.0)),
    "turning frame": ms.FrameInertia((1, 2, 3), (4, 5, 6), origin=(0.1, 0.0, 0.0)),
    "speeding frame": ms.FrameInertia((1, 2, 3), (4, 5, 6), (1, 1, 0)),
    "weight": ms.SelfWeight((1.0, 2.0, -9.0)),
    "point force": ms.PointForce("x > 0.05", (1.0, 2.0, 3.0)),
    "line force": ms.LineForce("x > 0.05", (1.0, 2.0, 3.0)),
}


@pytest.fixture(scope="module")
def curled():
    return leaf(clamped=[0, 1])


def scattered(shell, size=0.002, seed=0):
    """Positions and velocities about rest, and a direction that leaves the boundary alone."""
    rng = np.random.default_rng(seed)
    shape = shell.rest_positions.shape
    direction = 0.002 * rng.standard_normal(shape)
    direction[shell.mesh.boundary_vertices] = 0.0
    return shell.rest_positions + size * rng.standard_normal(shape), rng.standard_normal(shape), direction


def slopes(errors):
    return np.log2(np.array(errors[:-1]) / np.array(errors[1:]))


@pytest.mark.parametrize("rate", [0.0, 100.0])
@pytest.mark.parametrize("name", LOADS)
def test_the_stiffness_is_the_derivative_of_the_forces(curled, name, rate):
    loading = curled.loading(loads=[LOADS[name]])
    x, velocity, _ = scattered(curled)
    step = 0.001 * np.random.default_rng(1).standard_normal(x.shape)
    live = LiveLoads(loading, before=x - velocity / rate, rate=rate) if rate else LiveLoads(loading)
    data = np.zeros(curled.pattern.size)
    live.add_stiffness(curled.pattern, x, data)
    slope = (curled.pattern.matrix(data) @ step.ravel()).reshape(-1, 3)
    errors = [np.linalg.norm(live.force(x + h * step) - live.force(x) + h * slope) for h in (1.0, 0.5, 0.25, 0.125)]
    if max(errors) > 1e-9 * np.linalg.norm(live.force(x)):  # forces that are linear are met at once
        np.testing.assert_allclose(slopes(errors)[-1], 2.0, atol=0.1)


@pytest.mark.parametrize("name", ["pressure", "turning frame", "weight", "point force", "line force"])
def test_energies_have_taylor_slopes_two_and_three(curled, name):
    loading = curled.loading(loads=[LOADS[name]])
    x, _, step = scattered(curled)
    data = np.zeros(curled.pattern.size)
    LiveLoads(loading).add_stiffness(curled.pattern, x, data)
    slope, curve = np.vdot(loading.force(x), step), step.ravel() @ (curled.pattern.matrix(data) @ step.ravel())
    sizes = np.array([1.0, 0.5, 0.25])

    def energy(at):
        return loading.live_energy(at) - np.vdot(loading.dead, at - loading.rest)

    changes = np.array([energy(x + h * step) - energy(x) for h in sizes])
    first, second = np.abs(changes + sizes * slope), np.abs(changes + sizes * slope - 0.5 * sizes**2 * curve)
    rounding = 1e-12 * abs(energy(x))
    assert first.max() < rounding or np.allclose(slopes(first), 2.0, atol=0.15)
    assert second.max() < rounding or np.allclose(slopes(second), 3.0, atol=0.15)


@pytest.mark.parametrize("place", [0.0, 1e4])
def test_follower_pressure_on_a_closed_surface_does_the_work_of_the_volume(place):
    """Far from the origin, too: 1e4 lengths away the volume was the rounding of cubes of the distance."""
    octahedron = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)], float) + place
    faces = [(a, b, 4) for a, b in ((0, 2), (2, 1), (1, 3), (3, 0))] + [
        (b, a, 5) for a, b in ((0, 2), (2, 1), (1, 3), (3, 0))
    ]
    shell = held(ms.TriangleMesh(octahedron, faces))
    loading = shell.loading(loads=[ms.Pressure(7.0)])
    assert loading.conservative

    def volume(x):
        one, two, three = (x - place)[shell.mesh.faces].transpose(1, 0, 2)
        return np.sum(one * np.cross(two, three)) / 6.0

    rng = np.random.default_rng(0)
    x = octahedron
    assert volume(x) == pytest.approx(4.0 / 3.0)
    for _ in range(5):  # forces are quadratic in positions: Simpson's rule integrates their work
        after = x + 0.3 * rng.standard_normal(x.shape)
        forces = [loading.force(x + s * (after - x)) for s in (0.0, 0.5, 1.0)]
        work = np.vdot(forces[0] + 4.0 * forces[1] + forces[2], after - x) / 6.0
        assert work == pytest.approx(7.0 * (volume(after) - volume(x)), rel=1e-10)
        assert loading.energy(x) - loading.energy(after) == pytest.approx(work, rel=1e-10)
        np.testing.assert_allclose(forces[2].sum(axis=0), 0.0, atol=1e-12)
        np.testing.assert_allclose(np.cross(after - place, forces[2]).sum(axis=0), 0.0, atol=1e-10)
        x = after


@pytest.mark.parametrize("incidence", [0.0, 30.0, 90.0])
def test_a_flat_plate_in_the_wind_has_its_drag_and_lift(incidence):
    plate, speed, angle = ms.flat_beam(length=1.0, width=0.2, cells=(4, 2)), 3.0, np.radians(incidence)
    wind = ms.Wind((speed * np.cos(angle), 0.0, speed * np.sin(angle)), density=1.3, normal=1.2, tangential=0.05)
    pressure = 0.5 * 1.3 * speed**2 * plate.area
    across, along = 1.2 * pressure * np.sin(angle) ** 2, 0.05 * pressure * np.cos(angle) ** 2
    np.testing.assert_allclose(wind.force(plate).sum(axis=0), [along, 0.0, across], atol=1e-12 * pressure)
    # A plate that moves with the wind feels none; one that moves faster is held back.
    loading = held(plate).loading(loads=[wind])
    air = np.broadcast_to(wind.velocity, plate.vertices.shape)
    assert np.abs(loading.force(plate.vertices, air)).max() < 1e-15
    np.testing.assert_allclose(loading.force(plate.vertices, 2.0 * air).sum(axis=0), [-along, 0.0, -across], atol=1e-12)


def test_dead_pressure_stays_and_follower_pressure_turns():
    shell = strip()
    turn = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    x = shell.rest_positions @ turn.T
    dead, live = (shell.loading(loads=[ms.Pressure(2.0, follower=follows)]) for follows in (False, True))
    assert not dead.live
    np.testing.assert_allclose(dead.force(x).sum(axis=0), [0.0, 0.0, 2.0 * shell.mesh.area], atol=1e-12)
    np.testing.assert_allclose(live.force(x), dead.force(x) @ turn.T, atol=1e-15)
    half = shell.loading(loads=[ms.Pressure(2.0, sel="x < 0.51")])
    np.testing.assert_allclose(half.force(shell.rest_positions).sum(axis=0)[2], shell.mesh.area, rtol=1e-12)


# ---- closed forms, on sheets of shell theory

YOUNG, THICKNESS, DENSITY = 1e7, 0.01, 1000.0
END, RIGIDITY = "x > 0.999", YOUNG * THICKNESS**3 / 12.0  # of a strip, per width


@pytest.fixture(scope="module")
def mesh():
    return ms.flat_beam(length=1.0, width=0.2, cells=(20, 4))


@pytest.fixture(scope="module")
def cantilever(mesh):
    return ms.Shell(mesh, ms.Isotropic(YOUNG, 0.0, THICKNESS, DENSITY), mesh.vertices[:, 0] < 1e-6)


def at_end(shell):
    return shell.rest_positions[:, 0] > 0.999


@pytest.mark.parametrize(
    ("load", "drop"),
    [
        (ms.LineForce(END, (0.0, 0.0, -1e-3)), 1e-3 / (3.0 * RIGIDITY)),
        (ms.EdgeMoment(END, -1e-3), 1e-3 / (2.0 * RIGIDITY)),
        (ms.SelfWeight((0.0, 0.0, -1e-4)), 1e-4 * DENSITY * THICKNESS / (8.0 * RIGIDITY)),
        (ms.Pressure(-1e-3), 1e-3 / (8.0 * RIGIDITY)),
        (ms.FollowerForce("x < 9", (0.0, 0.0, -1e-6)), None),
    ],
)
def test_cantilevers_drop_as_euler_and_bernoulli_say(cantilever, load, drop):
    state = ms.DiscreteShell(cantilever).equilibrium(loads=[load])
    assert state.converged
    tip = -(state.positions - cantilever.rest_positions)[at_end(cantilever), 2].mean()
    if drop is not None:
        assert tip == pytest.approx(drop, rel=0.01)
    reactions = cantilever.reactions(state.positions, loads=[load])
    force = cantilever.loading(loads=[load]).force(state.positions)
    scale = np.abs(reactions).sum()
    assert np.abs(reactions.sum(axis=0) + force.sum(axis=0)).max() <= 1e-8 * scale


@pytest.mark.by_default("clamped-line-0.0026041666666666665", "pinned-weight-0.013020833333333334")
@pytest.mark.parametrize(
    ("ends", "load", "share"),
    [
        ("pinned", "line", 5.0 / 384.0),
        ("clamped", "line", 1.0 / 384.0),
        ("pinned", "weight", 5.0 / 384.0),
        ("clamped", "weight", 1.0 / 384.0),
        ("pinned", "moments", 1.0 / 8.0),
    ],
)
def test_strips_between_two_ends_sag_as_euler_and_bernoulli_say(ends, load, share):
    """Line forces along both edges, the weight, and moments at both ends, in ``q L^4 / D`` and ``m L^2 / D``."""
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(40, 8))  # clamped ones are 3.1 % off at 20 cells
    first, last = mesh.vertices[:, 0] < 1e-6, mesh.vertices[:, 0] > 1.0 - 1e-6
    kinds = [ms.Clamp(first), ms.Clamp(last)] if ends == "clamped" else [ms.Pin(first), ms.Fix(last, axes="yz")]
    shell = ms.Shell(mesh, ms.Isotropic(YOUNG, 0.0, THICKNESS, DENSITY), supports=kinds)
    edges = np.abs(mesh.vertices[:, 1])
    rims = [mesh.vertices[:, 1] > edges.max() - 1e-9, mesh.vertices[:, 1] < 1e-9 - edges.max()]
    small = 1e-4
    loads = {
        "line": [ms.LineForce(rim, (0.0, 0.0, -0.5 * 0.2 * small)) for rim in rims],
        "weight": [ms.SelfWeight((0.0, 0.0, -small / (DENSITY * THICKNESS)))],
        "moments": [ms.EdgeMoment(end, small) for end in (first, last)],
    }[load]
    state = ms.DiscreteShell(shell).equilibrium(loads=loads)
    middle = np.abs(mesh.vertices[:, 0] - 0.5) < 1e-9
    assert state.converged
    assert -(state.positions - mesh.vertices)[middle, 2].mean() == pytest.approx(share * small / RIGIDITY, rel=0.01)


@pytest.mark.by_default("tip-0.05-0.01", "moment-0.05-0.01", "weight-0.2-0.025")
@pytest.mark.parametrize(("width", "bound"), [(0.05, 0.01), (0.2, 0.025)])
@pytest.mark.parametrize("load", ["tip", "moment", "weight"])
def test_cantilevers_of_calibrated_hinges_drop_so_too(load, width, bound):
    """Narrow strips within 1 %. A wide one is calibrated half-way to what it is at large deflection, 1.1 % here, and by
    its drop under its weight: the clamp, which holds it from curving across, counts for less under an end moment."""
    mesh = ms.flat_beam(length=1.0, width=width, cells=(40, round(40 * width)))
    x = mesh.vertices[:, 0]
    material = ms.Material.from_physical(young=YOUNG, poisson=0.0, thickness=THICKNESS, density=DENSITY, mesh=mesh)
    shell = ms.Shell(mesh, material, x < 0.026)
    end, free = x > 0.999, 0.975
    weight = 1e-5 * DENSITY * THICKNESS
    push, drop = {
        "tip": (ms.LineForce(end, (0.0, 0.0, -1e-4)), 1e-4 * free**3 / (3.0 * RIGIDITY)),
        "moment": (ms.EdgeMoment(end, -1e-4), 1e-4 * free**2 / (2.0 * RIGIDITY)),
        "weight": (ms.SelfWeight((0.0, 0.0, -1e-5)), weight * free**4 / (8.0 * RIGIDITY)),
    }[load]
    state = ms.DiscreteShell(shell).equilibrium(loads=[push])
    assert state.converged
    assert -(state.positions - mesh.vertices)[end, 2].mean() == pytest.approx(drop, rel=bound)


@pytest.mark.parametrize("share", [0.25, 0.5])
def test_an_end_moment_rolls_a_strip_into_an_arc(cantilever, share):
    load = ms.EdgeMoment(END, 2.0 * np.pi * share * RIGIDITY)
    state = ms.DiscreteShell(cantilever).equilibrium(loads=[load])
    angle = 2.0 * np.pi * share
    assert state.converged
    assert state.stable
    assert not state.conservative
    assert state.message == NO_POTENTIAL
    tip = state.positions[at_end(cantilever)].mean(axis=0)
    np.testing.assert_allclose(tip[[0, 2]], [np.sin(angle) / angle, (1.0 - np.cos(angle)) / angle], atol=0.01)


def test_newton_converges_fast_under_follower_loads(cantilever):
    """With half of the stiffness, or without it, the residual falls by a factor a step instead of its square."""
    load = ms.EdgeMoment(END, 0.5 * np.pi * RIGIDITY)
    model = ms.DiscreteShell(cantilever)
    near = model.equilibrium(loads=[load]).positions
    again = model.equilibrium(loads=[ms.EdgeMoment(END, 0.52 * np.pi * RIGIDITY)], start=near)
    assert again.converged
    assert again.iterations <= 6
    assert again.residual < 1e-8


@pytest.mark.parametrize(
    ("load", "stable"), [(19.0, True), pytest.param(21.0, False, marks=pytest.mark.slow)], ids=["below", "above"]
)
def test_becks_column_flutters_at_twenty_and_never_buckles(load, stable):
    """A follower force along the axis: stable up to 20.05 EI / L^2, eight times Euler's load [beck1952]."""
    mesh = ms.flat_beam(length=1.0, width=0.1, cells=(20, 2))
    shell = ms.Shell(mesh, ms.Isotropic(YOUNG, 0.0, THICKNESS, DENSITY), mesh.vertices[:, 0] < 1e-6)
    end = np.flatnonzero(mesh.vertices[:, 0] > 0.999)
    push = ms.FollowerForce(end, (-load * 0.1 * RIGIDITY / len(end), 0.0, 0.0))
    state = ms.DiscreteShell(shell).equilibrium(loads=[push])
    assert state.stable is stable
    if stable:
        assert state.converged
        assert np.abs(state.positions[:, 2]).max() < 1e-12
    else:
        assert "flutter" in state.message  # no saddle: what damps may hold it


def disc(rings):
    """A disc of radius 1 m, its vertices on rings."""
    points, faces = [(0.0, 0.0, 0.0)], []
    for ring in range(1, rings + 1):
        angles = 2.0 * np.pi * np.arange(6 * ring) / (6 * ring)
        points += [(ring / rings * np.cos(angle), ring / rings * np.sin(angle), 0.0) for angle in angles]
        first, inner, count, fewer = (
            len(points) - 6 * ring,
            len(points) - 6 * ring - max(6 * (ring - 1), 1),
            6 * ring,
            6 * (ring - 1),
        )
        for sector in range(6):
            for k in range(ring):
                outer = [first + (sector * ring + k + j) % count for j in (0, 1)]
                under = [inner + ((sector * (ring - 1) + k + j) % fewer if fewer else 0) for j in (0, 1)]
                faces.append((*outer, under[0]))
                if k < ring - 1:
                    faces.append((outer[1], under[1], under[0]))
    return ms.TriangleMesh(points, faces)


def test_a_clamped_disc_bulges_as_hencky_says():
    mesh = disc(8)
    shell = ms.Shell(mesh, ms.Isotropic(1e7, 0.3, 1e-3, 1000.0), np.linalg.norm(mesh.vertices, axis=1) > 0.999)
    load = ms.Pressure(1.0)
    state = ms.DiscreteShell(shell).equilibrium(loads=[load])
    assert state.converged
    assert state.conservative
    assert state.positions[0, 2] == pytest.approx(0.653 * (1.0 / (1e7 * 1e-3)) ** (1.0 / 3.0), rel=0.02)
    total = shell.reactions(state.positions, loads=[load]).sum(axis=0)
    # What a follower pressure pushes along the axis is its pressure on the boundary's disc.
    area = 0.5 * 48 * np.sin(2.0 * np.pi / 48)
    np.testing.assert_allclose(total, [0.0, 0.0, -area], atol=1e-8 * area)


@pytest.mark.slow
def test_a_chain_hangs_as_a_catenary():
    mesh = ms.flat_beam(length=1.0, width=0.05, cells=(40, 2))
    x = mesh.vertices[:, 0]
    shell = ms.Shell(mesh, ms.Isotropic(1e8, 0.0, 1e-4, 1000.0), (x < 1e-6) | (x > 1.0 - 1e-6))
    span = 0.8
    right = np.flatnonzero(x > 1.0 - 1e-6)
    targets = [ms.PositionConstraint(vertex, mesh.vertices[vertex] - [1.0 - span, 0.0, 0.0]) for vertex in right]
    free = ms.Shell(mesh, ms.Isotropic(1e8, 0.0, 1e-4, 1000.0), x < 1e-6)
    state = ms.DiscreteShell(free).equilibrium(loads=[ms.SelfWeight()], constraints=targets)
    assert state.converged
    assert shell.clamped.sum() == 2 * len(right)
    # Length 1 over span 0.8: 2 c sinh(span / 2 c) = 1.
    from scipy.optimize import brentq

    c = brentq(lambda c: 2.0 * c * np.sinh(0.5 * span / c) - 1.0, 0.1, 10.0)
    assert -state.positions[:, 2].min() == pytest.approx(c * (np.cosh(0.5 * span / c) - 1.0), rel=0.01)


# ---- every rung

RUNGS = {
    "LMA": lambda shell: ms.LinearModal(ms.solve_modes(shell, 8)),
    "MWTS": lambda shell: ms.ModalWarping(ms.solve_modes(shell, 8)),
    "consistent MWTS": lambda shell: ms.ModalWarping(ms.solve_modes(shell, 8), consistent_force=True),
    "RSW": lambda shell: ms.RotationStrain(ms.solve_modes(shell, 8)),
    "MD-ROM": lambda shell: ms.ModalDerivatives(shell, 4),
    "coarse DS": lambda shell: ms.CoarseDiscreteShell(shell, shell),
}
MILD = {
    "moment": ms.EdgeMoment(END, 0.02),
    "pressure": ms.Pressure(0.05),
    "wind": ms.Wind((0.1, 0.0, 0.4)),
    "follower force": ms.FollowerForce(END, (0.0, 0.0, 2e-3)),
    "frame": ms.FrameInertia((0.0, 0.0, 0.002), (0.0, 0.1, 0.0)),
}


@pytest.mark.by_default("LMA-frame", "MWTS-pressure", "consistent MWTS-moment", "RSW-follower force", "MD-ROM-wind")
@pytest.mark.parametrize("load", MILD)
@pytest.mark.parametrize("rung", RUNGS)
def test_rungs_answer_mild_loads_as_discrete_shells_do(cantilever, rung, load):
    loads = [MILD[load]]
    truth, found = (model.equilibrium(loads=loads) for model in (ms.DiscreteShell(cantilever), RUNGS[rung](cantilever)))
    assert truth.converged
    assert found.converged
    assert found.conservative == truth.conservative
    error = ms.measure.displacement_error(found.positions, truth.positions, cantilever)
    assert error < (0.12 if rung in ("LMA", "MD-ROM") else 0.05)


@pytest.mark.by_default("LMA")
@pytest.mark.parametrize("rung", [*RUNGS, pytest.param("DS", marks=pytest.mark.slow)])
def test_light_sheets_come_to_rest_in_the_wind(rung):
    coarse = ms.flat_beam(length=1.0, width=0.2, cells=(8, 2))
    light = ms.Shell(coarse, ms.Isotropic(YOUNG, 0.0, THICKNESS, 10.0), coarse.vertices[:, 0] < 1e-6)
    model = ms.DiscreteShell(light) if rung == "DS" else RUNGS[rung](light)
    wind = ms.Wind((0.0, 0.0, 0.5), density=20.0)  # dense enough to stop the sheet within a step
    run = ms.simulate(model, duration=3.0, dt=0.05, loads=[wind], damping=(5.0, 0.01))
    still = model.equilibrium(loads=[wind])
    assert run.outcome is ms.Outcome.COMPLETED
    assert run.message.startswith(NO_POTENTIAL)  # and that fast modes move, which frames of 0.05 s do not show
    moved = ms.measure.displacement_error(run.positions[-1], still.positions, light)
    assert moved < 0.02


def test_free_rigid_plates_drift_with_the_wind():
    plate = held(ms.flat_beam(length=1.0, width=0.2, cells=(4, 2)), material=PLAIN)
    run = ms.simulate(ms.RigidShell(plate), duration=8.0, dt=0.1, loads=[ms.Wind((0.0, 0.0, 2.0), density=5.0)])
    speed = (run.positions[-1] - run.positions[-2]).mean(axis=0) / 0.1
    np.testing.assert_allclose(speed, [0.0, 0.0, 2.0], atol=0.05)


@pytest.mark.slow
def test_spring_sheets_take_loads_that_follow():
    sheet = ms.SpringSheet(held(ms.v_beam(cells=(8, 4)), 0.2))
    state = sheet.equilibrium(loads=[ms.Pressure(0.01)])
    assert state.converged
    assert not state.conservative


# ---- time


def test_loads_scale_with_a_table_or_a_function_of_time(cantilever):
    force = ms.PointForce(END, (0.0, 0.0, 1e-5))
    ramp = ms.Scaled(force, ([1.0, 2.0], [0.0, 3.0]))
    assert [ramp.factor(time) for time in (0.0, 1.5, 9.0)] == [0.0, 1.5, 3.0]
    model = ms.LinearModal(ms.solve_modes(cantilever, 8))
    by_table = ms.simulate(model, duration=0.2, loads=[ms.Scaled(force, ([0.0, 1.0], [0.0, 1.0]))])
    by_function = ms.simulate(model, duration=0.2, loads=[ms.Scaled(force, lambda time: time)])
    np.testing.assert_allclose(by_table.positions, by_function.positions, atol=1e-15)
    constant = ms.simulate(model, duration=0.2, loads=[ms.Scaled(force, lambda _: 1.0)])
    plain = ms.simulate(model, duration=0.2, loads=[force])
    np.testing.assert_allclose(constant.positions, plain.positions, atol=1e-12)
    np.testing.assert_allclose(constant.energies, plain.energies, atol=1e-12 * np.abs(plain.energies).max())


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda _: ms.Pressure(np.nan), ms.LoadError, "p must be a finite number"),
        (lambda _: ms.EdgeMoment("x > 0", np.inf), ms.LoadError, "m must be a finite number"),
        (lambda _: ms.Wind((1.0, 2.0)), ms.LoadError, r"velocity must have shape \(3,\)"),
        (lambda _: ms.Wind((1, 2, 3), density=-1.0), ms.LoadError, "density must be a finite number at least 0"),
        (lambda mesh: ms.Wind(lambda *_: [1.0]).force(mesh), None, ""),
        (lambda mesh: ms.Wind(lambda points, _: np.full(points.shape, np.nan)).force(mesh), ms.LoadError, "the wind's"),
        (lambda mesh: ms.EdgeMoment([0], 1.0).force(mesh), ms.OptionError, "no edge between two of them"),
        (lambda mesh: ms.Pressure(1.0, sel=[0]).force(mesh), ms.OptionError, "no triangle between three of them"),
        (lambda mesh: ms.SelfWeight().force(mesh), ms.LoadError, "SelfWeight needs the masses of a shell"),
        (lambda _: ms.Scaled(ms.SelfWeight(), 3.0), ms.LoadError, "factor must be a function of time or a pair"),
        (lambda _: ms.Scaled(ms.SelfWeight(), ([1.0, 1.0], [0.0, 1.0])), ms.OptionError, "times"),
        (lambda _: ms.Scaled(3.0, abs), ms.OptionError, "load must be a Load"),
        (lambda _: ms.Scaled(ms.SelfWeight(), lambda _: np.nan).factor(0.0), ms.LoadError, "the factor at 0 s"),
    ],
)
def test_bad_loads_are_refused(mesh, make, error, message):
    if error is None:
        assert np.isfinite(make(mesh)).all()
        return
    with pytest.raises(error, match=message):
        make(mesh)


@pytest.mark.slow
@pytest.mark.parametrize("family", ["union-jack", "equilateral", "delaunay"])
def test_moments_on_all_edges_of_a_plate_are_met_to_first_order(family):
    """A free plate bends alike both ways, by m / (D (1 + nu)); the moment works half a cell within."""
    errors = []
    for cells in (12, 24):
        along = round(cells * 2.0 / np.sqrt(3.0)) if family == "equilateral" else cells
        mesh = ms.sheet(length=1.0, width=1.0, cells=(along, cells), family=family)
        x, y = mesh.vertices[:, 0] - 0.5, mesh.vertices[:, 1]
        nearest = [int(np.hypot(x - a, y - b).argmin()) for a, b in ((-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5))]
        supports = [ms.Pin([nearest[0]]), ms.Fix([nearest[1]], axes="yz"), ms.Fix([nearest[2]], axes="z")]
        shell = ms.Shell(mesh, ms.Isotropic(1e9, 0.3, 1e-2, 1.0), supports=supports)
        moment = 1e-6 * 1e9 * 1e-6 / (12.0 * (1.0 - 0.3**2))
        state = ms.DiscreteShell(shell).equilibrium(loads=[ms.EdgeMoment(mesh.boundary_vertices, moment)])
        assert state.converged
        terms = np.column_stack([np.ones(len(x)), x, y, 0.5 * x**2, 0.5 * y**2, x * y])
        fitted = np.linalg.lstsq(terms, state.positions[:, 2] / 1e-6, rcond=None)[0]
        errors.append(np.abs(np.abs(fitted[3:5]) * 1.3 - 1.0).max())
    assert errors[1] < 0.033
    assert errors[1] < 0.75 * errors[0]


@pytest.mark.by_default("load1-ModalWarping")
@pytest.mark.parametrize("kind", [ms.LinearModal, ms.ModalWarping, ms.RotationStrain])
@pytest.mark.parametrize("load", [ms.Wind((2.0, 0.7, 1.5)), ms.Pressure(3.0)])
def test_the_numbers_of_vertices_and_triangles_do_not_matter(kind, load):
    mesh = ms.sheet(length=1.0, width=1.0, cells=(10, 10))  # whose axes follow the numbers
    rng = np.random.default_rng(4)
    new = rng.permutation(len(mesh.vertices))  # old number of each new vertex
    faces = np.argsort(new)[mesh.faces][rng.permutation(len(mesh.faces))]
    runs = []
    for own in (mesh, ms.TriangleMesh(mesh.vertices[new], faces)):
        shell = ms.Shell(own, ms.Isotropic(1e7, 0.3, 2e-3, 300.0), clamped=own.vertices[:, 0] < 1e-6)
        model = kind(ms.solve_modes(shell, 6))
        runs.append(ms.simulate(model, duration=0.3, dt=1 / 60, loads=[load], damping=(2.0, 0.0)).positions)
    moved = np.abs(runs[0] - runs[0][0]).max()
    assert moved > 0.02
    np.testing.assert_allclose(runs[0][:, new], runs[1], atol=1e-9 * moved)


def test_a_table_of_factors_is_read_as_numpy_reads_it():
    rng = np.random.default_rng(5)
    for count in (2, 7):
        times, factors = np.sort(rng.uniform(-1.0, 1.0, count)), rng.standard_normal(count)
        load = ms.Scaled(ms.SelfWeight(), (times, factors))
        for time in [*rng.uniform(-1.5, 1.5, 20), *times]:
            assert load.factor(time) == np.interp(time, times, factors)


def test_a_pressure_without_a_potential_has_no_energy():
    """Its volume over the origin is none: it was another number wherever the shell lay."""
    energies = []
    for shift in (0.0, 1000.0):
        mesh = ms.flat_beam(length=1.0, width=0.2, cells=(6, 2))
        mesh = ms.TriangleMesh(mesh.vertices + np.array([shift, 0.0, 0.0]), mesh.faces)
        shell = held(mesh, shift + 1e-6)
        run = ms.simulate(ms.DiscreteShell(shell), duration=0.1, dt=0.02, loads=[ms.Pressure(0.1)], gravity=(0, 0, -1))
        assert NO_POTENTIAL in run.message
        energies.append(run.energies)
    assert np.ptp(energies[0][:, 2]) > 0.0
    np.testing.assert_allclose(energies[1], energies[0], rtol=1e-5, atol=1e-7 * energies[0].max())


@pytest.mark.parametrize("shape", ["rib", "moebius"])
def test_a_pressure_has_no_potential_where_triangles_do_not_cancel(shape):
    """Three sheets at a free edge enclose nothing: 8 % lay between the work of their pressure and -p V."""
    mesh = moebius() if shape == "moebius" else frame([(-1.0, 0.0), (1.0, 0.0), (0.0, 0.3)])
    shell = ms.Shell(mesh, ms.Isotropic(2e9, 0.3, 1e-2, 1200.0), supports=[ms.Pin("boundary")])
    assert not shell.loading(None, None, [ms.Pressure(100.0)]).conservative
    buckled = ms.buckling_factors(shell, loads=[ms.Pressure(100.0)])
    assert not buckled.conservative
