"""Creases: one hinge by hand, statics through loading and release, motion, and what is refused."""

import pickle
from functools import partial
from itertools import pairwise

import numpy as np
import pytest

import modalshell as ms
from modalshell.integrators.state import CREASES, HEAT
from studies import folded_map

SHEET = ms.Isotropic(young=1e9, poisson=0.0, thickness=1e-3, density=1000.0)
HINGES = ms.Material(stretch=1e5, shear=1e3, flexure=0.05, density=1.0)
ENERGIES = pytest.mark.parametrize("material", [SHEET, HINGES], ids=["split folds", "hinges"])
LIMIT, HARDENING = 0.02, 0.05


def kite():
    """Two triangles and the crease between them, of length 1."""
    corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.4, -0.8, 0.0], [0.6, 0.7, 0.0]]
    return ms.TriangleMesh(np.array(corners), [[0, 1, 3], [1, 0, 2]])


def folded(mesh, angle):
    """The kite with its second triangle turned by an angle."""
    x = np.array(mesh.vertices)
    x[3] = 0.6, 0.7 * np.cos(angle), 0.7 * np.sin(angle)
    return x


def strip(material=SHEET, *, limit=LIMIT, hardening=HARDENING, cells=(8, 1), where=0.5, **options):
    """A strip that is clamped at x = 0 with a crease across it."""
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=cells)
    across = np.abs(mesh.vertices[:, 0] - where) < 1e-9
    options.setdefault("clamped", "x < 0.13")
    return ms.Shell(mesh, material, creases=[ms.Crease(across, limit, hardening)], **options)


def by_hand(path, k, limit, hardening):
    """Plastic folds, couples and heat of one hinge that is led along fold angles, by the law of two lines."""
    plastic, heat, found = 0.0, 0.0, []
    for angle in path:
        # Loading goes along the line of hardening, unloading along the elastic one: the couple lies between both.
        upper = (k * hardening * angle + k * limit) / (k + hardening)
        lower = (k * hardening * angle - k * limit) / (k + hardening)
        couple = min(max(k * (angle - plastic), lower), upper)
        after = angle - couple / k
        heat += limit * abs(after - plastic)
        plastic = after
        found.append((plastic, couple, heat))
    return np.array(found)


@ENERGIES
def test_a_loading_cycle_of_one_hinge_is_that_by_hand(material):
    mesh = kite()
    shell = ms.Shell(mesh, material, clamped=[0, 1, 2], creases=[ms.Crease([[0, 1]], LIMIT, HARDENING)])
    creases, energy = shell.creases, shell.elastic_energy
    k = float(energy.fold_stiffness(creases.hinges)[0, 0])
    sign = np.sign(energy.fold_couples(folded(mesh, 1e-3), creases.hinges)[0])
    turning = LIMIT / k * np.array([0.0, 0.5, 3.0, -4.0, 2.5, 5.0, 0.0, -6.0])
    path = np.concatenate([np.linspace(a, b, 7) for a, b in pairwise(turning)])
    angles, heat, found = np.zeros(1), 0.0, []
    for angle in path:
        x = folded(mesh, angle)
        couples = shell.creased(angles).elastic_energy.fold_couples(x, creases.hinges)
        flow = creases.flow(np.array([[k]]), creases.drive(couples, angles), np.zeros(1), np.ones(1, dtype=bool))
        after = angles + flow.change
        assert flow.settled
        heat, angles = heat + creases.heat(angles, after), after
        couples = shell.creased(angles).elastic_energy.fold_couples(x, creases.hinges)
        found.append((sign * angles[0], sign * couples[0], heat))
    expected = by_hand(path, k, LIMIT, HARDENING)
    assert np.abs(np.array(found) - expected).max() < 1e-10 * np.abs(expected).max()
    assert np.ptp(expected[:, 0]) > 2.0 * LIMIT / k  # it yields both ways


