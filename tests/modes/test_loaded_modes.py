"""Vibrations about loaded states, linear buckling, participation, and attachments, against closed forms of beams."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from modalshell import (
    Buckling,
    Contact,
    DiscreteShell,
    EdgeMoment,
    Fix,
    FollowerForce,
    FrameInertia,
    Isotropic,
    LinearModal,
    LineForce,
    LoadedModes,
    LoadError,
    Material,
    ModalShellWarning,
    OptionError,
    Pin,
    Plane,
    PointForce,
    PositionConstraint,
    Pressure,
    Roller,
    Shell,
    Symmetry,
    TriangleMesh,
    Wind,
    buckling_factors,
    flat_beam,
    repair,
    sheet,
    solve_modes,
)
from modalshell.statics.buckling import buckles

LENGTH, WIDTH, THICKNESS, YOUNG, DENSITY = 1.0, 0.1, 0.005, 1e9, 1000.0
STRIP = Isotropic(young=YOUNG, poisson=0.0, thickness=THICKNESS, density=DENSITY)
BENDING = YOUNG * WIDTH * THICKNESS**3 / 12.0
PER_LENGTH = DENSITY * WIDTH * THICKNESS
EULER = np.pi**2 * BENDING / LENGTH**2
TIP = "x > 0.999999"


def strip(cells=(40, 4)):
    return flat_beam(length=LENGTH, width=WIDTH, cells=cells)


def column(kind):
    mesh = strip()
    if kind == "clamped":
        return Shell(mesh, STRIP, mesh.vertices[:, 0] < 1e-9)
    slide = Roller(TIP, (1, 0, 0)) if kind == "rollers" else Fix(TIP, "yz")
    return Shell(mesh, STRIP, supports=[Pin("x < 1e-9"), slide])


def push(force):
    return [LineForce(TIP, (-force / WIDTH, 0.0, 0.0))]


@pytest.mark.by_default("clamped-factors0")
@pytest.mark.parametrize(
    ("kind", "factors"), [("clamped", [0.25, 2.25]), ("rollers", [1.0, 4.0]), ("fixed components", [1.0, 4.0])]
)
def test_columns_buckle_at_eulers_loads(kind, factors):
    found = buckling_factors(column(kind), 2, loads=push(EULER))
    assert isinstance(found, Buckling)
    assert found.factors == pytest.approx(factors, rel=0.01)
    assert np.abs(found.modes[:, 0].reshape(-1, 3)[:, 2]).max() == pytest.approx(1.0)
    assert buckles(column(kind), 1.02 * factors[0] * column(kind).total_load(loads=push(EULER)))
    assert not buckles(column(kind), 0.98 * factors[0] * column(kind).total_load(loads=push(EULER)))


def test_hinges_buckle_where_newton_loses_stability():
    mesh = flat_beam(length=1.0, width=0.2, cells=(20, 4))
    shell = Shell(mesh, Material(200.0, 200.0, 0.05, 0.2), mesh.vertices[:, 0] < 0.08)
    load = PointForce("x > 0.999999", (-0.01, 0.0, 0.0))
    factor = buckling_factors(shell, loads=[load]).factors[0]
    for share in (0.98, 1.02):
        force = share * factor * load.force(mesh)
        # From rest, where symmetry keeps the strip straight.
        straight = DiscreteShell(shell).equilibrium(force=0.9 * factor * load.force(mesh)).positions
        straight = mesh.vertices + share / 0.9 * (straight - mesh.vertices)
        assert (DiscreteShell(shell).lowest_eigenvalue(straight) > 0.0) == (share < 1.0)
        assert force.any()


def test_loads_that_pull_never_buckle():
    assert buckling_factors(column("clamped"), 3, loads=push(-EULER)).factors.size == 0
    hanging = Shell(flat_beam(length=1.0, width=0.2, cells=(3, 1)), STRIP, supports=[Pin("x < 1e-9")])
    with pytest.raises(OptionError, match="a turn about"):
        buckling_factors(hanging, loads=push(1.0))
    with pytest.raises(LoadError, match="needs a load"):
        buckling_factors(column("clamped"))


@pytest.mark.parametrize("share", [-0.5, 0.5, 0.9])
def test_axial_force_changes_frequencies_as_beam_theory_says(share):
    """``f^2 = f_0^2 (1 - P / P_n)`` of each mode of a beam on rollers, P_n its Euler load [clough1993]."""
    shell = column("rollers")
    state = DiscreteShell(shell).equilibrium(loads=push(share * EULER))
    assert state.converged
    about = solve_modes(shell, 2, about=state)
    assert isinstance(about, LoadedModes)
    number = np.arange(1, 3)
    free = (number * np.pi / LENGTH) ** 2 * np.sqrt(BENDING / PER_LENGTH) / (2.0 * np.pi)
    assert about.frequencies == pytest.approx(free * np.sqrt(1.0 - share / number**2), rel=0.01)
    gram = about.modes.T @ (np.repeat(shell.mass, 3)[:, None] * about.modes)
    assert gram == pytest.approx(np.eye(2), abs=1e-9)


def test_modes_about_rest_are_those_of_the_shell():
    for shell in (column("clamped"), Shell(sheet(cells=(3, 3)), STRIP, supports=[Pin("x < 0.1"), Fix(TIP, "z")])):
        basis, about = solve_modes(shell, 3), solve_modes(shell, 3, about=shell.rest_positions)
        assert about.eigenvalues == pytest.approx(basis.eigenvalues, rel=1e-7)
        assert np.abs(about.modes) == pytest.approx(np.abs(basis.modes), abs=1e-5 * np.abs(basis.modes).max())
        assert about.count == 3


def test_states_that_are_not_stable_are_refused():
    shell = column("rollers")
    straight = DiscreteShell(shell).equilibrium(loads=push(0.5 * EULER)).positions
    crushed = shell.rest_positions + 3.0 * (straight - shell.rest_positions)
    with pytest.raises(OptionError, match="stable"):
        solve_modes(shell, 2, about=crushed)
    with pytest.raises(LoadError, match="positions"):
        solve_modes(shell, 2, about=np.zeros(3))
    with pytest.raises(OptionError, match="attachments"):
        solve_modes(shell, 2, about=straight, attachments=push(1.0))


def test_cantilever_frequencies_and_effective_masses():
    basis = solve_modes(column("clamped"), 3)
    numbers = np.array([1.875104, 4.694091]) ** 2
    flapping = np.abs(basis.modes.reshape(-1, 3, 3)[:, 2]).max(axis=0) > 0.1
    exact = numbers / LENGTH**2 * np.sqrt(BENDING / PER_LENGTH) / (2.0 * np.pi)
    assert basis.frequencies[flapping][:2] == pytest.approx(exact, rel=0.01)
    masses = basis.effective_masses[:, 2] / basis.shell.mass.sum()
    assert masses[0] == pytest.approx(0.6131, rel=0.015)
    assert masses[1] == pytest.approx(0.1883, rel=0.03)


def test_effective_masses_of_all_modes_are_the_mass_that_moves():
    mesh = sheet(cells=(2, 2))
    shell = Shell(mesh, STRIP, supports=[Pin("x < 0.1"), Fix(TIP, "z")])
    basis = solve_modes(shell, shell.unknowns.count)
    x = mesh.vertices[:, 0]
    free = shell.mass[x > 0.1].sum()
    within = shell.mass[(x > 0.1) & (x < 0.999)].sum()
    assert basis.effective_masses.sum(axis=0) == pytest.approx([free, free, within], rel=1e-9)


def test_attachments_make_the_linear_answer_exact():
    shell = column("clamped")
    load = PointForce("nearest(1, 0.05, 0)", (0.0, 0.0, 1e-6))
    truth = DiscreteShell(shell).equilibrium(loads=[load]).positions - shell.rest_positions
    plain, attached = (
        solve_modes(shell, 4),
        solve_modes(shell, 4, attachments=[load, load.force(shell.mesh), push(1.0)[0]]),
    )
    assert attached.count == 6  # the same load twice adds one vector
    assert attached.eigenvalues[:4] == pytest.approx(plain.eigenvalues)
    assert (np.diff(attached.eigenvalues) > 0.0).all()
    gram = attached.modes.T @ (np.repeat(shell.mass, 3)[:, None] * attached.modes)
    assert gram == pytest.approx(np.eye(6), abs=1e-9)
    errors = [
        np.abs(LinearModal(basis).equilibrium(loads=[load]).positions - shell.rest_positions - truth).max()
        for basis in (plain, attached)
    ]
    assert errors[1] < 1e-5 * np.abs(truth).max() < errors[0]
    with pytest.raises(OptionError, match="leave free"):
        solve_modes(Shell(shell.mesh, STRIP), 8, attachments=[load])
    with pytest.raises(OptionError, match="list of loads"):
        solve_modes(shell, 4, attachments=[])
    with pytest.raises(LoadError):
        solve_modes(shell, 4, attachments=[np.zeros(3)])


def arc(cells=(24, 2)):
    """A quarter of a ring of radius 1 m on planes of symmetry, held along its axis; normals point outwards."""
    flat = flat_beam(length=1.0, width=0.1, cells=cells)
    angle, height = 0.5 * np.pi * flat.vertices[:, 0], flat.vertices[:, 1]
    mesh = TriangleMesh(np.column_stack([np.sin(angle), height, np.cos(angle)]), flat.faces)
    x, _, z = mesh.vertices.T
    planes = [Symmetry(np.abs(x) < 1e-9, (1, 0, 0)), Symmetry(np.abs(z) < 1e-9, (0, 0, 1))]
    return Shell(mesh, STRIP, supports=[*planes, Fix("y > -9", "y")])


@pytest.mark.parametrize(("follower", "multiple"), [(True, 3.0), (False, 4.0)])
def test_rings_buckle_at_three_or_four_times_their_stiffness(follower, multiple):
    """``p R^3 / D``: 3 under the pressure of a fluid, 4 under one that keeps its directions [timoshenko1961, 7.2]."""
    rigidity = YOUNG * THICKNESS**3 / 12.0
    found = buckling_factors(arc(), loads=[Pressure(-rigidity, follower=follower)])
    assert found.factors == pytest.approx([multiple], rel=0.01)
    assert found.conservative is not follower  # of a pressure on a free rim nothing tells that it has a potential


def becks_frequencies(load):
    """The first two angular frequencies, in ``sqrt(E I / m) / L^2``, of Beck's column [beck1952] at P L^2 / (E I)."""

    def left(omega):
        half, root = 0.5 * load, np.sqrt(0.25 * load**2 + omega**2)
        a, b = np.sqrt(root + half), np.sqrt(root - half)
        return load**2 + 2 * omega**2 * (1 + np.cos(a) * np.cosh(b)) + load * omega * np.sin(a) * np.sinh(b)

    grid = np.linspace(0.5, 25.0, 400)
    signs = np.sign([left(one) for one in grid])
    return [brentq(left, grid[k], grid[k + 1]) for k in np.flatnonzero(np.diff(signs))]


