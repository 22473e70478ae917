"""The model that switches itself: it holds the error asked for, says what it did, and resumes to the same bits."""

from functools import partial

import numpy as np
import pytest
from scenes import stiff_beam_text, stopped_and_resumed

import modalshell as ms
from modalshell.compare.candidates import candidates
from modalshell.compare.case import Case
from modalshell.core.outcome import Outcome
from modalshell.loads import Loading
from modalshell.models.auto import loads_ahead, watching
from modalshell.models.auto.account import energy_change
from modalshell.models.auto.answered import LinearAnswers, solver_at_rest
from modalshell.models.auto.checks import HeldCheck
from modalshell.models.auto.levels import FullLevel
from modalshell.models.auto.trusted import KnownStates
from modalshell.models.base.setup import MotionSetup
from modalshell.motion.stepping import Motion
from modalshell.shell.damping import Damping
from studies import blind_motions

DT = 1.0 / 60.0
SCENE = (
    stiff_beam_text()
    + """[loads]
gravity = [0.0, 3.0, -45.0]
[model]
name = "auto"
modes = 6
error = 0.04
[motion]
duration = 0.6
dt = 0.0166
damping = [2.0, 0.001]
"""
)


@pytest.fixture(scope="module")
def beam():
    mesh = ms.v_beam(length=1.0, width=0.2, fold=150.0, cells=(20, 4))
    return ms.Shell(mesh, ms.Material(2000.0, 2000.0, 0.05, 0.2), "x < 0.051")


def through_snap(model, most=60.0):
    """Up past the load at which DS snaps, 41.5, and down."""
    load = [ms.Scaled(ms.SelfWeight((0.0, 0.26, -0.97)), ([0.0, 1.2, 2.2], [0.0, most, 0.0]))]
    return ms.simulate(model, duration=3.0, dt=DT, loads=load, damping=(2.0, 0.001))


def worst(shell, run, exact):
    mass = shell.mass[:, None]
    off, moved = (
        np.sqrt(np.sum(mass * part**2, axis=(1, 2)))
        for part in (run.positions - exact.positions, exact.positions - shell.rest_positions)
    )
    return float(off.max() / moved.max())


@pytest.fixture(scope="module")
def snapping(beam):
    """The motion by DS."""
    return through_snap(ms.DiscreteShell(beam))


@pytest.mark.slow
def test_it_holds_the_error_through_a_snap_where_its_cheapest_rung_is_lost(beam, snapping):
    auto, exact = ms.Auto(beam, 6, error=0.05, check_every=10), snapping
    cheap = through_snap(ms.ModalWarping(ms.solve_modes(beam, 6), consistent_force=True))
    run = through_snap(auto)
    assert worst(beam, cheap, exact) > 0.5
    assert worst(beam, run, exact) < 0.05
    assert len(run.levels) == len(run.times)
    shares = {name: run.levels.count(name) / len(run.levels) for name in auto.level_names}
    assert 0.2 < shares["MWTS"] < 0.9
    assert shares["DS"] > 0.1
    assert "steps by MWTS" in run.message
    assert "to DS at 0." in run.message
    assert "its energy changed by" in run.message
    assert abs(run.damping_error) < 0.02


@pytest.mark.slow
def test_where_the_cheapest_rung_serves_nothing_else_is_taken(beam):
    run = through_snap(ms.Auto(beam, 6, check_every=15), most=15.0)
    assert set(run.levels) == {"MWTS"}
    assert run.message == "steps by MWTS 100 %"


@pytest.mark.slow
def test_a_better_rung_of_modes_takes_over_where_the_margin_holds():
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(20, 4))
    strip = ms.Shell(mesh, ms.Material(2000.0, 2000.0, 0.05, 0.2), "x < 0.051")
    run, exact = through_snap(ms.Auto(strip), most=12.0), through_snap(ms.DiscreteShell(strip), most=12.0)
    assert set(run.levels) == {"MWTS", "RSW"}
    assert worst(strip, run, exact) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize(("cells", "check_every", "taken"), [((10, 2), 5, True), ((14, 2), 25, False)])
