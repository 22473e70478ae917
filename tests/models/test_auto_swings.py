"""The model that switches itself under a load that swings: it comes back to its cheapest rung, and seldom checks it."""

import re
from itertools import groupby

import numpy as np
import pytest

import modalshell as ms
from modalshell.integrators.state import MotionState
from modalshell.models.auto.account import level_note
from modalshell.models.auto.stepper import AutoStepper
from modalshell.models.auto.watching import Watch
from modalshell.models.base.setup import MotionSetup
from modalshell.motion.stepping import Motion
from modalshell.shell.damping import Damping

SHEET = ms.Isotropic(young=1e8, poisson=0.3, thickness=5e-3, density=100.0)
PERIOD = 39
"""Steps in a period of the load, of thirty in one of the lowest mode."""


@pytest.fixture(scope="module")
def strip():
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(16, 4))
    return ms.Shell(mesh, SHEET, "x < 1e-6")


def swinging(shell, size, steps):
    """A setting in which the linear answer to the largest load is ``size`` of the shell's."""
    basis = ms.solve_modes(shell, 8)
    omega = float(np.sqrt(basis.eigenvalues[0]))
    moved = ms.LinearModal(basis).equilibrium(gravity=(0, 0, -1)).positions - shell.rest_positions
    dt, most = 2.0 * np.pi / omega / 30, size * shell.size / np.linalg.norm(moved, axis=1).max()
    times = dt * np.arange(steps + 2)
    factors = most * np.sin(2.0 * np.pi / PERIOD * np.arange(steps + 2))
    load = ms.Scaled(ms.SelfWeight((0, 0, -1)), (times.tolist(), factors.tolist()))
    return {"duration": steps * dt, "dt": dt, "loads": [load], "damping": (0.2 * omega, 0.0)}


def checks_of(monkeypatch, shell, setting):
    """The run, and the numbers of checks of its modal levels."""
    count, checked = [0], Watch.checked

    def counted(self, step, memory):
        count[0] += 1
        return checked(self, step, memory)

    with monkeypatch.context() as patch:
        patch.setattr(Watch, "checked", counted)
        run = ms.simulate(ms.Auto(shell, 8), **setting)
    return run, count[0]


def worst(shell, run, exact):
    off, moved = (
        np.sqrt(np.sum(shell.mass[:, None] * part**2, axis=(1, 2)))
        for part in (run.positions - exact.positions, exact.positions - shell.rest_positions)
    )
    return off.max() / moved.max()


def test_damping_by_the_stiffness_is_no_reason_to_leave_a_rung(strip):
    setting = swinging(strip, 0.02, 120)
    damped = setting["damping"][0] / float(ms.solve_modes(strip, 1).eigenvalues[0])
    run = ms.simulate(ms.Auto(strip, 8), **setting | {"damping": (0.0, damped)})
    assert run.message == "steps by MWTS 100 %"


@pytest.mark.slow
def test_what_all_rungs_of_modes_lack_at_first_is_no_reason_to_leave_one(strip, monkeypatch):
    """At first modes lack more of what has hardly moved than they may; another rung of them lacks as much.

    Checks come every five steps here: others wait, as statics has vouched for the swing.
    """
    setting, levels = swinging(strip, 0.03, 120), []
    for alike in (AutoStepper._moves_alike, lambda *_: False):
        monkeypatch.setattr(AutoStepper, "_moves_alike", alike)
        run = ms.simulate(ms.Auto(strip, 8, check_every=5), **setting)
        levels.append(set(run.levels))
        assert worst(strip, run, ms.simulate(ms.DiscreteShell(strip), **setting)) < 0.03
    assert levels == [{"MWTS"}, {"MWTS", "RSW"}]


@pytest.mark.slow
def test_the_second_rung_hands_back_to_the_first(strip):
    """Half a swing is too wide for the first; between two of these it serves."""
    setting = swinging(strip, 0.07, 120)
    run = ms.simulate(ms.Auto(strip, 8), **setting)
    assert [level for level, _ in groupby(run.levels)] == ["MWTS", "RSW", "MWTS", "RSW"]
    assert worst(strip, run, ms.simulate(ms.DiscreteShell(strip), **setting)) < 0.05


def test_states_found_right_with_little_room_are_checked_seldom(strip, monkeypatch):
    """Every five steps would be 60 checks."""
    run, count = checks_of(monkeypatch, strip, swinging(strip, 0.05, 300))
    assert run.levels.count("MWTS") > 270
    assert count < 20


def test_a_motion_restored_while_its_load_is_known_goes_on_with_the_same_bits(strip):
    """By the same model, and by another that has seen nothing."""
    setting, states = swinging(strip, 0.03, 200), []
    dt, damping = setting["dt"], setting["damping"]
    first, second = (
        Motion(ms.Auto(strip, 8), strip.loading(None, None, setting["loads"]), dt=dt, damping=damping) for _ in range(2)
    )
    for _ in range(60):
        first.advance()
    snapshot = {name: array.copy() for name, array in first.snapshot().items()}
    second.restore(snapshot)
    for motion in (first, second):
        for _ in range(60):
            motion.advance()
        states.append(motion.snapshot())
    first.restore(snapshot)
    for _ in range(60):
        first.advance()
    states.append(first.snapshot())
    for name, array in states[0].items():
        assert np.array_equal(array, states[1][name]), name
        assert np.array_equal(array, states[2][name]), name
    assert states[0]["state_level"][0] == 0


