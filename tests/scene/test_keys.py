"""The list of keys: every table that a scene takes, with the units and defaults of what it builds."""

import re
from operator import attrgetter

import pytest

import modalshell as ms
from modalshell.commands.cli import main
from modalshell.scene.keys import scene_keys
from modalshell.scene.load import _LISTS, _REQUIRED, single_tables


def test_every_table_of_a_scene_is_listed():
    headings = " ".join(one.heading for one in scene_keys())
    for name in {*_REQUIRED, *_LISTS, *single_tables()}:
        assert f"[{name}]" in headings or f"[{name}." in headings, name
    assert [key.name for key in scene_keys("scene")[0].keys] == ["name", "bar"]


def test_keys_have_types_defaults_and_units():
    sphere = next(one for one in scene_keys("contacts") if '"sphere"' in one.heading)
    keys = {key.name: key for key in sphere.keys}
    assert (keys["radius"].takes, keys["radius"].default) == ("number", "required")
    assert "[m]" in keys["radius"].about
    assert keys["friction"].default == "0.0"
    assert "Coulomb" in keys["friction"].about
    pressure = next(one for one in scene_keys("loads") if one.heading == "[[loads.pressure]]")
    assert next(key.default for key in pressure.keys if key.name == "follower") == "true"
    crease = {key.name: key for key in scene_keys("creases")[0].keys}
    assert "[N]" in crease["yield_moment"].about
    motion = scene_keys("motion")[0]
    assert "[s]" in motion.about


def test_tables_within_a_table_are_listed_with_their_keys():
    camera = next(one for one in scene_keys("flock") if one.heading == "[flock.camera]")
    assert {key.name: key.default for key in camera.keys}["position"] == "required"
    assert "[m]" in camera.about


def test_what_keys_point_to_is_public():
    texts = [text for one in scene_keys() for text in (one.about, *(key.about for key in one.keys))]
    for name in {name for text in texts for name in re.findall(r"\bms\.([\w.]*\w)", text)}:
        attrgetter(name)(ms)
    wind = next(one for one in scene_keys("loads") if one.heading == "[[loads.wind]]")
    assert next(key.about for key in wind.keys if key.name == "velocity") == "Of the air [m/s]."


def test_another_name_is_refused_with_the_tables():
    with pytest.raises(
        ms.OptionError, match=r"has the tables mesh, material, .* and 'scene' before them \(got 'ball'\)"
    ):
        scene_keys("ball")
    with pytest.raises(ms.OptionError, match=r"\(got 'contact'\); did you mean 'contacts'\?"):
        scene_keys("contact")


def test_the_command_prints_them(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["keys", "supports"])
    assert ended.value.code == 0
    printed = capsys.readouterr().out
    assert '[[supports]] with kind = "roller"' in printed
    assert "direction" in printed


@pytest.mark.slow
def test_pictures_are_coloured_by_displacement_in_scenes_too(scene_file, tmp_path):
    coloured = '[output]\ncolor = "displacement"\nformats = ["png"]\n'
    file = scene_file(("duration = 1", "duration = 0.2"), more=coloured)
    run = ms.run_scene(ms.load_scene(file), out=tmp_path / "out")
    assert not run.trajectory.fields
