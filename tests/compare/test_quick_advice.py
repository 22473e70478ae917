"""Advice and comparisons by error bars: right against DS, without an answer of DS."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import stiff_beam_text

import modalshell as ms
from modalshell.commands.cli import main
from modalshell.compare.advise import choose
from modalshell.compare.bar_reference import path_by_bars
from modalshell.compare.candidates import Candidate
from modalshell.compare.case import make_case
from modalshell.models.registry import models

SCENE = (
    stiff_beam_text()
    + """[loads]
gravity = [0.0, 2.0, %g]
[model]
name = "lma"
"""
)


@pytest.fixture
def shell():
    mesh = ms.v_beam(length=1.0, width=0.2, fold=150.0, cells=(20, 4))
    return ms.Shell(mesh, ms.Material(2000.0, 2000.0, 0.05, 0.2), "x < 0.051")


def test_the_rung_it_names_meets_the_error_and_those_before_it_do_not(shell, monkeypatch):
    gravity = (0.0, 2.0, -15.0)
    monkeypatch.setattr(ms.DiscreteShell, "equilibrium", None)
    advice = ms.quick_advice(shell, gravity=gravity, error=0.01, modes=(2, 6))
    monkeypatch.undo()
    assert advice.chosen is advice.rows[-1].candidate
    exact = ms.DiscreteShell(shell).equilibrium(gravity=gravity)
    factory = ms.compare.candidates.case_factory(ms.compare.Case("a", shell, shell.gravity_force(gravity)))
    errors = []
    for row in advice.rows:
        answer = row.candidate.build(factory)[0].equilibrium(gravity=gravity)
        errors.append(ms.measure.displacement_error(answer.positions, exact.positions, shell))
        assert row.bars[-1].displacement == pytest.approx(errors[-1], rel=0.05)
    assert errors[-1] <= 0.01
    assert min(errors[:-1], default=1.0) > 0.01
    assert advice.explanation.startswith(f"Take {advice.chosen.label}: at rest it is within ")
    assert advice.snap is None or advice.snap > 1.5


MOVED = """
[mesh]
shape = "sheet"
length = {mm:g}
width = {row:g}
cells = [10, 2]
[material]
stretch = 1.0
shear = 1.0
flexure = 1.0
density = 1.0
[[supports]]
kind = "clamp"
sel = "x < {row:g}"
[model]
name = "lma"
"""
STIFFNESSES = "stretch = 1.0\nshear = 1.0\nflexure = 1.0\ndensity = 1.0\n"
SHEET = "young = 1.0\npoisson = 0.3\nthickness = 1.0\ndensity = 1e-9\n"
PATH = """[[supports]]
kind = "path"
times = [0.0, {a}, {b}]
translations = [[0, 0, 0], [0, 0, {mm:g}], [0, 0, 0]]
[loads]
gravity = [0, 0, {g}]
"""


def test_cases_of_a_scene_in_other_units_are_the_same(tmp_path):
    """Frames of a scene in minutes were 60 times as long, and a path of seconds was looked at at its ends alone."""
    file, cases = tmp_path / "scene.toml", []
    for length, time, metres, seconds in (("m", "s", 1.0, 1.0), ("mm", "min", 1e-3, 60.0)):
        units = f'[units]\nlength = "{length}"\ntime = "{time}"\n'
        numbers = {
            "mm": 1.0 / metres,
            "row": 0.2 / metres,
            "a": 0.1 / seconds,
            "b": 0.2 / seconds,
            "g": seconds**2 / metres,
        }
        file.write_text(units + MOVED.format(**numbers) + "[loads]\ngravity = [0, 0, -1]\n")
        assert make_case(file, None, None, ()).dt == pytest.approx(1 / 60 / seconds)
        file.write_text(units + (MOVED + PATH).format(**numbers))
        cases.append(make_case(file, None, None, ()))
    si, other = cases
    fastest, other_fastest = (case.load[:, 2] / case.shell.mass for case in cases)
    np.testing.assert_allclose(fastest, fastest[0], rtol=1e-12)
    np.testing.assert_allclose(other_fastest * 1e-3 / 60.0**2, fastest, rtol=1e-6)
    assert fastest[0] == pytest.approx(600.0, rel=0.01)  # 6 d / T^2 half-way, where gravity adds to it
    assert si.note.endswith("at 0.1 s.")
    assert other.note.endswith("at 0.00167 min.")


def test_what_it_says_of_refused_rungs_is_in_the_units_of_the_scene(tmp_path):
    file = tmp_path / "scene.toml"
    more = "[rest]\nrest_curvature = 0.001\n[loads]\ngravity = [0, 0, -1]\n"
    file.write_text('[units]\nlength = "mm"\n' + MOVED.format(mm=1e3, row=200.0).replace(STIFFNESSES, SHEET) + more)
    assert " mm): take DS or" in ms.quick_advice(file, modes=(2,)).explanation


def test_before_a_snap_it_names_ds(shell):
    """DS leaves its branch at 41.5."""
    advice = ms.quick_advice(shell, gravity=(0.0, 13.0, -48.5), error=0.05)
    assert advice.model_table == {"name": "ds"}
    assert 0.7 < advice.snap < 1.0
    assert "expected to leave its branch" in advice.explanation
    assert len(advice.rows) == 2  # the first rung, and the most exact one


@pytest.mark.slow
@pytest.mark.parametrize("angle", [45.0, 90.0])
def test_a_snap_far_below_the_load_is_named_where_the_path_finds_it(angle):
    """The first bar stands at a quarter of the load, past the end of the branch, and foretells it up to 9 times off."""
    mesh = ms.cylinder_panel(length=0.5, radius=0.5, angle=angle, cells=(10, 10))
    material = ms.Isotropic(young=1e8, poisson=0.3, thickness=1.5e-3, density=1000.0)
    low = np.isclose(mesh.vertices[:, 2], mesh.vertices[:, 2].min())
    shell = ms.Shell(mesh, material, supports=[ms.Pin(low)])
    gravity = (0.0, 0.0, -100.0)
    end = ms.equilibrium_path(shell, gravity=gravity, until=0.2).events[0].factor
    assert ms.quick_advice(shell, gravity=gravity, modes=(8,)).snap == pytest.approx(end, rel=0.01)


def test_the_command_names_it_and_writes_a_scene(tmp_path, capsys):
    scene, out = tmp_path / "scene.toml", tmp_path / "new.toml"
    scene.write_text(SCENE % -50.0)
    with pytest.raises(SystemExit) as ended:
        main(["advise", str(scene), "--quick", "--error", "0.05", "--write", str(out)])
    assert ended.value.code == 0
    assert "Take DS" in capsys.readouterr().out
    assert ms.load_scene(out).model.spec.key == "ds"


def test_an_error_of_nothing_is_refused(shell):
    with pytest.raises(ms.OptionError, match="error must be"):
        ms.quick_advice(shell, gravity=(0.0, 0.0, -1.0), error=0.0)


@pytest.mark.slow
def test_a_quick_comparison_has_the_errors_of_the_full_one(shell, monkeypatch):
    gravity = (0.0, 2.0, -15.0)
    monkeypatch.setattr(ms.DiscreteShell, "equilibrium", None)
    quick = ms.tradeoff(shell, gravity=gravity, modes=(4, 8), loads=(0.5, 1.0), quick=True)
    monkeypatch.undo()
    exact = [ms.DiscreteShell(shell).equilibrium(gravity=factor * np.array(gravity)) for factor in (0.5, 1.0)]
    for answer, true in zip(quick.path.answers, exact, strict=True):
        assert ms.measure.displacement_error(answer.positions, true.positions, shell) < 1e-4
        assert answer.bar.valid
    factory = ms.compare.candidates.case_factory(quick.case)
    for row in quick.rows:
        answer = row.candidate.build(factory)[0].equilibrium(gravity=gravity)
        error = ms.measure.displacement_error(answer.positions, exact[-1].positions, shell)
        assert row.final_error == pytest.approx(error, rel=0.02, abs=1e-5)
    assert {row.key for row in quick.rows} == {"rigid", "lma", "mwts", "mwts-consistent", "rsw", "md-rom"}
    assert "DS was not solved" in quick.table()
    assert set(quick.left_out) >= {"DS", "hybrid"}


def test_advice_says_the_bar_and_the_training_of_the_model_that_it_names(shell):
    gravity = (0.0, 2.0, -15.0)
    quick = ms.tradeoff(shell, gravity=gravity, modes=(4,), loads=(1.0,), quick=True)
    advice = choose(quick, 0.02, 1.0)
    bar = ms.error_bar(shell, advice.chosen.positions, gravity=gravity)
    assert f"{bar}." in advice.explanation
    assert "trained" not in advice.explanation
    hybrid = replace(advice.chosen, candidate=Candidate(models()["hybrid"], "8x2"))
    told = choose(replace(quick, rows=[hybrid]), 0.02, 1.0).explanation
    assert "It was trained on this load" in told
    assert "coarse shell of 8x2" in told


def test_a_quick_comparison_solves_ds_where_a_bar_is_void(shell):
    quick = ms.tradeoff(shell, gravity=(0.0, 13.0, -48.5), modes=(4,), loads=(0.5, 1.0), quick=True)
    assert "DS was solved, as no error bar serves at 1 of the load" in quick.table()
    assert quick.path.snap is not None
    exact = ms.DiscreteShell(shell).equilibrium(gravity=(0.0, 13.0, -48.5))
    assert ms.measure.displacement_error(quick.path.answers[-1].positions, exact.positions, shell) < 0.01
    counts, load = [], shell.mass[:, None] * (0.0, 13.0, -48.5)
    path_by_bars(ms.RotationStrain(ms.solve_modes(shell, 4)), load, (0.5, 1.0), lambda: counts.append(1))
    assert len(counts) == 2  # 0.5 was counted twice


def test_engines_are_not_asked_quickly(shell):
    with pytest.raises(ms.OptionError, match="leave out quick or engines"):
        ms.tradeoff(shell, gravity=(0.0, 0.0, -1.0), engines=True, quick=True)


@pytest.mark.slow
def test_the_quick_command_writes_table_and_pictures(tmp_path, capsys):
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE % -15.0)
    with pytest.raises(SystemExit) as ended:
        main(["tradeoff", str(scene), "--quick", "--modes", "4", "--out", str(tmp_path / "out")])
    assert ended.value.code == 0
    assert "DS was not solved" in capsys.readouterr().out
    assert {file.suffix for file in (tmp_path / "out").iterdir()} == {".npz", ".json", ".md", ".png"}


@pytest.mark.parametrize("ask", [ms.quick_advice, lambda *given, **more: ms.tradeoff(*given, quick=True, **more)])
def test_more_modes_than_unknowns_are_refused(shell, ask):
    with pytest.raises(ms.OptionError, match=r"modes must have a count of at most \d+, the free unknowns of the shell"):
        ask(shell, gravity=(0.0, 0.0, -1.0), modes=(9999,))


def test_bars_are_those_of_loads_that_follow_the_shell(tmp_path):
    file = tmp_path / "plate.toml"
    file.write_text(
        """
mesh = {shape = "flat_beam", cells = [10, 2]}
material = {young = 1e9, poisson = 0.3, thickness = 1e-3, density = 1000.0}
supports = {clamped = "x < 0.001"}
model = {name = "ds"}
loads = {pressure = [{p = 0.4}]}
"""
    )
    row = ms.quick_advice(file, error=0.1, modes=(4,), loads=(1.0,)).rows[-1]
    shell, loads = ms.load_scene(file).build_shell(), [ms.Pressure(0.4)]
    exact = ms.DiscreteShell(shell).equilibrium(loads=loads).positions
    factory = ms.compare.candidates.case_factory(ms.compare.Case("a", shell, np.ones_like(exact)))
    answer = row.candidate.build(factory)[0].equilibrium(loads=loads)
    error = ms.measure.displacement_error(answer.positions, exact, shell)
    assert row.bars[0].displacement == pytest.approx(error, rel=0.05)