@pytest.mark.slow
@ENERGIES
@pytest.mark.parametrize("loads", [(1.5,), (1.2, 1.9, 0.0, -1.4, 0.0, 1.7)])
def test_a_couple_leaves_the_angle_that_hardening_says(material, loads):
    """The couple of a crease is the torque of the load beyond it about its line, whatever the sheet is made of."""
    shell = strip(material)
    ends, beyond = shell.mesh.edges[shell.mesh.hinge_edges[shell.creases.hinges[0]]], shell.mesh.vertices[:, 0] > 0.5
    width, x, plastic = shell.mesh.edge_lengths[shell.mesh.hinge_edges[shell.creases.hinges[0]]], None, 0.0
    for factor in loads:
        answer = ms.DiscreteShell(shell).equilibrium(loads=[ms.EdgeMoment("x > 0.99", factor * LIMIT)], start=x)
        assert answer.converged
        x = answer.positions
        first, line = x[ends[0]], x[ends[1]] - x[ends[0]]
        torque = np.cross(x - first, answer.loading.force(x))[beyond].sum(axis=0) @ line / np.linalg.norm(line) / width
        assert abs(torque) == pytest.approx(abs(factor) * LIMIT, rel=2e-3)
        excess = torque - HARDENING * plastic
        plastic += np.sign(excess) * max(abs(excess) - LIMIT, 0.0) / HARDENING
        sign = 1.0 if answer.creases.angles[0] * plastic > 0.0 else -1.0
        assert sign * answer.creases.angles[0] == pytest.approx(plastic, abs=1e-7)
        assert answer.creases.dissipated >= shell.crease_state.dissipated
        shell = shell.creased(answer.creases)


@pytest.mark.slow
def test_a_release_in_one_step_that_is_not_found_says_by_how_much_it_misses():
    """A fold this large turns round as it is released, farther than dead forces at the tip would lead it."""
    shell = strip(cells=(10, 2), clamped="x < 1e-9")
    bent = ms.DiscreteShell(shell).equilibrium(loads=[ms.EdgeMoment("x > 0.99", 5.0 * LIMIT)])
    assert np.abs(bent.creases.angles) == pytest.approx(4.0 * LIMIT / HARDENING, rel=1e-3)
    shell, x = shell.creased(bent.creases), bent.positions
    released = ms.DiscreteShell(shell).equilibrium(start=x)
    assert not released.converged
    assert 0.0 < released.residual < 10.0
    assert released.stable is None
    assert "inf" not in released.message
    for factor in (2.5, 1.25, 0.0):  # by smaller ones it comes to where hardening keeps what the limit lets it
        bent = ms.DiscreteShell(shell).equilibrium(loads=[ms.EdgeMoment("x > 0.99", factor * LIMIT)], start=x)
        assert bent.converged
        shell, x = shell.creased(bent.creases), bent.positions
    assert np.abs(bent.creases.angles) == pytest.approx(LIMIT / HARDENING, rel=1e-3)


@pytest.mark.slow
@ENERGIES
def test_folded_released_and_folded_again(material):
    shell = strip(material, cells=(8, 2), hardening=0.02)
    down = ms.DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -0.5))
    assert down.converged
    first = np.abs(down.creases.angles).min()
    assert first > 0.1
    own = shell.creased(down.creases)
    released = ms.DiscreteShell(own).equilibrium(start=down.positions)
    assert released.converged
    assert np.array_equal(released.creases.angles, down.creases.angles)  # unloading is elastic
    assert released.positions[:, 2].min() < -0.4 * np.sin(0.9 * first)  # and it stays folded
    again = ms.DiscreteShell(own).equilibrium(gravity=(0.0, 0.0, -0.5), start=released.positions)
    assert np.abs(again.positions - down.positions).max() < 1e-6
    assert again.creases.dissipated == pytest.approx(down.creases.dissipated, rel=1e-6)
    up = ms.DiscreteShell(own).equilibrium(gravity=(0.0, 0.0, 0.5), start=released.positions)
    assert up.converged
    assert (np.sign(up.creases.angles) == -np.sign(down.creases.angles)).all()
    assert up.creases.dissipated > 1.5 * down.creases.dissipated


