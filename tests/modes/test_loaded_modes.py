"""Vibrations about loaded states, linear buckling, participation, and attachments, against closed forms of beams."""

import numpy as np
import pytest

from modalshell import (
    Buckling,
    DiscreteShell,
    Fix,
    Isotropic,
    LinearModal,
    LineForce,
    LoadedModes,
    LoadError,
    Material,
    OptionError,
    Pin,
    PointForce,
    Roller,
    Shell,
    buckling_factors,
    flat_beam,
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