def test_a_coarse_shell_makes_a_level_between_that_is_left_before_it_snaps(beam, snapping, cells, check_every, taken):
    """It snaps under another load: through the snap the second one takes positions 14 % of the displacement off."""
    coarse = ms.coarse_shell(beam, ms.v_beam(length=1.0, width=0.2, fold=150.0, cells=cells))
    auto = ms.Auto(beam, 6, coarse=coarse, check_every=check_every)
    assert auto.level_names == ("MWTS", "RSW", "coarse DS", "DS")
    run = through_snap(auto)
    assert {"MWTS", "DS"} <= set(run.levels)
    assert ("coarse DS" in run.levels) == taken
    assert worst(beam, run, snapping) < 0.02


@pytest.mark.slow
def test_a_shell_that_falls_at_once_is_checked_as_it_moves():
    """Every 40 steps would be too late: what grows by half is checked at once."""
    mesh = ms.leaf(cells=(16, 6))
    leaf = ms.Shell(mesh, ms.Material(20.0, 20.0, 0.05, 0.2), mesh.vertices[:, 0] < mesh.vertices[:, 0].min() + 0.07)
    run, exact = (
        ms.simulate(model, duration=1.0, dt=1 / 30, gravity=(0.0, 0.0, -20.0), damping=(1.0, 0.001))
        for model in (ms.Auto(leaf, 6, check_every=40), ms.DiscreteShell(leaf))
    )
    assert len(set(run.levels)) > 1
    assert np.abs(exact.positions - mesh.vertices).max() > 0.3
    assert worst(leaf, run, exact) < 0.05


@pytest.mark.slow
def test_coordinates_that_checks_were_sure_of_are_checked_seldom(monkeypatch):
    """A swing stays where it was checked, until a second load bends the strip another way."""
    checked, bar_under = [], HeldCheck.bar_under

    def counted(self, times, frames, dead):
        checked.append(times[2])
        return bar_under(self, times, frames, dead)

    monkeypatch.setattr(HeldCheck, "bar_under", counted)
    sheet = ms.Isotropic(2e11, 0.3, 0.002, 7850.0)
    strip = ms.Shell(ms.flat_beam(length=1.0, width=0.2, cells=(10, 2)), sheet, "x < 0.001")
    period = 2.0 * np.pi / np.sqrt(ms.solve_modes(strip, 1).eigenvalues[0])
    course = [0.0, 8.0 * period, 8.5 * period], [0.0, 0.0, 1.0]
    twist = [
        ms.Scaled(ms.PointForce(f"nearest(1, {y}, 0)", (0.0, 0.0, force)), course)
        for y, force in ((-0.1, 6), (0.1, -6))
    ]
    loads = [ms.SelfWeight((0.0, 0.0, -0.3)), *twist]
    setting = {"duration": 10.0 * period, "dt": period / 30.0, "loads": loads, "damping": (0.1 / period, 0.0)}
    runs = [ms.simulate(model, **setting) for model in (ms.Auto(strip), ms.DiscreteShell(strip))]
    assert set(runs[0].levels) == {"MWTS"}
    assert worst(strip, *runs) < 0.05
    count = np.bincount((np.array(checked) / period).astype(int), minlength=10)
    assert 1 <= count[:2].sum() <= 3  # the statics that was looked at first vouches for the swing about it
    assert count[2:8].sum() <= 4  # of 36 intervals, and ever more seldom
    assert count[8:].sum() >= 1  # of 15: the shape is new; a small bar vouches for twice its size
    checked.clear()
    ms.simulate(ms.Auto(strip, check_every=5), **setting)
    assert len(checked) >= 60  # a number that is given is that number


def under_a_push(model, thickness, most):
    """A strip of little weight that is pushed along itself, ever more: past where it buckles."""
    shell = model.shell
    tip = int(np.argmax(shell.rest_positions[:, 0] + 0.01 * shell.rest_positions[:, 1]))
    period = 2.0 * np.pi / np.sqrt(ms.solve_modes(shell, 1).eigenvalues[0])
    buckling = np.pi**2 / 4.0 * 1e8 * 0.2 * thickness**3 / 12.0
    course = [0.0, 4.0 * period, 10.0 * period], [0.0, 0.0, most * buckling]
    loads = [ms.SelfWeight((0.0, 0.0, -0.005)), ms.Scaled(ms.PointForce([tip], (-1.0, 0.0, 0.0)), course)]
    return ms.simulate(model, duration=10.0 * period, dt=period / 30.0, loads=loads, damping=(0.5 / period, 0.0))