def test_work_is_stored_or_heat():
    """Work of slowly growing loads is elastic energy, energy of hardening and heat."""
    shell = strip(cells=(8, 1))
    tip = shell.mesh.vertices[:, 0] > 0.99
    lengths = np.linspace(0.0, 0.03, 16)[1:]
    x, work, before, shape = None, 0.0, 0.0, shell.rest_positions
    for size in lengths:
        force = np.zeros_like(shell.rest_positions)
        force[tip, 2] = -0.5 * size
        answer = ms.DiscreteShell(shell).equilibrium(force=force, start=x)
        moved = (answer.positions - shape)[tip, 2].sum()
        work += -0.25 * (size + before) * moved
        shell, x, before, shape = shell.creased(answer.creases), answer.positions, size, answer.positions
    state = shell.crease_state
    kept = shell.energy(x) + shell.creases.stored(state.angles) + state.dissipated
    assert state.dissipated > 0.2 * work
    assert kept == pytest.approx(work, rel=1e-2)


@ENERGIES
def test_derivatives_by_rest_angles(material):
    shell = strip(material, cells=(8, 2))
    rng = np.random.default_rng(0)
    x = shell.rest_positions + 0.02 * rng.standard_normal(shell.rest_positions.shape)
    hinges, count = shell.creases.hinges, shell.creases.hinges.size
    energy = shell.elastic_energy
    couples, stiffness = energy.fold_couples(x, hinges), energy.fold_stiffness(hinges)
    pulls = energy.rest_angle_pulls(x, hinges)
    for index in range(count):
        step = 1e-2 * np.eye(count)[index]
        ahead, behind = shell.creased(step), shell.creased(-step)
        slope = (ahead.energy(x) - behind.energy(x)) / 2e-2  # exact, as the energy is quadratic in rest angles
        assert slope == pytest.approx(-couples[index], rel=1e-7)
        change = (ahead.elastic_energy.fold_couples(x, hinges) - couples) / 1e-2
        assert change == pytest.approx(-stiffness[index], abs=1e-9 * np.abs(stiffness).max())
        pull = (behind.force(x) - ahead.force(x)) / 2e-2
        assert np.abs(pull - pulls[index]).max() < 1e-7 * np.abs(pulls).max()


def test_random_folding_never_makes_heat_negative_and_meets_every_condition():
    mesh = ms.sheet(cells=(6, 6))
    creases = [ms.Crease(mesh.edges[_along(mesh, axis)], 0.02, 0.3 * axis) for axis in (0, 1)]
    shell = ms.Shell(mesh, SHEET, creases=creases)
    rng, own = np.random.default_rng(3), shell.creases
    matrix = shell.elastic_energy.fold_stiffness(own.hinges)
    assert np.abs(matrix - np.diag(np.diagonal(matrix))).max() > 1e-3 * matrix.max()  # creases feel one another
    angles, every = np.zeros(own.hinges.size), np.ones(own.hinges.size, dtype=bool)
    for _ in range(25):
        x = shell.rest_positions + 0.05 * rng.standard_normal(shell.rest_positions.shape)
        drive = own.drive(shell.creased(angles).elastic_energy.fold_couples(x, own.hinges), angles)
        flow = own.flow(matrix, drive, np.zeros_like(angles), every)
        after = angles + flow.change
        assert flow.settled
        assert own.heat(angles, after) >= 0.0
        drive = own.drive(shell.creased(after).elastic_energy.fold_couples(x, own.hinges), after)
        assert own.yield_residual(drive, flow.change).max() < 1e-10 * np.abs(matrix).max()
        assert (flow.change * drive >= 0.0).all()
        angles = after


def _along(mesh, axis):
    """Edges that lie on the middle line along an axis."""
    middle = np.abs(mesh.vertices[:, axis] - mesh.vertices[:, axis].mean()) < 1e-9
    return np.flatnonzero(middle[mesh.edges].all(axis=1))


