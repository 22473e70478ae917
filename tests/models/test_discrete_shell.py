"""DS: statics against the heavy elastica, buckling, the limits of its solver's claims; explicit and implicit motion."""

import csv
import signal
import warnings
from pathlib import Path

import numpy as np
import pytest
from scenes import PLAIN, cantilever, leaf

from modalshell import (
    DiscreteShell,
    Material,
    ModalWarping,
    Shell,
    flat_beam,
    solve_modes,
    v_beam,
)
from modalshell.core.errors import LoadError, ModalShellWarning, OptionError

with open(Path(__file__).resolve().parents[1] / "data" / "heavy_elastica.csv", encoding="utf-8") as _file:
    ELASTICA = {float(row["Gamma"]): row for row in csv.DictReader(line for line in _file if not line.startswith("#"))}

YOUNG, DENSITY = 1e9, 1000.0


def strip(ratio, cells, thickness, family, length=1.0):
    """A clamped strip with nu = 0: the shell, the gravity of Gamma = 1, the free length and its tip's vertices."""
    mesh = flat_beam(length=length, width=ratio * length, cells=cells, family=family)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModalShellWarning)  # obtuse Lloyd triangles: the area term is limited
        material = Material.from_physical(young=YOUNG, poisson=0.0, thickness=thickness, density=DENSITY, mesh=mesh)
    clamped = mesh.vertices[:, 0] < 1.5 * length / cells[0]
    free = length - mesh.vertices[clamped, 0].max()
    unit = YOUNG * thickness**3 / 12.0 / (DENSITY * thickness * free**3)
    return Shell(mesh, material, clamped), unit, free, np.flatnonzero(mesh.vertices[:, 0] > length - 1e-9)


def out_of_balance(shell, x, load):
    """|force + load| over |load| on the free vertices, from the public functions."""
    return np.linalg.norm((shell.force(x) + load)[shell.free]) / np.linalg.norm(load[shell.free])


def rounding(shell, x, load):
    """What the rounding of the positions alone puts out of balance: a millimetre sheet is stiff, and weighs little."""
    diagonal = shell.stiffness(x).diagonal()[shell.free_unknowns]
    return np.finfo(float).eps * np.abs(x).max() * np.linalg.norm(diagonal) / np.linalg.norm(load[shell.free])


def lowest_tangent_eigenvalue(shell, x):
    free = shell.free_unknowns
    return np.linalg.eigvalsh(shell.stiffness(x).toarray()[np.ix_(free, free)])[0]


@pytest.fixture
def _time_limit():
    """Ends a solve that never would."""

    def give_up(*_):
        raise TimeoutError("the solver did not come back within 10 s")

    before = signal.signal(signal.SIGALRM, give_up)
    signal.alarm(10)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


# ---- the heavy elastica

FAMILY_TOLERANCE = {"equilateral": 0.03, "union-jack": 0.03, "lloyd": 0.05}
STRIPS = [
    (0.1, (46, 4), 1e-3),
    (0.1, (40, 4), 1e-3),
    (0.25, (18, 4), 1e-2),
    (0.25, (32, 8), 1e-2),
    (0.25, (32, 8), 1e-3),
]
QUICK = [
    (0.1, (46, 4), 1e-3, "equilateral", 5.0),
    (0.1, (40, 4), 1e-3, "union-jack", 20.0),
    (0.25, (18, 4), 1e-2, "lloyd", 1.0),
    (0.25, (18, 4), 1e-2, "equilateral", 50.0),
    (0.25, (32, 8), 1e-3, "union-jack", 2.0),
    (0.25, (32, 8), 1e-3, "lloyd", 10.0),
]


def check_strip(ratio, cells, thickness, family, gammas):
    shell, unit, free, tip = strip(ratio, cells, thickness, family)
    for gamma in gammas:
        gravity = (0.0, 0.0, -gamma * unit)
        answer = DiscreteShell(shell).equilibrium(gravity=gravity)
        assert answer.converged
        assert answer.status == "converged"
        assert answer.iterations < 80
        load = shell.gravity_force(gravity)
        assert out_of_balance(shell, answer.positions, load) < max(1e-6, rounding(shell, answer.positions, load))
        np.testing.assert_array_equal(answer.positions[shell.clamped], shell.rest_positions[shell.clamped])
        row = next(row for key, row in ELASTICA.items() if np.isclose(key, gamma, rtol=1e-3))
        drop = -answer.positions[tip, 2].mean() / free
        reach = 1.0 - (1.0 - answer.positions[tip, 0].mean()) / free
        assert drop == pytest.approx(float(row["H_over_L"]), rel=FAMILY_TOLERANCE[family])
        assert reach == pytest.approx(float(row["W_over_L"]), abs=FAMILY_TOLERANCE[family])