@pytest.mark.slow
def test_a_load_that_no_mode_feels_is_part_of_what_is_known(monkeypatch):
    """The weight alone is known for ever; a push along the strip buckles it from the same coordinates."""
    thickness = 0.005
    strip = ms.Shell(
        ms.flat_beam(length=1.0, width=0.2, cells=(12, 2)), ms.Isotropic(1e8, 0.3, thickness, 200.0), "x < 0.001"
    )
    runs = [under_a_push(model, thickness, 1.3) for model in (ms.Auto(strip), ms.DiscreteShell(strip))]
    assert "DS" in runs[0].levels
    assert worst(strip, *runs) < 0.05
    monkeypatch.setattr(KnownStates, "holds", lambda *_: True)
    monkeypatch.setattr(KnownStates, "is_sudden", lambda *_: False)
    monkeypatch.setattr(loads_ahead, "along", lambda *_: 1.0)
    monkeypatch.setattr(watching, "RARER", 1e9)
    assert worst(strip, under_a_push(ms.Auto(strip), thickness, 1.3), runs[1]) > 0.05


@pytest.mark.by_default("1e-156")
@pytest.mark.parametrize("weight", [1e-150, 1e-156])
def test_weights_of_almost_nothing_move_it(weight):
    sheet = ms.Isotropic(2e11, 0.3, 0.002, 7850.0)
    strip = ms.Shell(ms.flat_beam(length=1.0, width=0.2, cells=(6, 2)), sheet, "x < 0.001")
    run = ms.simulate(ms.Auto(strip), duration=0.5, dt=DT, gravity=(0.0, 0.0, -weight))
    assert run.outcome is Outcome.COMPLETED


@pytest.fixture(scope="module")
def panel():
    mesh = ms.cylinder_panel(length=1.0, radius=1.0, angle=50.0, cells=(8, 6))
    edge = np.abs(mesh.vertices[:, 1]) > np.abs(mesh.vertices[:, 1]).max() - 1e-9
    return ms.Shell(mesh, ms.Isotropic(1e8, 0.3, 0.006, 200.0), supports=[ms.Pin(edge)])


@pytest.mark.slow
def test_a_load_that_the_modes_do_not_answer_starts_on_ds(panel):
    """A sudden pressure snaps the panel, whose modes do not answer it: MWTS would move by nothing."""
    setting = {"duration": 0.3, "dt": DT, "loads": [ms.Pressure(-1500.0)], "damping": (2.0, 0.001)}
    cheap, run, exact = (
        ms.simulate(model, **setting)
        for model in (ms.ModalWarping(ms.solve_modes(panel, 8)), ms.Auto(panel), ms.DiscreteShell(panel))
    )
    assert np.abs(exact.positions - panel.rest_positions).max() > 0.15
    assert worst(panel, cheap, exact) > 0.5
    assert worst(panel, run, exact) < 1e-6
    assert "to DS at 0 s (the modes lack 9" in run.message