@pytest.mark.by_default("hinges")
@ENERGIES
def test_creases_that_do_not_yield_change_no_bit(material):
    plain = ms.Shell(strip(material).mesh, material, clamped="x < 0.13")
    shell, gravity = strip(material, limit=1e3), (0.0, 0.0, -1.0)
    still = [ms.DiscreteShell(s).equilibrium(gravity=gravity) for s in (plain, shell)]
    assert np.array_equal(still[0].positions, still[1].positions)
    moving = [ms.simulate(ms.DiscreteShell(s), duration=0.2, dt=0.02, gravity=gravity) for s in (plain, shell)]
    assert np.array_equal(moving[0].positions, moving[1].positions)
    assert moving[1].crease_heat.max() == 0.0
    assert moving[0].crease_angles.size == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rule", "material"),
    [("implicit", HINGES), ("composite", SHEET), ("bdf2", HINGES)],
    ids=["implicit-hinges", "composite-split folds", "bdf2-hinges"],
)
def test_motion_comes_to_a_rest_of_statics(material, rule):
    shell, load = strip(material), {"gravity": (0.0, 0.0, -0.5)}
    model = ms.DiscreteShell(shell, integrator=rule)
    run = ms.simulate(model, duration=16.0, dt=0.2, damping=(4.0, 0.0), **load)
    assert run.unconverged_steps == 0
    assert (np.diff(run.crease_heat) >= 0.0).all()
    assert run.crease_heat[-1] > 0.0
    final = shell.creased(run.crease_angles[-1])
    couples = final.elastic_energy.fold_couples(run.positions[-1], shell.creases.hinges)
    drive = shell.creases.drive(couples, run.crease_angles[-1])
    assert (np.abs(drive) <= shell.creases.limits * (1.0 + 1e-6)).all()
    still = ms.DiscreteShell(final).equilibrium(**load, start=run.positions[-1])
    assert still.creases.angles == pytest.approx(run.crease_angles[-1], rel=1e-2)
    assert np.abs(still.positions - run.positions[-1]).max() < 5e-3


@pytest.mark.slow
def test_explicit_steps_and_implicit_ones_yield_alike():
    shell = strip(ms.Material(stretch=200.0, shear=2.0, flexure=0.05, density=1.0), cells=(6, 1), clamped="x < 0.18")
    options = {"duration": 0.4, "gravity": (0.0, 0.0, -5.0)}
    fine = ms.simulate(ms.DiscreteShell(shell, integrator="verlet"), dt=2e-4, store_every=2000, **options)
    errors = []
    for dt in (0.004, 0.002):
        run = ms.simulate(ms.DiscreteShell(shell, integrator="implicit"), dt=dt, **options)
        errors.append(np.abs(run.crease_angles[-1] - fine.crease_angles[-1]).max())
    assert np.abs(fine.crease_angles[-1]).min() > 0.03
    assert errors[1] < 0.65 * errors[0]
    assert errors[1] < 0.25 * np.abs(fine.crease_angles[-1]).max()


@pytest.mark.slow
def test_state_survives_files_and_pickles(tmp_path):
    shell = strip()
    model = ms.DiscreteShell(pickle.loads(pickle.dumps(shell)))
    run = ms.simulate(model, duration=0.6, dt=0.05, gravity=(0.0, 0.0, -1.0), fields=["curvature"])
    assert run.crease_heat[-1] > 0.0
    back = ms.load_trajectory(run.save(tmp_path / "run.npz"))
    assert np.array_equal(back.crease_angles, run.crease_angles)
    assert np.array_equal(back.crease_heat, run.crease_heat)
    own = shell.creased(run.crease_angles[-1])
    assert np.array_equal(run.fields["curvature"][-1], own.fields(run.positions[-1]).curvature)
    kept = own.energy(run.positions[-1]) + own.creases.stored(run.crease_angles[-1])
    assert np.allclose(run.energies[-1, 1], kept, rtol=1e-12)


@pytest.mark.slow
def test_a_motion_goes_on_from_a_snapshot_bit_by_bit():
    from modalshell.motion import Motion

    shell = strip()

    def motion():
        model = ms.DiscreteShell(shell)
        return Motion(model, shell.loading((0.0, 0.0, -1.0)), dt=0.05)

    whole, second = motion(), motion()
    for _ in range(6):
        whole.advance()
    second.restore(whole.snapshot())
    assert second.state.memory[HEAT][0] > 0.0
    for _ in range(4):
        whole.advance()
        second.advance()
    assert np.array_equal(whole.positions(), second.positions())
    assert np.array_equal(whole.state.memory[CREASES], second.state.memory[CREASES])


