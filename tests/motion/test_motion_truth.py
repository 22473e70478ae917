"""Motions against what was asked, known answers and fine steps: what the study ``motion_truth`` tells at length."""

import numpy as np
import pytest

import modalshell as ms
from modalshell.files.study_result import StudyResult
from studies import motion_damping, motion_limits, motion_scenes
from studies.motion_rungs import rungs, strip

ENERGIES = ("hinges", "Isotropic")
RATIOS = (0.01, 0.03, 0.1)


def rung_of(energy, name):
    return next(pair for pair in motion_damping.damping_rungs(energy) if pair[0].name == name)


def free_rung(name):
    return motion_limits.free_rungs(motion_limits.panel())[name]()


def off(energy, name, rule, steps):
    """Largest relative error of three damping ratios at ``steps`` a period."""
    rung, shell = rung_of(energy, name)
    basis = ms.solve_modes(shell, 1)
    omega, shape = float(2.0 * np.pi * basis.frequencies[0]), basis.modes[:, 0].reshape(-1, 3)
    model = rung.make(rule)
    return max(abs(motion_damping.obtained(model, shape, omega, ratio, steps) / ratio - 1.0) for ratio in RATIOS)


def test_ratios_are_read_from_sums_of_oscillations():
    times = np.arange(60) * 0.3
    exponents = np.array([-0.03 + 1j, -0.2 + 3.3j])
    samples = np.exp(np.outer(times, exponents)).real @ [1.0, 0.3]
    found = motion_damping.least_ratio(samples, np.exp(0.3 * exponents[0]))
    assert found == pytest.approx(0.03 / abs(exponents[0]), rel=1e-9)


@pytest.mark.by_default("10-LMA-Isotropic", "10-reduced RSW-hinges")
@pytest.mark.parametrize("energy", ENERGIES)
@pytest.mark.parametrize("name", ["LMA", "MWTS", "RSW", "reduced RSW"])
@pytest.mark.parametrize("steps", [3, 10, 75])
def test_modal_rungs_have_the_damping_that_was_asked(energy, name, steps):
    assert off(energy, name, "exponential", steps) < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("energy", ENERGIES)
def test_ds_has_the_damping_that_was_asked_at_20_steps_a_period(energy):
    assert off(energy, "DS", "composite", 20) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize(("energy", "name"), [(e, n) for e in ENERGIES for n in ("coarse DS", "MD-ROM")])
def test_rungs_of_one_solution_a_step_have_it_at_75(energy, name):
    assert off(energy, name, "bdf2", 75) < 0.01


@pytest.mark.slow
def test_springs_have_it_at_75():
    assert off("hinges", "springs", "bdf2", 75) < 0.01


@pytest.mark.slow
def test_the_hybrid_has_it_at_75_and_is_of_order_two():
    rung, shell = rung_of("hinges", "hybrid")
    assert off("hinges", "hybrid", "bdf2", 75) < 0.01
    assert motion_damping.order_of(rung, shell, "bdf2", (100, 200, 400))["order"] == pytest.approx(2.0, abs=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("rule", ["bdf2", "composite", "sdirk2"])
def test_implicit_euler_adds_damping_and_second_order_does_not(rule):
    assert off("hinges", "coarse DS", "implicit_euler", 75) > 0.3
    assert off("hinges", "coarse DS", rule, 75) < 0.01


@pytest.mark.by_default("MWTS-hinges", "MWTS-Isotropic", "reduced RSW-hinges")
@pytest.mark.parametrize("energy", ENERGIES)
@pytest.mark.parametrize("name", ["MWTS", "RSW", "reduced RSW"])
def test_modal_rungs_are_of_order_two(energy, name):
    rung, shell = rung_of(energy, name)
    found = motion_damping.order_of(rung, shell, "exponential", (40, 80, 160))
    assert found["order"] == pytest.approx(2.0, abs=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("rule", ["bdf2", "composite", "sdirk2"])
def test_coarse_ds_is_of_order_two(rule):
    """The first part of SDIRK2 meets a stretch with half the pull: rates of strain by it are of order one."""
    rung, shell = rung_of("hinges", "coarse DS")
    found = motion_damping.order_of(rung, shell, rule, (100, 200, 400), viscous=rule != "sdirk2")
    assert found["order"] == pytest.approx(2.0, abs=0.2)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("energy", "name", "rule"),
    [("Isotropic", "DS", "composite"), ("hinges", "DS", "bdf2"), ("Isotropic", "MD-ROM", "bdf2")],
)
def test_full_rungs_are_of_order_two(energy, name, rule):
    rung, shell = rung_of(energy, name)
    found = motion_damping.order_of(rung, shell, rule, motion_damping.ORDER_STEPS["full"])
    assert found["order"] == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize("energy", ENERGIES)
@pytest.mark.parametrize("steps", [0.7, 3.0, 17.0])
def test_lma_follows_loads_of_straight_pieces_exactly(energy, steps):
    assert motion_damping.linear_exactness(energy, steps) < 1e-12


@pytest.mark.slow
def test_a_stiff_sheet_that_is_damped_by_strain_rates_turns_freely():
    rung, shell = rung_of("hinges", "coarse DS")
    found = motion_damping.order_of(rung, shell, "composite", (50, 100, 200))
    assert found["changes"][0] < 0.01


@pytest.mark.slow
def test_plate_under_sudden_pressure_follows_its_own_exact_answer():
    rows = {row["steps"]: row for row in motion_scenes.plate_rows("Isotropic", (20, 100), ("composite",))}
    assert rows[20]["error"] < 0.04
    assert rows[100]["error"] < 0.006
    assert rows[100]["against_series"] < 0.2  # of which the coarse mesh is 0.17


def test_plate_series_swings_about_the_static_deflection():
    stiffness = motion_scenes.PLATE["young"] * motion_scenes.PLATE["thickness"] ** 3 / (12.0 * 0.91)
    times = np.linspace(0.0, 200.0, 4001)
    mean = motion_scenes.plate_series(times, 1.0).mean()
    assert mean == pytest.approx(0.00406235 / stiffness, rel=2e-3)


@pytest.fixture(scope="module")
def snapping_tip():
    """The V-beam's tip by fine steps."""
    return motion_scenes.snap_tip(motion_scenes.snap_models()["coarse DS"]("bdf2"), 32)[0]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "rule", "most"), [("DS", "composite", 0.01), ("coarse DS", "bdf2", 0.04)])
