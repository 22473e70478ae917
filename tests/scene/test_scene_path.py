"""The path that a scene asks for, its table, and the command."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scenes import beam_text

import modalshell as ms
from modalshell.commands import scenes
from modalshell.commands.cli import main
from modalshell.render.curves import path_curves
from modalshell.run.path_files import scene_path
from modalshell.statics.bifurcation import PathEvent

LOADED = """[loads]
gravity = [0.0, 0.0, -5.0]
[model]
name = "{model}"
"""


@pytest.fixture
def scene(tmp_path):
    def written(path="", model="ds", more=""):
        file = tmp_path / "beam.toml"
        file.write_text(beam_text(8, "x < 0.13") + LOADED.format(model=model) + path + more)
        return str(file)

    return written


def run(*arguments):
    with pytest.raises(SystemExit) as ended:
        main([*map(str, arguments)])
    return ended.value.code


@pytest.mark.slow
def test_the_command_writes_numbers_and_pictures(scene, tmp_path, capsys):
    table = '[path]\nuntil = 2.0\nsteps = 5\nwatch = "x > 0.99"\ndirection = [0.0, 0.0, -1.0]\n'
    file, out = scene(table), tmp_path / "out"
    assert not run("path", file, "--out", out)
    assert "beam: converged" in capsys.readouterr().out
    saved = np.load(out / "beam_path.npz")
    shell = ms.load_scene(file).build_shell()
    tip = shell.rest_positions[:, 0] > 0.99
    path = ms.equilibrium_path(shell, gravity=(0, 0, -5), until=2.0, steps=5, watch=(tip, (0, 0, -1)))
    np.testing.assert_array_equal(saved["factors"], path.factors)
    np.testing.assert_array_equal(saved["displacements"], path.displacements)
    np.testing.assert_array_equal(saved["positions"], path.positions)
    for name in ("beam_path.png", "beam_path_shapes.png"):
        assert (out / name).stat().st_size > 1000
    assert not run("path", file, "--out", out, "--until", 0.5)
    assert np.load(out / "beam_path.npz")["factors"][-1] == 0.5


def test_the_command_tells_events_in_the_units_of_the_scene(scene, tmp_path, capsys, monkeypatch):
    def with_event(*given, **more):
        return replace(scene_path(*given, **more), events=[PathEvent("limit", 1, 0.1)])

    monkeypatch.setattr(scenes, "scene_path", with_event)
    assert not run("path", scene("[path]\nuntil = 0.1\n", more='[units]\nlength = "mm"\n'), "--out", tmp_path / "out")
    assert re.search(r"limit at a load factor of 0\.1, displacement \S+ mm\n", capsys.readouterr().out)


def test_watched_vertices_come_from_a_file(scene, tmp_path):
    (tmp_path / "tip.txt").write_text("3\n4\n")
    table = '[path]\nuntil = 0.1\nwatch = "tip.txt"\ndirection = [0.0, 0.0, -1.0]\n'
    assert ms.load_scene(scene(table)).path.watch == [3, 4]
    with pytest.raises(ms.SceneError, match=r"path\.direction: is missing"):
        ms.load_scene(scene('[path]\nwatch = "tip.txt"\n'))


@pytest.mark.slow
def test_a_path_that_does_not_arrive_ends_with_status_1(scene, tmp_path):
    assert run("path", scene("[path]\npoints = 3\n"), "--out", tmp_path) == 1


@pytest.mark.parametrize(
    ("table", "key"),
    [
        ("until = 0.0", "path.until"),
        ('until = "far"', "path.until"),
        ('control = "time"', "path.control"),
        ("steps = 0", "path.steps"),
        ("points = 1", "path.points"),
        ("branches = -1", "path.branches"),
        ("untill = 2.0", "path.untill"),
        ('watch = "x > 0.9"', "path.direction"),
        ('watch = "x > 9"\ndirection = [0, 0, 1]', "path.watch"),
        ('watch = "x > 0.9"\ndirection = [0, 0, 0]', "path.direction"),
    ],
)
def test_wrong_keys_are_refused_with_their_path(scene, table, key, capsys):
    assert run("path", scene(f"[path]\n{table}\n")) == 2
    assert f"beam.toml: {key}" in capsys.readouterr().err


def test_models_without_a_potential_and_moving_scenes_are_refused(scene, capsys):
    assert run("path", scene(model="mwts")) == 2
    assert "take DS, RSW or MD-ROM" in capsys.readouterr().err
    led = '[[constraints]]\nkind = "position"\nnearest = [1, 0, 0]\ntarget = [1, 0, 0]\n'
    assert run("path", scene(more=led)) == 2
    assert "no constraints" in capsys.readouterr().err
    ramp = "[[loads.weight]]\ntimes = [0.0, 1.0]\nfactors = [0.0, 1.0]\n[motion]\nduration = 1.0\n"
    assert run("path", scene(more=ramp)) == 2  # it was taken at time 0
    assert "a path knows no time" in capsys.readouterr().err


def test_curves_break_where_stability_changes():
    x, y = np.arange(7.0), np.array([0.0, 1.0, 2.0, 1.5, 1.0, 2.0, 3.0])
    stable = np.array([True, True, False, False, True, True, True])
    curves = path_curves(x, y, stable, [("limit", 2, 2.0), ("limit", 4, 1.0), ("bifurcation", 5, 2.0)], "DS", "k")
    lines = [curve for curve in curves if not curve.points]
    assert [list(line.x) for line in lines] == [[0, 1, 2], [2, 3, 4], [4, 5, 6]]
    assert [line.dashed for line in lines] == [False, True, False]
    assert [line.label for line in lines] == ["DS", "_DS", "_DS"]
    assert [(curve.marker, float(curve.x[0])) for curve in curves if curve.points] == [("^", 2), ("^", 4), ("s", 5)]