def test_creases_by_their_fold():
    mesh = ms.v_beam(length=1.0, width=0.2, fold=120.0, cells=(4, 4))
    shell = ms.Shell(mesh, SHEET, clamped="x < 0.3", creases=[ms.Crease("x > -1", 0.1, angle=30.0)])
    ends = mesh.edges[mesh.hinge_edges[shell.creases.hinges]]
    assert len(ends) == 4
    assert np.abs(mesh.vertices[ends][:, :, 1] - mesh.vertices[ends][:, :, 1].mean()).max() < 1e-9


REFUSED = [
    ({"sel": "x > 5"}, ms.OptionError, "sel selects no vertex"),
    ({"sel": [0]}, ms.OptionError, "sel has no edge of two triangles"),
    ({"sel": [[0, 10**6]]}, ms.OptionError, "is no edge"),
    ({"sel": np.zeros((2, 3), dtype=int)}, ms.OptionError, "pairs of vertices"),
    ({"sel": [[0, True]]}, ms.OptionError, r"pairs of vertices \(k, 2\), not true or false \(got \[\[0, True\]\]"),
    ({"sel": [0.5]}, ms.OptionError, "sel must be"),
    ({"yield_moment": 0.0}, ms.MaterialError, "yield_moment must be a finite number above 0"),
    ({"yield_moment": np.nan}, ms.MaterialError, "yield_moment must be"),
    ({"hardening": -1.0}, ms.MaterialError, "hardening must be a finite number at least 0"),
    ({"angle": 200.0}, ms.OptionError, "angle must be"),
    ({"angle": 30.0}, ms.OptionError, "folded by more than 30 degrees"),
]


@pytest.mark.parametrize(("changed", "error", "words"), REFUSED, ids=[words for *_, words in REFUSED])
def test_creases_that_are_refused(changed, error, words):
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(4, 1))
    with pytest.raises(error, match=words):
        ms.Shell(mesh, SHEET, creases=[ms.Crease(**({"sel": "x > 0.4", "yield_moment": 1.0} | changed))])


def test_what_knows_no_creases_says_so():
    shell = strip()
    model = ms.DiscreteShell(shell)
    with pytest.raises(ms.OptionError, match="a modal model knows no creases"):
        ms.solve_modes(shell, 3)
    with pytest.raises(ms.OptionError, match="the hybrid rung knows no creases"):
        ms.HybridStress.trained(shell, gravity=(0.0, 0.0, -1.0), motions=1)
    with pytest.raises(ms.OptionError, match="an error bar knows no creases"):
        model.equilibrium(gravity=(0.0, 0.0, -1.0), bar=True)
    floor = [ms.Contact(ms.Plane((0.0, 0.0, 1.0), -0.1))]
    with pytest.raises(
        ms.OptionError, match="an equilibrium with contacts knows no creases: let a motion come to rest"
    ):
        model.equilibrium(gravity=(0.0, 0.0, -1.0), contacts=floor)
    with pytest.raises(ms.OptionError, match="a path of equilibria knows no creases: leave creases out"):
        ms.equilibrium_path(model, gravity=(0.0, 0.0, -1.0))
    with pytest.raises(ms.OptionError, match="a derivative of an equilibrium knows no creases"):
        model.sensitivity(model.equilibrium(gravity=(0.0, 0.0, -0.1)), "young")
    with pytest.raises(ms.OptionError, match="a fit knows no creases"):
        ms.fit(shell, "young", shell.rest_positions, gravity=(0.0, 0.0, -1.0))
    with pytest.raises(ms.OptionError, match="linear buckling of a folded shell knows no creases"):
        ms.buckling_factors(shell.creased([0.1]), gravity=(-1.0, 0.0, 0.0))
    assert ms.buckling_factors(shell, gravity=(-1.0, 0.0, 0.0)).factors.size  # those that do not yield are elastic
    plain = ms.Shell(shell.mesh, SHEET, clamped="x < 0.13")
    with pytest.raises(ms.OptionError, match="has no creases"):
        plain.creased([0.1])
    with pytest.raises(ms.LoadError, match="creases must be 1 finite plastic folds"):
        shell.creased([0.1, 0.2])
    with pytest.raises(ms.LoadError, match="creases must be 1 finite plastic folds"):
        shell.creased([np.nan])
    with pytest.raises(ms.OptionError, match="creases must be a list"):
        ms.Shell(shell.mesh, SHEET, creases=ms.Crease("x > 0.4", 1.0))
    with pytest.raises(ms.OptionError, match=r"creases\[1\] has edge"):
        ms.Shell(shell.mesh, SHEET, creases=[ms.Crease("x > 0.4", 1.0), ms.Crease("x > 0.6", 1.0)])


