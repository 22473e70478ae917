"""Units of scenes, and warnings for values that no sheet has."""

import json
import re
import tomllib
import warnings

import numpy as np
import pytest
from later import later

from modalshell import (
    Basis,
    Isotropic,
    Material,
    ModalShellWarning,
    SceneError,
    Shell,
    load_clip,
    load_scene,
    run_scene,
    sheet,
    solve_modes,
)
from modalshell.core.units import SI, UnitSystem
from modalshell.sweep.case import Task, case_digest, run_case

pyvista = later("pyvista")

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
        ("", {"density": 1e-6}, "material.density: 1e-06 kg/m^3, which no sheet has"),
        ('[units]\nlength = "mm"\n', {"density": 1000.0}, "material.density: 1000 kg/mm^3 is 1e+12 kg/m^3, which"),
        ("", {"young": 1e15}, "material.young: 1e+15 Pa, stiffer than diamond"),
        ("", {"young": 210.0}, "material.young: 210 Pa, softer than jelly: check [units] (210 GPa"),
    ],
)
def test_odd_values_are_told(remarks, units, changes, told):
    assert any(told in remark for remark in remarks(units, **changes))


def test_unknown_units_are_refused(scene_file):
    for units, told in (('length = "parsec"', r"units\.length"), ('force = "N"', r"units\.force: unknown key")):
        with pytest.raises(SceneError, match=told):
            load_scene(scene_file(more=f"[units]\n{units}\n"))


def test_air_and_gravity_that_are_left_out_are_those_of_si_in_other_units(scene_file):
    """Wind blew with 1.2 t/mm^3, and weight was 9.81 mm/s^2."""
    loads = "[[loads.wind]]\nvelocity = [0, 0, 1]\n[[loads.weight]]\n"
    scene = load_scene(scene_file(more=f'{loads}[units]\nlength = "mm"\nmass = "t"\ntime = "ms"\n'))
    assert scene.loads.wind[0].density == pytest.approx(1.2e-12)
    np.testing.assert_allclose(scene.loads.weight[0].gravity, [0.0, 0.0, -9.81e-3])
    given = "[[loads.wind]]\nvelocity = [0, 0, 1]\ndensity = 2e-12\n"
    scene = load_scene(scene_file(more=f'{given}[units]\nlength = "mm"\nmass = "t"\ntime = "s"\n'))
    assert scene.loads.wind[0].density == 2e-12
    assert load_scene(scene_file(more=loads)).loads.wind[0].density == 1.2


MILLIMETRES = '[units]\nlength = "mm"\nmass = "t"\ntime = "s"\n'


def test_unit_systems_name_what_follows_from_their_three():
    tonnes = UnitSystem("mm", "t", "s")
    found = [tonnes.of(unit) for unit in ("m", "Pa", "N", "J", "1/m", "N/m", "kg/m^3", "1/s^2", "", "rad")]
    assert found == ["mm", "MPa", "N", "mJ", "1/mm", "N/mm", "t/mm^3", "1/s^2", "", "rad"]
    assert [tonnes.of(unit) for unit in ("N m", "J/m^2")] == ["N mm", "mJ/mm^2"]
    assert [UnitSystem("mm", "kg", "ms").of(unit) for unit in ("Pa", "N", "J")] == ["GPa", "kN", "J"]
    assert [UnitSystem("cm", "g", "s").of(unit) for unit in ("Pa", "J")] == ["g/(cm s^2)", "g cm^2/s^2"]
    assert [UnitSystem("ft", "kg", "s").of(unit) for unit in ("Pa", "N m")] == ["kg/(ft s^2)", "kg ft^2/s^2"]
    assert [SI.of(unit) for unit in ("Pa", "N m")] == ["Pa", "N m"]
    assert SI.labels({"length": "m", "ratio": ""}) == {"length": "m", "ratio": "1"}


