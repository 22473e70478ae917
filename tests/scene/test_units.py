"""Units of scenes, and warnings for values that no sheet has."""

import warnings

import pytest

from modalshell import ModalShellWarning, SceneError, load_scene

STIFFNESSES = "stretch = 20.0\nshear = 20.0\nflexure = 0.05\ndensity = 0.2\n"
SHEET = "young = {young}\npoisson = 0.3\nthickness = {thickness}\ndensity = {density}\n"
SANE = {"young": 1e9, "thickness": 0.001, "density": 1000.0}


@pytest.fixture
def remarks(scene_file):
    def remarks(units="", **changes):
        file = scene_file((STIFFNESSES, SHEET.format(**(SANE | changes))), more=units)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            load_scene(file).build_shell()
        return [str(entry.message) for entry in caught if issubclass(entry.category, ModalShellWarning)]

    return remarks


def test_sane_values_pass_without_a_word(remarks):
    assert remarks() == []
    tonnes = '[units]\nlength = "mm"\nmass = "t"\ntime = "s"\n'
    assert remarks(tonnes, young=1e3, density=1e-9) == []  # MPa and t/mm^3
    assert remarks('[units]\nlength = "cm"\nmass = "g"\n', young=1e10, density=1.0) == []  # CGS


@pytest.mark.parametrize(
    ("units", "changes", "told"),
    [
        ("", {"thickness": 0.5}, "material.thickness: 0.5 m is over a fifth"),
        ("", {"density": 1e-6}, "material.density: 1e-06 kg/m^3 is 1e-06 kg/m^3"),
        ('[units]\nlength = "mm"\n', {"density": 1000.0}, "material.density: 1000 kg/mm^3 is 1e+12 kg/m^3"),
        ("", {"young": 1e15}, "material.young"),
    ],
)
def test_odd_values_are_told(remarks, units, changes, told):
    assert any(told in remark for remark in remarks(units, **changes))


def test_unknown_units_are_refused(scene_file):
    for units, told in (('length = "parsec"', r"units\.length"), ('force = "N"', r"units\.force: unknown key")):
        with pytest.raises(SceneError, match=told):
            load_scene(scene_file(more=f"[units]\n{units}\n"))