@pytest.mark.slow
def test_a_load_is_compared_as_it_changes(beam):
    """A weight that the modes answer, then a force at one corner that they do not."""
    pinch = [ms.Scaled(ms.PointForce("nearest(0.5, 0.1, 0)", (0.0, 0.0, -1.0)), ([0.0, 0.3, 0.32, 1.0], [0, 0, 6, 6]))]
    loads = [ms.SelfWeight((0.0, 0.0, -8.0)), *pinch]
    runs = [
        ms.simulate(model, duration=0.6, dt=0.5 * DT, loads=loads, damping=(2.0, 0.001), store_every=2)
        for model in (ms.Auto(beam, 2, check_every=1000), ms.DiscreteShell(beam))
    ]
    assert runs[0].levels[:17] == ("MWTS",) * 17
    assert "to DS at 0.3" in runs[0].message
    assert "of the linear answer to the load" in runs[0].message
    assert worst(beam, *runs) < 0.01  # with steps as long as frames DS itself is 0.21 off in its snap


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["buckles", "stiffens"])
def test_a_sudden_load_whose_static_answer_is_lost_starts_on_ds(kind):
    """Within few steps modal rungs would be wrong, sooner than a check of the motion comes."""
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(12, 2))
    sheet = ms.Isotropic(1e8, 0.3, 0.005, 200.0)
    if kind == "buckles":
        strip, load = ms.Shell(mesh, sheet, "x < 0.001"), {"loads": [ms.LineForce("x > 0.999", (-20.0, 0.0, 2.0))]}
    else:
        strip = ms.Shell(mesh, sheet, supports=[ms.Clamp("x < 0.001"), ms.Clamp("x > 0.999")])
        load = {"gravity": (0.0, 0.0, -40.0)}
    setting = load | {"duration": 0.4, "dt": DT, "damping": (2.0, 0.0)}
    cheap, run, exact = (
        ms.simulate(model, **setting)
        for model in (
            ms.ModalWarping(ms.solve_modes(strip, 8), consistent_force=True),
            ms.Auto(strip),
            ms.DiscreteShell(strip),
        )
    )
    assert worst(strip, cheap, exact) > 0.2
    assert worst(strip, run, exact) < 0.01
    assert "to DS at 0 s" in run.message


@pytest.mark.slow
def test_a_force_at_once_on_a_thin_plate_leaves_no_false_energy_to_ds():
    """Three frames by a modal rung, before its first check, are so far off that DS would have twice the energy."""
    mesh = ms.flat_beam(length=1.0, width=0.8, cells=(8, 6))
    material = ms.Material.from_physical(young=2e9, poisson=0.3, thickness=0.002, density=1000.0, mesh=mesh)
    plate = ms.Shell(mesh, material, "x < 0.13")
    setting = {"duration": 1.1, "dt": 0.055, "damping": (0.2, 0.0)}
    setting["loads"] = [ms.PointForce([31], (0.0, 0.0, 3.0))]
    run, exact = (ms.simulate(model, **setting) for model in (ms.Auto(plate, 8), ms.DiscreteShell(plate)))
    assert worst(plate, run, exact) < 0.01


def snapped():
    """A shallow panel, and where it rests after its weight has pushed it through its plane."""
    mesh = ms.cylinder_panel(angle=40.0, cells=(6, 12))
    aside = np.abs(mesh.vertices[:, 1])
    shell = ms.Shell(mesh, ms.Material(150.0, 150.0, 0.05, 0.2), aside > aside.max() - 1e-9)
    return shell, ms.DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -320.0)).positions


def rippled():
    """A strip in waves that no mode has, and what a level of few modes makes of it."""
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(20, 4))
    shell = ms.Shell(mesh, ms.Isotropic(1e7, 0.3, 0.005, 100.0), "x < 1e-6")
    x = np.array(shell.rest_positions)
    x[:, 2] = 0.03 * np.sin(8.0 * np.pi * x[:, 0]) * (x[:, 0] > 0.03)
    return shell, x


@pytest.mark.by_default("snapped")
@pytest.mark.parametrize("begun", [snapped, rippled])
def test_a_start_that_the_modes_do_not_hold_begins_on_ds(begun):
    """On MWTS the panel would be back at rest at once, and the strip nearly flat."""
    shell, start = begun()
    setting = {"duration": 0.3, "dt": DT, "start": start, "gravity": (0.0, 0.0, -1e-6), "damping": (2.0, 0.001)}
    cheap, run, exact = (
        ms.simulate(model, **setting)
        for model in (ms.ModalWarping(ms.solve_modes(shell, 8)), ms.Auto(shell), ms.DiscreteShell(shell))
    )
    assert worst(shell, cheap, exact) > 0.3
    assert worst(shell, run, exact) < 0.03
    assert run.levels[1] == "DS"
    assert "to DS at 0 s (the modes are " in run.message
    assert "off the start" in run.message