@pytest.mark.slow
@pytest.mark.parametrize("units", ["", MILLIMETRES])
def test_results_of_a_scene_carry_its_units(scene_file, tmp_path, units):
    """The archive, the clip, VTK's files, the record, and what is read back."""
    output = '[output]\nformats = ["clip", "pvd"]\nfields = ["von_mises"]\n'
    values = SANE | ({"young": 1e3, "density": 1e-9} if units else {})
    file = scene_file((STIFFNESSES, SHEET.format(**values)), more=output + units)
    result = run_scene(file, out=tmp_path / "out")
    length, stress, energy = ("mm", "MPa", "mJ") if units else ("m", "Pa", "J")
    with np.load(tmp_path / "out" / "scene.npz") as archive:
        told = json.loads(str(archive["units"]))
        assert archive["unit_system"].tolist() == [length, "t" if units else "kg", "s"]
        measured = set(archive.files) - {"modalshell_trajectory", "units", "unit_system", "status", "message"}
    assert (told["positions"], told["field_von_mises"], told["energies"]) == (length, stress, energy)
    assert measured - set(told) == {"faces", "unconverged_steps", "step_error", "damping_error"}  # shares
    assert result.trajectory.units.length == length
    clip = load_clip(tmp_path / "out" / "scene.clip")
    assert clip.units == result.trajectory.units
    surface = pyvista.get_reader(tmp_path / "out" / "scene.pvd").read()[0]
    assert surface.field_data["displacement_unit"] == [length]
    assert surface.field_data["von_mises_unit"] == [stress]
    record = json.loads((tmp_path / "out" / "scene.json").read_text())
    assert record["units"] == {
        "seconds": "s of wall time",
        "length": length,
        "mass": "t" if units else "kg",
        "time": "s",
    }


def test_saved_bases_name_their_units(tmp_path):
    mesh = sheet(cells=(3, 3))
    for material in (Isotropic(1e6, 0.3, 0.01, 1000.0), Material(20.0, 20.0, 0.05, 0.2)):
        solve_modes(Shell(mesh, material, [0, 1, 2]), 2).save(tmp_path / "basis.npz")
        with np.load(tmp_path / "basis.npz") as archive:
            told = json.loads(str(archive["units"]))
            assert told["eigenvalues"] == "1/s^2"
            assert set(told) <= set(archive.files)
        assert Basis.load(tmp_path / "basis.npz").count == 2


def test_sentences_name_units_of_the_scene():
    """After numbers alone, and the same if told twice; what runs into other words is no unit."""
    text = "0.45 m inside, at 120 s: take dt <= 2.5 s; creeps at 5e-04 m/s (6 Hz). 3 ms, 2 s/x, kN of 4 N; 2 m.toml"
    assert SI.restated(text) == text
    other = UnitSystem("cm", "g", "ms")
    told = other.restated(text)
    assert told == (
        "0.45 cm inside, at 120 ms: take dt <= 2.5 ms; creeps at 5e-04 cm/ms (6 1/ms). 3 ms, 2 s/x, kN of 4 g cm/ms^2; "
        "2 m.toml"
    )
    assert other.restated(told) == told
    with pytest.warns(ModalShellWarning, match="by 3 cm, in"), other.said():
        warnings.warn("the spline swings by 3 m, in motion", ModalShellWarning, stacklevel=1)
    assert UnitSystem("mm", "t", "s").restated("at 6 Hz, 2 Pa.") == "at 6 Hz, 2 MPa."


SWUNG = """
[mesh]
shape = "flat_beam"
length = 10.0
width = 2.0
cells = [5, 1]
[material]
young = 1e4
poisson = 0.3
thickness = 0.1
density = 1.0
[supports]
clamped = "x < 0.01"
[loads]
gravity = [0.0, 0.0, -9.81e-4]
[model]
name = "ds"
integrator = "implicit"
[motion]
duration = 100.0
dt = 10.0
damping = [0.0, 0.1]
[units]
length = "cm"
mass = "g"
time = "ms"
"""


def test_messages_and_refusals_of_a_run_are_in_units_of_the_scene(tmp_path):
    """Steps that damp are named in ms, and a collider that the shell begins in by cm."""
    (tmp_path / "swung.toml").write_text(SWUNG)
    result = run_scene(tmp_path / "swung.toml", out=tmp_path)
    message = result.trajectory.message
    assert re.search(r"at \S+ 1/ms \(asked .*\): take dt <= \S+ ms or", message)
    assert message in result.summary
    assert message == json.loads((tmp_path / "swung.json").read_text())["message"]
    assert "to 100 ms" in result.trajectory._repr_html_()
    scene = load_scene(tmp_path / "swung.toml")
    mesh = scene.build_mesh()
    arrays = (mesh.vertices.astype("<f8").tobytes(), mesh.faces.astype("<i8").tobytes())
    case = Task(case_digest(scene, mesh), str(scene.file), tomllib.loads(SWUNG), *arrays)
    assert run_case(case).message == message
    (tmp_path / "inside.toml").write_text(f'{SWUNG}[[contacts]]\nkind = "plane"\noffset = 0.5\n')
    with pytest.raises(SceneError, match=r"begins 0\.5 cm inside the contact"):
        run_scene(tmp_path / "inside.toml", out=tmp_path)
    (tmp_path / "short.toml").write_text(SWUNG.replace("duration = 100.0", "duration = 1.0"))
    with pytest.raises(SceneError, match="at least one step of 10 ms"):
        load_scene(tmp_path / "short.toml")