@pytest.mark.slow
@ENERGIES
def test_modes_about_a_folded_state_are_those_of_its_folds(material):
    shell = strip(material, hardening=0.02)
    state = ms.DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -0.5))
    assert np.abs(state.creases.angles).min() > 0.1
    about = ms.solve_modes(shell, 2, about=state)
    kept = ms.solve_modes(shell.creased(state.creases), 2, about=state.positions)
    np.testing.assert_allclose(about.eigenvalues, kept.eigenvalues, rtol=1e-10)
    assert ms.DiscreteShell(shell).tangent_eigenvalue(state, state.loading.dead) == pytest.approx(about.eigenvalues[0])
    hinge = np.linalg.norm(shell.creased(state.creases).force(state.positions)[~shell.clamped], axis=1).max()
    assert hinge < np.linalg.norm(shell.force(state.positions)[~shell.clamped], axis=1).max()


@pytest.mark.slow
def test_a_mechanism_is_not_called_an_equilibrium():
    """Without hardening a crease holds no more than its yield moment: a larger couple has no equilibrium."""
    shell = strip(HINGES, hardening=0.0, cells=(4, 1), clamped="x < 0.26")
    answer = ms.DiscreteShell(shell).equilibrium(loads=[ms.EdgeMoment("x > 0.99", 1.5 * LIMIT)])
    assert not answer.converged


def test_creases_in_free_flight_far_away_on_contacts_and_on_supports_that_turn():
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(8, 1))
    creases = [ms.Crease(np.abs(mesh.vertices[:, 0] - 0.5) < 1e-9, LIMIT, 0.02)]
    free = ms.Shell(mesh, SHEET, creases=creases)
    push = np.zeros_like(mesh.vertices)
    push[:, 2] = 0.2 * np.cos(2.0 * np.pi * mesh.vertices[:, 0])
    push -= free.mass[:, None] * push.sum(axis=0) / free.mass.sum()
    run = ms.simulate(ms.DiscreteShell(free), duration=0.2, dt=0.02, force=push)
    assert run.crease_heat[-1] > 0.0
    centres = np.einsum("v,fvk->fk", free.mass, run.positions) / free.mass.sum()
    assert np.abs(centres - centres[0]).max() < 1e-12

    options = {"duration": 0.3, "dt": 0.05, "gravity": (0.0, 0.0, -1.0)}
    near, far = (
        ms.simulate(
            ms.DiscreteShell(ms.Shell(own, SHEET, clamped=mesh.vertices[:, 0] < 0.13, creases=creases)), **options
        )
        for own in (mesh, ms.TriangleMesh(mesh.vertices + np.array([1e4, 0.0, 0.0]), mesh.faces))
    )
    assert near.crease_heat[-1] > 0.0
    np.testing.assert_allclose(far.crease_angles, near.crease_angles, atol=1e-9)

    ridge = ms.Contact(ms.Cylinder((0.5, -1.0, -0.12), (0.5, 1.0, -0.12), 0.1))
    run = ms.simulate(ms.DiscreteShell(free), duration=0.2, dt=0.02, gravity=(0.0, 0.0, -9.81), contacts=[ridge])
    assert run.crease_heat[-1] > 0.0
    assert (np.diff(run.crease_heat) >= 0.0).all()

    turn = ms.SupportPath([0.0, 0.3], np.zeros((2, 3)), [[0.0, 0.0, 0.0], [0.0, -2.0, 0.0]])
    held = ms.Shell(mesh, SHEET, clamped="x < 0.13", creases=creases)
    run = ms.simulate(ms.DiscreteShell(held), duration=0.4, dt=0.02, supports=turn)
    assert run.unconverged_steps == 0
    assert run.crease_heat[-1] > 0.0
    assert (np.diff(run.crease_heat) >= 0.0).all()