def test_a_start_that_modes_hold_begins_on_them():
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(20, 4))
    shell = ms.Shell(mesh, ms.Isotropic(1e7, 0.3, 0.005, 100.0), "x < 1e-6")
    for gravity, level in ((0.1, "MWTS"), (0.3, "RSW")):
        start = ms.DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -gravity)).positions
        run = ms.simulate(ms.Auto(shell), duration=0.1, dt=DT, start=start, gravity=(0.0, 0.0, -gravity))
        assert run.levels[1:] == (level,) * (len(run.levels) - 1)
        assert ("to RSW at 0 s (the modes are 2" in run.message) == (level == "RSW")


def test_the_resting_load_of_a_modal_state_holds_it(beam):
    auto = ms.Auto(beam)
    level, bent = auto.levels[0], np.array(beam.gravity_force((0.0, 2.0, -6.0)))
    x = level.model.equilibrium(force=bent).positions
    stepper = level.model.stepper(MotionSetup(DT, Damping(), Loading(beam.rest_positions, bent)))
    state = level.entered(stepper, x, np.zeros_like(x), 0.0)
    load = level.resting_load(stepper, state)
    assert not np.allclose(load, bent, rtol=0.1, atol=0.1 * np.abs(bent).max())  # the least of many
    again = level.model.equilibrium(force=load, start=x).positions
    assert ms.measure.displacement_error(again, x, beam) < 1e-6


def test_a_rung_that_errs_alike_is_passed_by(monkeypatch):
    """A plate whose two modal rungs lack the same: by RSW, five steps more, it would be 8 % off."""
    monkeypatch.setattr(blind_motions, "rungs", lambda shell, _: {"auto": ms.Auto(shell, 8, error=0.05)})
    found = blind_motions.of_motion(25)["models"]["auto"]
    assert {"MWTS", "DS"} == set(found["levels"])
    assert found["worst"] < 0.03


def test_linear_answers_lack_what_no_mode_moves(beam):
    basis = ms.solve_modes(beam, 6)
    answers = LinearAnswers(basis, partial(solver_at_rest, beam))
    mass = np.repeat(beam.mass, 3)
    own = mass * (basis.modes @ (basis.eigenvalues * [1.0, 2.0, 0.0, 0.5, 0.0, 1.0]))
    whole, missing = answers.of(own.reshape(-1, 3))
    assert whole == pytest.approx(2.5, rel=1e-8)  # modes have unit mass
    assert missing < 1e-8
    further = ms.solve_modes(beam, 7)
    other = 3.0 * mass * further.modes[:, 6] * further.eigenvalues[6]
    assert answers.of((own + other).reshape(-1, 3)) == pytest.approx((np.sqrt(2.5**2 + 9.0), 3.0), rel=1e-8)
    memory = {"pushed": np.zeros_like(beam.rest_positions), "answer": np.zeros(2), "ahead": np.ones(1)}
    assert answers.following(np.zeros_like(beam.rest_positions), memory) == (0.0, 0.0)
    assert answers.following(other.reshape(-1, 3), memory) == pytest.approx((3.0, 3.0), rel=1e-8)
    assert answers.following(-2.0 * other.reshape(-1, 3), memory) == pytest.approx((6.0, 6.0), rel=1e-8)
    assert np.array_equal(memory["pushed"], other.reshape(-1, 3))
    sums = answers.of_sums([own.reshape(-1, 3), other.reshape(-1, 3)])
    assert sums.of(np.array([2.0, -1.0])) == pytest.approx((np.sqrt(25.0 + 9.0), 3.0), rel=1e-8)
    assert sums.of(np.zeros(2)) is None
    assert answers.following((own + other).reshape(-1, 3), memory)[1] == pytest.approx(3.0, rel=1e-8)


@pytest.mark.slow
def test_statics_is_corrected_where_the_bar_is_small_and_ds_elsewhere(beam):
    auto, truth = ms.Auto(beam, 6), ms.DiscreteShell(beam)
    for gravity, told in ((10.0, "MWTS, corrected: it was 0."), (37.0, "DS, as MWTS was void"), (60.0, "DS, as MWTS")):
        load = {"gravity": (0.0, 0.26 * gravity, -0.97 * gravity)}
        answer, exact = auto.equilibrium(**load), truth.equilibrium(**load)
        assert told in answer.message
        assert answer.converged
        assert ms.measure.displacement_error(answer.positions, exact.positions, beam) < 1e-3