@pytest.mark.by_default("0.25-cells3-0.01-equilateral-50.0")
@pytest.mark.parametrize(("ratio", "cells", "thickness", "family", "gamma"), QUICK)
def test_strips_drop_as_the_heavy_elastica(ratio, cells, thickness, family, gamma):
    check_strip(ratio, cells, thickness, family, [gamma])


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILY_TOLERANCE)
@pytest.mark.parametrize(("ratio", "cells", "thickness"), STRIPS)
def test_the_whole_elastica_table(ratio, cells, thickness, family):
    check_strip(ratio, cells, thickness, family, [0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0])


@pytest.mark.slow
def test_the_copied_elastica_rows_solve_their_equation():
    """theta'' = -Gamma (1 - s) cos(theta), clamped and free: integrated anew from the tabulated tip angle."""
    for gamma, row in ELASTICA.items():
        s = np.linspace(1.0, 0.0, 4001)
        h = s[1] - s[0]
        state = np.array([float(row["theta_tip_rad"]), 0.0, 0.0, 0.0])  # theta, theta', drop, reach, from the tip

        def rate(at, y, gamma=gamma):
            return np.array([y[1], -gamma * (1.0 - at) * np.cos(y[0]), np.sin(y[0]), np.cos(y[0])])

        for at in s[:-1]:
            k1 = rate(at, state)
            k2 = rate(at + h / 2, state + h / 2 * k1)
            k3 = rate(at + h / 2, state + h / 2 * k2)
            k4 = rate(at + h, state + h * k3)
            state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        assert state[0] == pytest.approx(0.0, abs=1e-6)
        assert -state[2] == pytest.approx(float(row["H_over_L"]), abs=1e-6)
        assert -state[3] == pytest.approx(float(row["W_over_L"]), abs=1e-6)


@pytest.mark.parametrize("gamma", [1.0, 10.0, 50.0])
def test_thin_sheets_take_tens_of_iterations(gamma):
    """Membrane over bending stiffness 1e8: the answer is as good as rounding lets it be."""
    shell, unit, free, tip = strip(0.2, (20, 4), 1e-4, "equilateral")
    answer = DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -gamma * unit))
    assert answer.converged
    assert answer.iterations < 80
    row = next(row for key, row in ELASTICA.items() if np.isclose(key, gamma, rtol=1e-3))
    assert -answer.positions[tip, 2].mean() / free == pytest.approx(float(row["H_over_L"]), rel=0.03)


def test_small_loads_give_the_linear_answer():
    shell, unit, free, tip = strip(0.1, (40, 4), 1e-3, "equilateral")
    answer = DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -1e-3 * unit))
    assert answer.converged
    assert -answer.positions[tip, 2].mean() / free == pytest.approx(1e-3 / 8.0, rel=0.03)


# ---- equilibria


@pytest.mark.by_default("gravity0", "gravity2")
@pytest.mark.parametrize("gravity", [(0, 0, -5.0), (0, 0, -20.0), (0, 0, 10.0), (3.0, 5.0, -8.0), (-10.0, 0, 1.0)])
def test_an_equilibrium_is_a_minimum(gravity):
    shell = cantilever((20, 4))
    answer = DiscreteShell(shell).equilibrium(gravity=gravity)
    assert answer.converged
    load = shell.gravity_force(gravity)
    x = answer.positions
    assert out_of_balance(shell, x, load) < 1e-6
    assert answer.residual == pytest.approx(out_of_balance(shell, x, load), rel=0.1, abs=1e-11)
    assert lowest_tangent_eigenvalue(shell, x) > 0

    def potential(y):
        return shell.energy(y) - np.vdot(load, y - shell.rest_positions)

    rng = np.random.default_rng(0)
    free = (~shell.clamped)[:, None]
    vectors = np.linalg.eigh(shell.stiffness(x).toarray()[np.ix_(shell.free_unknowns, shell.free_unknowns)])[1]
    soft = np.zeros((5, x.size))
    soft[:, shell.free_unknowns] = vectors[:, :5].T
    directions = [rng.standard_normal(x.shape) * free for _ in range(5)] + list(soft.reshape(5, *x.shape))
    for direction in directions:
        direction = direction / np.abs(direction).max()
        for size in (1e-3, -1e-3, 1e-4, -1e-4):
            assert potential(x + size * direction) > potential(x)