@pytest.mark.by_default("10.0")
@pytest.mark.parametrize("load", [10.0, 18.0])
def test_a_follower_force_draws_the_frequencies_of_becks_column_together(load):
    shell = column("clamped")
    end = np.flatnonzero(shell.mesh.vertices[:, 0] > 0.999999)
    force = FollowerForce(end, (-load * BENDING / len(end), 0.0, 0.0))
    state = DiscreteShell(shell).equilibrium(loads=[force])
    assert state.stable
    about = solve_modes(shell, 6, about=state)
    assert not about.conservative
    flapping = np.abs(about.modes.reshape(-1, 3, 6)[:, 2]).max(axis=0) > 0.5 * np.abs(about.modes).max(axis=0)
    found = 2.0 * np.pi * about.frequencies[flapping][:2]
    assert found == pytest.approx(np.sqrt(BENDING / PER_LENGTH) * np.array(becks_frequencies(load)), rel=0.01)
    assert buckling_factors(shell, loads=[force]).factors.size == 0  # it flutters, and never buckles
    past = shell.loading(loads=[FollowerForce(end, (-22.0 * BENDING / len(end), 0.0, 0.0))])
    pressed = shell.rest_positions + 22.0 / load * (state.positions - shell.rest_positions)
    with pytest.raises(OptionError, match="flutters"):
        solve_modes(shell, 6, about=replace(state, positions=pressed, loading=past))