@pytest.mark.slow
def test_shells_far_from_the_origin_move_alike(beam):
    far = np.array([4096.0, 0.0, -2048.0])
    moved = ms.TriangleMesh(beam.mesh.vertices + far, beam.mesh.faces)
    other = ms.Shell(moved, beam.material, np.flatnonzero(beam.clamped))
    runs = [
        ms.simulate(ms.Auto(shell, 6, error=0.02), duration=0.6, dt=DT, gravity=(0.0, 5.0, -30.0), damping=(2.0, 0.0))
        for shell in (beam, other)
    ]
    assert "DS" in runs[0].levels
    assert runs[0].levels == runs[1].levels
    assert runs[1].positions - far == pytest.approx(runs[0].positions, abs=1e-6)
    assert runs[1].energies == pytest.approx(runs[0].energies, abs=1e-3 * np.abs(runs[0].energies).max())


@pytest.mark.slow
def test_a_scene_that_was_stopped_resumes_to_the_same_bits(tmp_path):
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE)
    whole, resumed = stopped_and_resumed(scene, tmp_path, 25)
    assert len(set(whole.trajectory.levels)) > 1
    assert resumed.resumed > 20
    assert np.array_equal(resumed.trajectory.positions, whole.trajectory.positions)
    assert resumed.trajectory.levels == whole.trajectory.levels
    assert resumed.trajectory.message == whole.trajectory.message


