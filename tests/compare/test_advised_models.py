"""What the advice names can be run: every registered model by a scene with the table that the advice would print."""

import tomllib

import numpy as np
import pytest
from scenes import timed

import modalshell as ms
from modalshell.commands.cli import main
from modalshell.compare.advice_text import _plain
from modalshell.compare.advise import choose
from modalshell.compare.candidates import candidates, case_factory
from modalshell.compare.case import make_case
from modalshell.models.registry import MODELS
from modalshell.scene.write import toml_table, write_scene_with

STILL = ("[motion]\nduration = 1\n", "")
WEAK = ("-9.81", "-0.5")


@pytest.fixture(autouse=True)
def _without_opengl(monkeypatch):
    monkeypatch.setenv("MODALSHELL_RENDERER", "built-in")


@pytest.mark.by_default("rigid")
@pytest.mark.parametrize("key", [key for key, spec in MODELS.items() if spec.on_ladder])
def test_every_model_runs_by_the_table_that_the_advice_prints(key, scene_file, tmp_path):
    file = scene_file(STILL, WEAK)
    case = make_case(file, None, None, ())
    candidate = next(one for one in candidates(case, (4,))[0] if one.spec.key == key)
    direct = candidate.build(case_factory(case))[0].equilibrium(force=case.load)
    text = file.read_text().replace('[model]\nname = "mwts"', toml_table("model", candidate.model_table))
    other = tmp_path / "advised.toml"
    other.write_text(text)
    result = ms.run_scene(other, out=tmp_path)
    np.testing.assert_array_equal(ms.load_trajectory(tmp_path / "advised.npz").positions[-1], direct.positions)
    assert result.summary


def test_advice_prints_the_table_and_writes_the_scene(scene_file, tmp_path, capsys):
    file = scene_file(STILL, WEAK)
    out = tmp_path / "elsewhere" / "advised.toml"
    arguments = [str(file), "--modes", "4", "--fps", "1e-3", "--out", str(tmp_path / "out"), "--write", str(out)]
    with pytest.raises(SystemExit) as ended:
        main(["advise", *arguments])
    assert ended.value.code == 0
    printed = capsys.readouterr().out
    scene = ms.load_scene(out)
    assert f'name = "{scene.model.spec.key}"' in printed
    before = tomllib.loads(file.read_text())
    after = tomllib.loads(out.read_text())
    assert scene.name == "advised"  # under the name of the old one its results took the place of those
    assert after.pop("model") == {"name": scene.model.spec.key, "modes": 4}
    assert after == {key: value for key, value in before.items() if key != "model"}


def test_scenes_are_written_with_all_that_they_declare(tmp_path):
    mesh = ms.flat_beam(cells=(6, 2))
    ms.save_mesh(mesh, tmp_path / "beam.ply")
    text = """
[mesh]
file = "beam.ply"
[material]
stretch = 20
shear = 2e1
flexure = 0.05
density = 0.2
[supports]
clamped = "x < 0.2"
[loads]
gravity = [0, 0, -1]
[[loads.forces]]
where = "x > 0.9 and y > -1e-3"
total = [0, 1e-05, 0.0]
[model]
name = "lma"
[[constraints]]
kind = "position"
nearest = [1, 0, 0]
target = [1, 0, -0.1]
relative = false
[output]
formats = ["png"]
"""
    file = tmp_path / "scene.toml"
    file.write_text(text)
    out = write_scene_with(file, tmp_path / "sub" / "scene.toml", {"name": "rsw", "modes": 3})
    before, after = tomllib.loads(text), tomllib.loads(out.read_text())
    assert after["mesh"].pop("file") == "../beam.ply"
    del before["mesh"]["file"]
    assert after | {"model": before["model"]} == before
    assert after["model"] == {"name": "rsw", "modes": 3}
    assert ms.load_scene(out).build().model.basis.count == 3


def test_a_written_scene_finds_the_files_of_the_one_it_was_made_of(tmp_path):
    ms.save_mesh(ms.flat_beam(cells=(6, 2)), tmp_path / "beam.ply")
    (tmp_path / "sheet.txt").write_text("1e-3\n" * 24)
    (tmp_path / "held.txt").write_text("0\n1\n2\n")
    (tmp_path / "warm.txt").write_text("5.0\n" * 24)
    (tmp_path / "boundary").write_text("no selection")
    file = tmp_path / "scene.toml"
    file.write_text(
        """
mesh = {file = "beam.ply"}
material = {young = 1e9, poisson = 0.3, thickness = "sheet.txt", density = 1e3}
supports = [{kind = "clamp", sel = "held.txt"}, {kind = "fix", sel = "boundary", axes = "y"}]
rest = {change = "warm.txt", expansion = 1e-6}
loads = {gravity = [0, 0, -1]}
model = {name = "ds"}
"""
    )
    out = write_scene_with(file, tmp_path / "sub" / "scene.toml", {"name": "ds"})
    before, after = ms.load_scene(file).build(), ms.load_scene(out).build()
    np.testing.assert_array_equal(before.shell.clamped, after.shell.clamped)
    assert after.scene.content() | {"model": None, "rest": None} == before.scene.content() | {
        "model": None,
        "rest": None,
    }