@pytest.mark.by_default("load0", "load2")
@pytest.mark.parametrize(
    "load",
    [Pressure(5.0), EdgeMoment(TIP, 1.0), FrameInertia((0.0, 0.0, 0.1), (0.0, 3.0, 0.0)), Wind((0.0, 1.0, 3.0))],
)
def test_modes_about_a_state_know_the_stiffness_of_its_load(load):
    mesh = strip((6, 1))
    shell = Shell(mesh, STRIP, mesh.vertices[:, 0] < 1e-9)
    state = DiscreteShell(shell).equilibrium(loads=[load])
    x, loading = state.positions, shell.loading(loads=[load])

    def force(change):
        return loading.force(x + change.reshape(-1, 3)).ravel()

    steps = 1e-6 * np.eye(x.size)
    slope = np.stack([(force(step) - force(-step)) / 2e-6 for step in steps], axis=1)
    free = np.flatnonzero(np.repeat(~shell.clamped, 3))
    whole = (shell.stiffness(x).toarray() - slope)[np.ix_(free, free)] / np.repeat(shell.mass, 3)[free, None]
    expected = np.sort(np.linalg.eigvals(whole).real)[:4]
    about = solve_modes(shell, 4, about=state)
    assert about.conservative == state.conservative
    assert about.eigenvalues == pytest.approx(expected, rel=1e-5)
    dead = solve_modes(shell, 4, about=x).eigenvalues
    assert np.abs(about.eigenvalues / dead - 1.0).max() > 1e-4