def test_the_damping_of_its_steps_is_the_mean_of_its_levels(beam):
    auto = ms.Auto(beam, 6)
    state, number = auto.start_motion(), (50.0, 0.3, DT)
    assert np.isnan(auto.mean_growth(state, *number))
    state.memory["steps"][:] = 3.0, 0.0, 1.0
    modal, _, full = (level.model.growth(*number) for level in auto.levels)
    assert modal != full
    assert auto.mean_growth(state, *number) ** 4 == pytest.approx(modal**3 * full)
    swing = {"duration": 1.0, "dt": DT, "gravity": (0.0, 0.0, -0.1), "damping": (0.5, 0.0)}
    runs = [ms.simulate(model, **swing) for model in (auto, auto.levels[0].model)]
    assert set(runs[0].levels) == {"MWTS"}
    assert runs[0].damping_error == pytest.approx(runs[1].damping_error, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("sheet", [False, True])
def test_compiled_steps_of_its_last_level_are_those_of_ds(sheet):
    """Through a snap; under loads that follow the shell it is DS itself."""
    mesh = ms.v_beam(length=1.0, width=0.2, fold=150.0, cells=(14, 4))
    material = ms.Isotropic(1e8, 0.3, 1e-3, 200.0) if sheet else ms.Material(2000.0, 2000.0, 0.05, 0.2)
    shell = ms.Shell(mesh, material, "x < 0.08")
    exact, most = ms.DiscreteShell(shell), 12.0 if sheet else 90.0
    growing = [ms.Scaled(ms.SelfWeight((0.0, 0.26, -0.97)), ([0.0, 0.5], [0.0, most]))]
    setup = MotionSetup(DT, Damping(2.0, 0.001), shell.loading(None, None, growing))
    steppers = [FullLevel(exact).stepper(setup), exact.stepper(setup)]
    assert steppers[0].model.name == "coarse DS"
    states = [stepper.start(None) for stepper in steppers]
    for step in range(40):
        states = [
            stepper.advance(step * DT, DT, state, setup.loading.dead)[0]
            for stepper, state in zip(steppers, states, strict=True)
        ]
    x, y = (stepper.positions(state, 40 * DT) for stepper, state in zip(steppers, states, strict=True))
    moved = np.abs(y - shell.rest_positions).max()
    assert moved > 0.3
    assert np.abs(x - y).max() < 1e-5 * moved
    following = MotionSetup(DT, Damping(), shell.loading(None, None, [ms.Pressure(1.0)]))
    assert FullLevel(exact).stepper(following).model.name == "DS"


@pytest.mark.slow
def test_vertices_at_one_place_stay_apart_on_the_last_level():
    """Two sheets along a seam that is not welded: the one without load rests."""
    two = np.array([[0.0, 0.5, 0.0], [0.0, 0.0, 0.0]])[:, None]
    sheet = ms.flat_beam(length=1.0, width=0.5, cells=(6, 3))
    count, force = len(sheet.vertices), np.zeros((2 * len(sheet.vertices), 3))
    with pytest.warns(ms.ModalShellWarning):
        mesh = ms.TriangleMesh(
            (sheet.vertices + two).reshape(-1, 3), np.concatenate([sheet.faces, sheet.faces + count]).astype(np.int64)
        )
    shell = ms.Shell(mesh, ms.Isotropic(1e8, 0.3, 2e-3, 200.0), mesh.vertices[:, 0] < 1e-9)
    force[:count, 2] = -0.02 / count
    setup = MotionSetup(DT, Damping(2.0, 0.001), shell.loading(None, force, []))
    exact = ms.DiscreteShell(shell)
    ends = []
    for stepper in (FullLevel(exact).stepper(setup), exact.stepper(setup)):
        state = stepper.start(None)
        for step in range(10):
            state = stepper.advance(step * DT, DT, state, setup.loading.dead)[0]
        ends.append(stepper.positions(state, 10 * DT) - shell.rest_positions)
    most = np.abs(ends[1]).max()
    assert most > 1e-3
    assert np.abs(ends[0] - ends[1]).max() < 1e-5 * most
    assert np.abs(ends[0][count:]).max() < 1e-9 * most


def test_a_switch_tells_what_energy_it_changes(beam):
    setup = MotionSetup(DT, Damping(), Loading(beam.rest_positions, np.zeros((len(beam.mass), 3))))
    model = ms.DiscreteShell(beam)
    stepper, force = model.stepper(setup), beam.gravity_force((0.0, 0.0, -1.0))
    bend = np.where(beam.clamped, 0.0, 0.1 * beam.rest_positions[:, 0] ** 2)
    rest, sunk = (stepper.state_at(beam.rest_positions - np.outer(part * bend, [0, 0, 1]), 0.0) for part in (0.0, 1.0))
    assert energy_change((stepper, stepper), (rest, rest), force) == 0.0
    change = energy_change((stepper, stepper), (rest, sunk), force)
    assert change == pytest.approx(1.0 - float(beam.mass @ bend) / model.elastic_energy(sunk))


def test_comparisons_of_all_models_leave_it_out(beam):
    chosen = candidates(Case("a", beam, beam.gravity_force((0.0, 0.0, -1.0))))[0]
    assert "auto" not in {one.spec.key for one in chosen}
    assert "auto" in ms.models()


def test_what_it_does_not_take_is_refused(beam):
    with pytest.raises(ms.OptionError, match="error must be"):
        ms.Auto(beam, error=0.5)


@pytest.mark.by_default("load0")
@pytest.mark.parametrize("load", [ms.SelfWeight((0.0, 0.0, -0.3)), ms.Wind((0.0, 0.1, 2.0), density=1.2)])
def test_a_motion_among_known_states_resumes_to_the_same_bits(load):
    sheet = ms.Isotropic(2e11, 0.3, 0.002, 7850.0)
    strip = ms.Shell(ms.flat_beam(length=1.0, width=0.2, cells=(8, 2)), sheet, "x < 0.001")
    loads = [ms.Scaled(load, ([0.0, 0.3, 3.0], [0.0, 1.0, 0.5]))]
    whole, resumed = (Motion(ms.Auto(strip), strip.loading(None, None, loads), dt=DT) for _ in range(2))
    for step in range(120):
        whole.advance()
        if step == 70:
            resumed.restore(whole.snapshot())
    assert whole.state.memory["known"].any()
    while resumed.count < whole.count:
        resumed.advance()
    found = resumed.snapshot()
    assert all(np.array_equal(found[name], part) for name, part in whole.snapshot().items())
