"""Error bars of scenes, and what the commands `run` and `simulate` say of them."""

import json

import numpy as np
import pytest
from scenes import stiff_beam_text, stopped_and_resumed

import modalshell as ms
from modalshell.commands.cli import main

SCENE = (
    "bar = %s"
    + stiff_beam_text()
    + """[loads]
gravity = [0.0, 0.0, %g]
[model]
name = "mwts"
modes = 4
"""
)

MOTION_ON_A_PLANE = """[motion]
duration = 0.5
[[contacts]]
kind = "plane"
offset = -0.2
normal = [0.0, 0.0, 1.0]
"""


def run_main(*arguments):
    with pytest.raises(SystemExit) as ended:
        main([str(one) for one in arguments])
    return ended.value.code


@pytest.mark.parametrize(("gravity", "said"), [(-20.0, "% from DS; 4"), (-38.0, "void: the answer is near the end")])
def test_an_equilibrium_says_its_bar_and_keeps_it(gravity, said, tmp_path, capsys):
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE % ("true", gravity))
    for _ in range(2):  # computed, then found
        assert run_main("run", scene, "--out", tmp_path / "out") == 0
        assert said in " ".join(capsys.readouterr().out.split())
    stored = json.loads((tmp_path / "out" / "scene.json").read_text())["bars"]
    assert said in stored["summary"]
    assert stored["valid"] == [gravity > -30.0]
    assert ms.load_trajectory(tmp_path / "out" / "scene.npz").margin[0] == stored["margin"][0]


@pytest.mark.slow
def test_a_motion_has_bars_and_a_resumed_one_the_same(tmp_path):
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE % ("true", -20.0) + "[motion]\nduration = 1.5\n")
    first, resumed = stopped_and_resumed(scene, tmp_path, 30)
    whole = first.trajectory
    assert whole.bars.times == pytest.approx([0.5, 1.0])
    assert resumed.resumed > 1
    assert np.array_equal(resumed.trajectory.bars.displacement, whole.bars.displacement)
    assert np.array_equal(resumed.trajectory.bars.margin, whole.bars.margin)


def test_scenes_that_have_none_are_refused(tmp_path):
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE % ('"yes"', -20.0))
    with pytest.raises(ms.SceneError, match="bar: must be true or false"):
        ms.load_scene(scene)
    scene.write_text((SCENE % ("true", -20.0)).replace('clamped = "x < 0.051"', 'clamped = "x < 1e-9 and y < -0.09"'))
    with pytest.raises(ms.SceneError, match=r"scene.toml: bar: an error bar needs a shell that its supports hold"):
        ms.run_scene(scene, out=tmp_path / "out")
    scene.write_text(SCENE % ("true", -20.0) + '[[contacts]]\nkind = "self"\ngap = 1e-3\n')
    with pytest.raises(ms.SceneError, match=r"scene.toml: bar: an error bar under self-contact is not known"):
        ms.run_scene(scene, out=tmp_path / "out")


def test_without_a_bar_nothing_is_stored(tmp_path):
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE % ("false", -20.0))
    declared = ms.load_scene(scene)
    assert "bar" not in declared.content()
    result = ms.run_scene(scene, out=tmp_path)
    assert result.trajectory.bars is None
    assert "from DS" not in result.summary


@pytest.mark.parametrize(
    ("gravity", "motion", "said"),
    [
        (-38.0, "", "void: the answer is near the end of its branch"),
        (-2.0, "", "% from DS"),
        (-60.0, "[motion]\nduration = 0.5\n", "at its largest displacement, at 0."),
        (-50.0, MOTION_ON_A_PLANE, "at its largest displacement, at 0."),
    ],
)
def test_run_says_how_far_it_is_from_ds_where_no_bar_is_asked_for(gravity, motion, said, tmp_path, capsys):
    """Of an answer past its branch it said nothing but "converged"."""
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE % ("false", gravity) + motion)
    run_main("run", scene, "--out", tmp_path / "out")
    told = " ".join(capsys.readouterr().out.split())
    assert said in told
    assert ('take name = "ds" in [model], or auto' in told) == (gravity < -30.0)


@pytest.mark.parametrize("output", ["", '[output]\npositions = "float32"\n'], ids=["far apart", "rounded"])
def test_run_says_nothing_where_stored_frames_have_no_accelerations(output, tmp_path, capsys):
    every = "store_every = 15\n" if not output else ""
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE % ("false", -2.0) + "[motion]\nduration = 2.0\ndt = 0.005\n" + every + output)
    run_main("run", scene, "--out", tmp_path / "out")
    assert "from DS" not in capsys.readouterr().out


def test_run_says_nothing_of_the_error_of_ds(tmp_path, capsys):
    scene = tmp_path / "scene.toml"
    scene.write_text((SCENE % ("false", -2.0)).replace('"mwts"\nmodes = 4', '"ds"'))
    run_main("run", scene, "--out", tmp_path / "out")
    assert "from DS" not in capsys.readouterr().out


@pytest.mark.by_default("True")
@pytest.mark.parametrize("static", [True, False])
def test_simulate_says_how_far_it_is_from_ds(static, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(
        "modalshell.run.run_shell.write_result", lambda run, path, *_: run.save(path.with_suffix(".npz"))
    )
    options = ["--static", "--young", "1e9"] if static else ["--duration", "0.5"]
    run_main("simulate", "meshes/leaf.obj", *options, "--out", tmp_path)
    said = " ".join(capsys.readouterr().out.split())
    assert "take --model ds" in said
    assert ("18 % from DS; 52 % of the way to a snap" if static else "at its largest displacement, at 0.1") in said