@pytest.mark.parametrize("scene", ["strip", "v_beam"])
def test_a_warped_start_gives_the_same_answer(scene):
    if scene == "strip":
        shell, unit, *_ = strip(0.25, (18, 4), 1e-2, "equilateral")
        gravity = (0.0, 0.0, -10.0 * unit)
    else:
        shell, gravity = cantilever((20, 4)), (0.0, 0.0, -8.0)
    warped = ModalWarping(solve_modes(shell, 8)).equilibrium(gravity=gravity)
    cold = DiscreteShell(shell).equilibrium(gravity=gravity)
    warm = DiscreteShell(shell).equilibrium(gravity=gravity, start=warped.positions)
    assert cold.converged
    assert warm.converged
    np.testing.assert_allclose(warm.positions, cold.positions, rtol=0, atol=1e-6)
    again = DiscreteShell(shell).equilibrium(gravity=gravity, start=cold.positions)
    assert again.iterations <= 2
    np.testing.assert_allclose(again.positions, cold.positions, rtol=0, atol=1e-8)


def test_a_start_may_not_move_the_supports():
    shell = cantilever((20, 4))
    start = shell.rest_positions + 0.01
    answer = DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -5.0), start=start)
    cold = DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -5.0))
    np.testing.assert_array_equal(answer.positions[shell.clamped], shell.rest_positions[shell.clamped])
    np.testing.assert_allclose(answer.positions, cold.positions, rtol=0, atol=1e-6)


def test_gravity_and_force_add_up():
    shell = cantilever((20, 4))
    by_gravity = DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -6.0))
    half = shell.gravity_force((0.0, 0.0, -3.0))
    both = DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -3.0), force=half)
    np.testing.assert_allclose(both.positions, by_gravity.positions, rtol=0, atol=1e-9)


def test_equilibrium_does_not_depend_on_the_frame():
    """Turned scene, turned answer."""
    mesh = v_beam(length=1.0, width=0.2, fold=150.0, cells=(12, 4))
    clamped = mesh.vertices[:, 0] < 0.09
    turn = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    answer = DiscreteShell(Shell(mesh, PLAIN, clamped)).equilibrium(gravity=(1.0, 2.0, -8.0))
    turned_mesh = type(mesh)(mesh.vertices @ turn.T, mesh.faces)
    turned = DiscreteShell(Shell(turned_mesh, PLAIN, clamped)).equilibrium(gravity=turn @ (1.0, 2.0, -8.0))
    np.testing.assert_allclose(turned.positions, answer.positions @ turn.T, rtol=0, atol=1e-7)


# ---- buckling


@pytest.mark.parametrize("gamma", [4.0, 7.4])
def test_a_low_column_stands(gamma):
    """A heavy column buckles at Gamma = 7.837 (Greenhill)."""
    shell, unit, _, tip = strip(0.2, (20, 4), 1e-2, "equilateral")
    answer = DiscreteShell(shell).equilibrium(gravity=(-gamma * unit, 0.0, 0.0))
    assert answer.converged
    assert np.abs(answer.positions[tip, 2]).max() < 1e-6
    assert lowest_tangent_eigenvalue(shell, answer.positions) > 0