@pytest.mark.parametrize(
    ("value", "digits", "shown"),
    [
        (17511.0, 3, "17,500"),
        (584.2, 2, "580"),
        (3.71, 2, "3.7"),
        (9.996, 3, "10.0"),
        (0.0123, 3, "0.0123"),
        (1e-9, 3, "1e-09"),
        (np.nan, 3, "nan"),
        (np.inf, 2, "inf"),
    ],
)
def test_rates_are_written_without_powers_of_ten(value, digits, shown):
    assert _plain(value, digits) == shown
    assert _plain(0.0, digits) == "0"


@pytest.mark.slow
def test_advice_without_a_model_writes_no_scene(scene_file, tmp_path):
    file = scene_file(STILL, WEAK)
    advice = choose(ms.tradeoff(file, modes=(2,), loads=(1.0,)), 1e-12, 1e9)
    with pytest.raises(ms.OptionError, match="no scene to write: No rung meets both"):
        advice.write_scene(file, tmp_path / "out.toml")
    assert not (tmp_path / "out.toml").exists()


FOLLOWED = """
mesh = {shape = "flat_beam", cells = [10, 2]}
material = {young = 1e9, poisson = 0.3, thickness = 1e-3, density = 1000.0}
supports = {clamped = "x < 0.001"}
model = {name = "ds"}
[loads]
gravity = [0, 0, 0]
[[loads.pressure]]
p = 0.4
"""


@pytest.fixture(scope="module")
def followed(tmp_path_factory):
    """Measurements of a plate under pressure, its shell, and the pressure."""
    file = tmp_path_factory.mktemp("followed") / "plate.toml"
    file.write_text(FOLLOWED)
    scene = ms.load_scene(file)
    measured = ms.tradeoff(scene, modes=(4,), loads=(1.0,))
    return timed(measured), measured.case.shell, [ms.Pressure(0.4)]


def test_advice_holds_under_a_load_that_follows_the_shell(followed):
    """Warped modes are nearer to DS under the pressure's forces at rest than under the pressure."""
    measured, shell, loads = followed
    exact = ms.DiscreteShell(shell).equilibrium(loads=loads).positions
    off = {
        row.label: ms.measure.displacement_error(row.model.equilibrium(loads=loads).positions, exact, shell)
        for row in measured.rows
    }
    row = next(row for row in measured.rows if row.label == "MWTS 4")
    assert 1.3 * row.largest_error < off["MWTS 4"]
    error = 0.5 * (row.largest_error + off["MWTS 4"])
    advice = choose(measured, error, 60.0)
    fault = "off DS under the whole load as it follows the shell"
    assert advice.refused["MWTS 4"] == f"{100 * off['MWTS 4']:.3g} % {fault}"
    assert advice.live_error == pytest.approx(off[advice.chosen.label], rel=1e-6)
    assert advice.live_error <= error
    assert advice.margin[0] == error / max(advice.live_error, advice.chosen.largest_error)
    assert f"Under the whole load as it follows the shell it is {100 * advice.live_error:.2g} %" in advice.explanation
    assert choose(measured, 1e-9, 60.0).live_error is None  # DS itself


def test_shares_of_loads_that_follow_the_shell(tmp_path):
    """Of two pressures, one with the largest factor of its table, and a force whose factor alone changes."""
    file = tmp_path / "plate.toml"
    tables = """times = [0, 1, 2]
factors = [0, -3, 1]
[[loads.pressure]]
p = 0.1
[[loads.point]]
sel = "x > 0.99"
force = [0, 0.001, 0]
times = [0, 1]
factors = [1, 2]
[motion]
duration = 2
dt = 0.1
"""
    file.write_text(FOLLOWED + tables)
    case = make_case(file, None, None, ())
    shell = case.shell
    given = case.statics(0.5)
    rest = shell.loading(None, given["force"], given["loads"])
    np.testing.assert_allclose(rest.force(shell.rest_positions), 0.5 * case.load, atol=1e-15)
    point = ms.PointForce("x > 0.99", (0, 0.001, 0))
    same = shell.loading(loads=[ms.Pressure(-0.55), point])
    bent = shell.rest_positions + 0.1 * np.sin(3.0 * shell.rest_positions)
    np.testing.assert_allclose(rest.force(bent), same.force(bent), atol=1e-15)
    file.write_text(FOLLOWED.replace("p = 0.4", "p = 0.4\nfollower = false"))
    dead = make_case(file, None, None, ())
    assert set(dead.statics(0.5)) == {"force"}