def test_modes_about_a_state_that_something_else_holds_say_that_this_is_left_out():
    shell = Shell(strip((10, 2)), STRIP, "x < 1e-6")
    model, gravity = DiscreteShell(shell), (0.0, 0.0, -1e-3)
    free = model.equilibrium(gravity=gravity)
    low = free.positions[:, 2].min()
    lying = model.equilibrium(gravity=gravity, contacts=[Contact(Plane(offset=0.5 * low))])
    tip = int(free.positions[:, 0].argmax())
    held = model.equilibrium(gravity=gravity, constraints=[PositionConstraint(tip, shell.rest_positions[tip])])
    for state, what in ((lying, "contacts"), (held, "constraints")):
        assert state.converged
        with pytest.warns(ModalShellWarning, match=f"a state under {what}, which vibrations about it leave out"):
            solve_modes(shell, 2, about=state)
    solve_modes(shell, 2, about=free)


def tube():
    """A tube about the x axis."""
    flat = sheet(length=1.0, width=1.0, cells=(20, 12))
    x, y, _ = flat.vertices.T
    angles = 2.0 * np.pi * (y - y.min())
    rolled = np.column_stack([x - x.min(), 0.1 * np.cos(angles), 0.1 * np.sin(angles)])
    return repair(rolled, flat.faces)[0]


def test_frequencies_in_a_turning_frame_say_what_coriolis_forces_make_of_them():
    """A tube that spins about its axis: its frequencies across split by the turns a second."""
    mesh = tube()
    shell = Shell(mesh, Isotropic(1e8, 0.3, 1e-3, 1000.0), "x < 1e-6")
    still = solve_modes(shell, 2).frequencies
    assert still[0] == pytest.approx(still[1], rel=0.02)
    turns = 0.2 * still[0]
    model = DiscreteShell(shell)
    spun = model.equilibrium(loads=[FrameInertia(angular_velocity=(2.0 * np.pi * turns, 0.0, 0.0))])
    with pytest.warns(ModalShellWarning, match="Coriolis forces") as given:
        solve_modes(shell, 2, about=spun)
    named = float(str(given[0].message).split("would make ")[1].split(" Hz")[0])
    assert min(abs(named - (still[0] - turns)), abs(named - (still[0] + turns))) < 0.03 * still[0]
    slow = model.equilibrium(loads=[FrameInertia(angular_velocity=(0.002 * still[0], 0.0, 0.0))])
    solve_modes(shell, 2, about=slow)