@pytest.mark.slow
@pytest.mark.parametrize("gamma", [8.3, 12.0])
def test_a_high_column_buckles(gamma):
    shell, unit, free, tip = strip(0.2, (20, 4), 1e-2, "equilateral")
    answer = DiscreteShell(shell).equilibrium(gravity=(-gamma * unit, 0.0, 0.0))
    assert answer.converged
    assert np.abs(answer.positions[tip, 2]).min() > 0.1 * free
    assert lowest_tangent_eigenvalue(shell, answer.positions) > 0


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.9, 1.1, 2.0, 8.0, 30.0])
def test_converged_never_means_a_saddle(share):
    """A strut under an end load, in multiples of Euler's: straight is an equilibrium always, a minimum below one."""
    shell, _, free, tip = strip(0.2, (20, 4), 1e-2, "equilateral")
    critical = np.pi**2 * (YOUNG * 1e-6 / 12.0) * 0.2 / (4.0 * free**2)
    force = np.zeros_like(shell.rest_positions)
    force[tip, 0] = -share * critical / tip.size
    answer = DiscreteShell(shell).equilibrium(force=force)
    stable = lowest_tangent_eigenvalue(shell, answer.positions) > 0
    assert stable or not answer.converged
    if share < 1.0:
        assert answer.converged
        assert np.abs(answer.positions[tip, 2]).max() < 1e-6


# ---- what has no answer


@pytest.mark.usefixtures("_time_limit")
@pytest.mark.parametrize(
    "loads", [{}, {"gravity": (0.0, 0.0, 0.0)}, "zero force", "force on the supports alone"], ids=str
)
def test_no_load_is_rest(loads):
    shell = cantilever((20, 4))
    if loads == "zero force":
        loads = {"force": np.zeros_like(shell.rest_positions)}
    elif loads == "force on the supports alone":
        loads = {"force": np.where(shell.clamped[:, None], (1.0, 2.0, 3.0), 0.0)}
    answer = DiscreteShell(shell).equilibrium(**loads)
    assert answer.converged
    np.testing.assert_allclose(answer.positions, shell.rest_positions, rtol=0, atol=1e-12)


@pytest.mark.usefixtures("_time_limit")
def test_no_load_from_a_bent_start_is_rest():
    shell = cantilever((20, 4))
    start = DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -3.0)).positions
    answer = DiscreteShell(shell).equilibrium(start=start)
    assert answer.converged
    np.testing.assert_allclose(answer.positions, shell.rest_positions, rtol=0, atol=1e-6)


@pytest.mark.by_default("1e-300", "1e-30")
@pytest.mark.usefixtures("_time_limit")
@pytest.mark.parametrize("gravity", [1e-300, 1e-30, pytest.param(1e6, marks=pytest.mark.slow), 1e49])
def test_absurd_loads_come_back(gravity):
    shell = cantilever((20, 4))
    answer = DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -gravity))
    assert np.isfinite(answer.positions).all()
    assert answer.converged == (answer.status == "converged")
    if gravity < 1.0:
        assert answer.converged
        np.testing.assert_allclose(answer.positions, shell.rest_positions, rtol=0, atol=1e-12)


@pytest.mark.usefixtures("_time_limit")
def test_a_pushed_free_shell_has_no_equilibrium():
    answer = DiscreteShell(leaf((6, 4))).equilibrium(gravity=(0.0, 0.0, -1.0))
    assert not answer.converged
    assert answer.status != "converged"
    assert answer.residual == pytest.approx(1.0, rel=0.1)


@pytest.mark.usefixtures("_time_limit")
def test_a_collapsed_start_is_no_trap():
    shell = cantilever((20, 4))
    start = np.zeros_like(shell.rest_positions)
    answer = DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -5.0), start=start)
    cold = DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -5.0))
    assert answer.converged
    np.testing.assert_allclose(answer.positions, cold.positions, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    "options",
    [
        {"gravity": (0.0, 0.0)},
        {"gravity": (0.0, np.nan, 0.0)},
        {"force": np.zeros((2, 3))},
        {"gravity": (0.0, 0.0, -1.0), "start": np.zeros((2, 3))},
        {"gravity": (0.0, 0.0, -1.0), "start": "here"},
    ],
    ids=repr,
)
def test_bad_loads_are_refused(options):
    with pytest.raises(LoadError):
        DiscreteShell(cantilever((20, 4))).equilibrium(**options)


@pytest.mark.parametrize("integrator", ["rk4", None, 3])
def test_unknown_integrators_are_refused(integrator):
    with pytest.raises(OptionError, match="integrator"):
        DiscreteShell(cantilever((20, 4)), integrator=integrator)