def test_v_beam_is_followed_through_its_snap_at_30_steps_a_second(name, rule, most, snapping_tip):
    tip, took = motion_scenes.snap_tip(motion_scenes.snap_models()[name](rule), 1)
    assert took["status"] == "completed"
    assert snapping_tip[:, 2].min() < -0.5  # it snaps
    assert np.linalg.norm(tip - snapping_tip, axis=1).max() < most


@pytest.mark.slow
@pytest.mark.parametrize("amplitude", [pytest.param(1.0, marks=pytest.mark.slow), 3.0])
def test_held_strip_vibrates_faster_the_farther_it_goes(amplitude):
    found = motion_scenes.held_strip_ratio("Isotropic", "composite", amplitude, periods=2)
    assert found["error"] == pytest.approx(0.0, abs=0.003)


@pytest.mark.by_default("coarse DS")
@pytest.mark.parametrize("name", ["LMA", "RSW", "coarse DS", "DS"])
def test_a_falling_turning_free_panel_keeps_its_centre(name):
    shell = motion_limits.panel()
    found = motion_limits.invariants(free_rung(name), gravity=(0.0, 0.0, -9.81), force=motion_limits.couple(shell))
    assert found["wander"] < 1e-6


@pytest.mark.by_default("coarse DS")
@pytest.mark.parametrize("name", ["LMA", "RSW", "coarse DS", "DS"])
def test_a_bent_panel_that_is_let_go_keeps_its_angular_momentum(name):
    shell = motion_limits.panel()
    found = motion_limits.invariants(free_rung(name), start=motion_limits.bent(shell, 0.0))
    assert found["angular_momentum"] < 1e-6
    assert found["largest_energy"] <= 1.0 + 1e-9


@pytest.fixture(scope="module")
def quick(quick_study):
    """What the quick study finds."""
    return StudyResult.load(quick_study("motion_truth"), "motion_truth").findings


@pytest.mark.slow
def test_stiff_scenes_gain_no_energy(quick):
    rows = quick["stiff"]
    assert {row["rule"] for row in rows} == {"composite", "bdf2", "sdirk2", "implicit_euler"}
    assert len({row["scene"] for row in rows}) == 6
    for row in rows:
        assert row["energy"] <= 1.0 + 1e-9, row
        assert row["unsolved"] == 0, row


@pytest.mark.slow
def test_supports_that_move_are_followed_to_second_order(quick):
    rows = quick["led"]
    assert {row["scene"] for row in rows} == {"spin-up of a cantilever", "shaken cantilever"}
    # A half step shows three quarters of an error of second order.
    assert all(row["own"] < 0.75 * 0.05 for row in rows), rows
    assert all(row["error"] < 0.75 * 0.02 for row in rows if row["rung"] == "DS"), rows


def test_every_rung_of_a_strip_is_named_once():
    names = [rung.name for rung in rungs(strip("hinges"), 1.0, with_hybrid=False)]
    assert len(set(names)) == len(names) == 7