def test_a_load_that_outgrows_its_table_of_times_is_looked_at(strip):
    """A function of time says nothing of its largest factor: growing without end, it takes the motion to DS."""
    setting = swinging(strip, 0.03, 120)
    most = setting["loads"][0].factor(PERIOD // 4 * setting["dt"])
    growing = ms.Scaled(ms.SelfWeight((0, 0, -1)), lambda time: 40.0 * most * time / setting["duration"])
    run = ms.simulate(ms.Auto(strip, 8), **setting | {"loads": [growing]})
    assert run.levels[2] == "MWTS"
    assert run.levels[-1] == "DS"


def test_discrete_shells_take_over_from_a_coarse_one_without_its_shape_between_vertices():
    """Handed over as it is, the fold of this V-beam would have a tenth more energy by DS."""
    thin = ms.Isotropic(young=1e8, poisson=0.3, thickness=2e-3, density=100.0)
    shell, coarse = (
        ms.Shell(ms.v_beam(length=1.0, width=0.25, fold=100.0, cells=cells), thin, "x < 1e-6")
        for cells in ((24, 8), (16, 4))
    )
    loads = [ms.Scaled(ms.SelfWeight((0.0, 0.0, -9.0)), ([0.0, 0.2, 1.0], [0.0, 0.2, 1.0]))]
    run = ms.simulate(ms.Auto(shell, coarse=coarse), duration=0.15, dt=1 / 60, damping=(0.5, 1e-3), loads=loads)
    switch = re.search(r"to DS at 0\.1 s \(.* from DS; its energy changed by ([+-][\d.]+) %\)", run.message)
    assert switch is not None
    assert abs(float(switch[1])) < 2.0


def test_discrete_shells_take_over_from_modes_with_about_the_energy_of_these():
    """Three short steps left an arch bent along its plane six times the energy, in vibrations of its membrane."""
    sheet = ms.sheet(length=1.0, width=0.3, cells=(12, 4))
    vertices = sheet.vertices.copy()
    angles = 1.2 * vertices[:, 0]
    vertices[:, 0], vertices[:, 2] = np.sin(angles) / 1.2, np.cos(angles) / 1.2
    stiff = ms.Isotropic(young=1e8, poisson=0.3, thickness=0.01, density=1000.0)
    arch = ms.Shell(ms.TriangleMesh(vertices, sheet.faces), stiff, "x < 1e-6")
    auto = ms.Auto(arch, 6)
    modal, full, mode = auto.levels[0].still, len(auto.levels) - 1, auto.basis.modes[:, 0]
    q = 0.3 / np.abs(mode).max() * np.eye(6)[0]
    x, dt = modal.warped_positions(q), 1.0 / auto.basis.frequencies[0] / 120
    steps = AutoStepper(auto, auto.levels, MotionSetup(dt, Damping(), arch.loading()))
    begun = auto.levels[full].entered(steps._stepper(full), x, np.zeros_like(x), 0.0)
    slack = steps._without_stretch(full, begun, 0.0)
    assert arch.energy(x) > 50.0 * modal.elastic_energy(MotionState(q, q))
    assert arch.energy(slack.coordinates) < 1.1 * modal.elastic_energy(MotionState(q, q))


@pytest.mark.parametrize(
    ("gained", "said"), [(1.0, "+100 %"), (-0.2345, "-23 %"), (0.00123, "+0.12 %"), (12.3, "+1230 %")]
)
def test_changes_of_energy_are_said_without_powers_of_ten(gained, said):
    memory = {"steps": np.array([0.0, 4.0]), "log": np.zeros((1, 6)), "switches": np.ones(1)}
    memory["log"][0, 5] = gained
    note = level_note(MotionState(np.zeros(1), np.zeros(1), memory), ("DS", "MWTS"))
    assert f"; its energy changed by {said})" in note


@pytest.mark.slow
def test_states_on_the_way_to_rest_and_those_with_much_room_are_checked_seldom(monkeypatch):
    """A bar at rest under a load that stays vouches for what is no larger, though it has little room."""
    sheet = ms.Isotropic(young=2e9, poisson=0.3, thickness=2e-3, density=1000.0)
    plate = ms.Shell(ms.sheet(length=1.0, width=1.0, cells=(8, 8), family="alternating"), sheet, "x < 1e-6")
    checked, every = [], Watch.checked

    def noted(self, step, memory):
        checked.append(int(memory["steps"].sum()))
        return every(self, step, memory)

    monkeypatch.setattr(Watch, "checked", noted)
    setting = {"duration": 205.0 / 60.0, "dt": 1.0 / 60.0, "gravity": (0, 0, -0.145), "damping": (0.5, 1e-4)}
    run = ms.simulate(ms.Auto(plate), **setting)
    assert set(run.levels) == {"MWTS"}
    assert checked[0] > 20  # it gets to its shape at rest in about thirty steps
    assert 1 <= sum(20 < step <= 60 for step in checked) <= 4  # it swings beyond
    assert not any(60 < step < 200 for step in checked)  # what has been seen has room: after 160 steps, not 20 and 40
    ds = ms.simulate(ms.DiscreteShell(plate), **(setting | {"duration": 1.0}))
    off, moved = (np.abs(run.positions[:61, :, 2] - other).max() for other in (ds.positions[..., 2], 0.0))
    assert off < 0.04 * moved