@pytest.mark.slow
def test_a_moving_crease_keeps_the_balance_of_energy():
    """What the load has done moves, bends, is stored by hardening, or is heat."""
    mesh = ms.sheet(length=0.2, width=0.1, cells=(6, 3))
    x = mesh.vertices[:, 0]
    crease = ms.Crease(abs(x - 0.1) < 1e-6, yield_moment=0.05, hardening=0.1)
    sheet = ms.Isotropic(young=1e9, poisson=0.3, thickness=2e-3, density=1000.0)
    shell = ms.Shell(mesh, sheet, clamped=x < 1e-6, creases=[crease])
    run = ms.simulate(ms.DiscreteShell(shell), duration=0.06, dt=5e-4, gravity=(0.0, 0.0, -9.81), store_every=20)
    assert run.crease_heat[-1] > 0.3 * -run.energies[-1, 2]
    balance = run.energies.sum(axis=1) + run.crease_heat
    assert np.abs(balance).max() < 0.05 * run.crease_heat[-1]


@pytest.mark.slow
@pytest.mark.parametrize(("material", "limit"), [(HINGES, 0.03), (SHEET, 0.055)], ids=["hinges", "split folds"])
def test_what_yields_on_the_way_to_a_load_keeps_its_fold(material, limit):
    """A strip folds early; pulled straight up beside its clamp, it has hardly a moment left at the crease."""
    shell = strip(material, limit=limit)
    own, x = shell, None
    for force in np.geomspace(0.1, 20.0, 8):
        slowly = ms.DiscreteShell(own).equilibrium(loads=[ms.LineForce("x > 0.99", (0.0, 0.0, force))], start=x)
        own, x = shell.creased(slowly.creases), slowly.positions
    at_once = ms.DiscreteShell(shell).equilibrium(loads=[ms.LineForce("x > 0.99", (0.0, 0.0, 20.0))])
    assert slowly.converged
    assert at_once.converged
    assert np.abs(slowly.creases.angles).max() > 0.05
    assert at_once.creases.angles == pytest.approx(slowly.creases.angles, rel=1e-3)
    assert at_once.creases.dissipated == pytest.approx(slowly.creases.dissipated, rel=5e-3)


@pytest.mark.slow
def test_a_map_that_is_let_go_dissipates_no_more_than_it_had():
    """The load that holds it would not: a release by growing loads from there led to flat panels and twice the heat."""
    shell = folded_map.folded_sheet(2, folded_map.LIMIT)
    led = [
        ms.PositionConstraint(np.flatnonzero(folded_map.line(shell.mesh, k)), partial(folded_map.led_to, panels=k))
        for k in (2, folded_map.PANELS)
    ]
    model = ms.DiscreteShell(shell, integrator="sdirk2")
    run = ms.simulate(model, duration=1.2, dt=0.02, damping=(5.0, 0.0), constraints=led)
    heat = float(run.crease_heat[-1])
    kept = shell.creased(ms.CreaseState(run.crease_angles[-1], heat))
    released = ms.DiscreteShell(kept).equilibrium(start=run.positions[-1])
    assert released.converged
    assert released.iterations < 400
    left = kept.creased(released.creases).energy(released.positions)
    assert released.creases.dissipated - heat + left <= kept.energy(run.positions[-1])
    np.testing.assert_allclose(folded_map.panel_folds(shell.mesh, released.positions), 127.0, atol=1.0)


def test_edges_that_are_flat_but_for_rounding_are_no_creases():
    """Of a mesh that lies askew some had a fold of 1e-6 degrees."""
    mesh = ms.v_beam(fold=150.0, cells=(8, 4))
    turn = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    askew = ms.TriangleMesh(mesh.vertices @ turn.T, mesh.faces)
    assert ms.Crease("x > -9", LIMIT, angle=0.0).hinges(askew).size == 8
    with pytest.raises(ms.OptionError, match="folded by more than 30 degrees"):
        ms.Crease("x > -9", LIMIT, angle=30.0).hinges(askew)
