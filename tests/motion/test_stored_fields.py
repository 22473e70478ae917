"""Fields that are stored with a motion."""

import numpy as np
import pytest
from scenes import cantilever

import modalshell as ms


def model(material=None):
    if material is None:
        return ms.LinearModal(ms.solve_modes(cantilever((4, 2)), 4))
    mesh = ms.flat_beam(cells=(4, 2))
    return ms.LinearModal(ms.solve_modes(ms.Shell(mesh, material, mesh.vertices[:, 0] < 1e-6), 4))


def test_motions_store_the_fields_that_are_named():
    sheet = model(ms.Isotropic(1e7, 0.3, 0.01, 1000.0))
    names = ["curvature", "von_mises", "von_mises_faces", "energy_density", "curvature"]
    run = ms.simulate(sheet, duration=0.1, gravity=(0, 0, -1), fields=names)
    assert list(run.fields) == names[:4]
    last = sheet.shell.fields(run.positions[-1])
    for name, values in run.fields.items():
        np.testing.assert_array_equal(values[-1], last.values(name))
    assert ms.simulate(sheet, duration=0.1).fields == {}


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        (["stress"], "each of fields must be one of"),
        ("curvature", "fields must be a list of names"),
        (["von_mises"], "needs a sheet with a thickness"),
    ],
)
def test_other_fields_are_refused_before_the_motion(fields, message):
    with pytest.raises(ms.OptionError, match=message):
        ms.simulate(model(), duration=1e9, fields=fields)


@pytest.mark.slow
def test_stresses_of_positions_that_stretch_the_shell_otherwise_than_their_model_are_said_to_be_wrong():
    """They were stored and drawn without a word: nine times too large by MWTS, twice by coarse DS."""
    mesh, sheet = ms.flat_beam(cells=(16, 4)), ms.Isotropic(1e8, 0.3, 5e-3, 100.0)
    shell = ms.Shell(mesh, sheet, mesh.vertices[:, 0] < 1e-6)
    warped = ms.ModalWarping(ms.solve_modes(shell, 4))
    coarse = ms.CoarseDiscreteShell(shell, coarse=ms.coarse_shell(shell, ms.flat_beam(cells=(8, 2))))
    for model, wrong in ((warped, True), (coarse, True), (ms.DiscreteShell(shell), False)):
        run = ms.simulate(model, duration=0.3, gravity=(0, 0, -9.81), fields=["von_mises", "curvature"])
        assert ("von_mises: wrong" in run.message) == wrong, model.name
    bent = ms.simulate(warped, duration=0.3, gravity=(0, 0, -9.81), fields=["curvature"])
    assert "wrong" not in bent.message
    little = ms.simulate(warped, duration=0.3, gravity=(0, 0, -1e-4), fields=["von_mises"])
    assert "wrong" not in little.message


def test_rounding_of_positions_is_no_stretch_of_a_model():
    """What falls freely bears none, and single precision leaves more than a thin strip under little weight."""
    mesh, sheet = ms.flat_beam(cells=(16, 4)), ms.Isotropic(2e9, 0.3, 1e-3, 1000.0)
    free = ms.Shell(mesh, sheet, [])
    run = ms.simulate(
        ms.ModalWarping(ms.solve_modes(free, 4)), duration=0.3, gravity=(0, 0, -9.81), fields=["von_mises"]
    )
    assert "wrong" not in run.message
    held = ms.DiscreteShell(ms.Shell(mesh, sheet, mesh.vertices[:, 0] < 1e-6))
    setting = {"duration": 0.1, "gravity": (0, 0, -1e-3), "fields": ["von_mises"]}
    assert "wrong" not in ms.simulate(held, **setting).message
    single = ms.simulate(held, **setting, dtype="float32").message
    assert "single precision" in single
    assert "take ds" not in single


def test_scenes_say_so_of_stresses_of_equilibria(tmp_path):
    scene = tmp_path / "strip.toml"
    scene.write_text(
        '[mesh]\nshape = "flat_beam"\ncells = [16, 4]\n'
        "[material]\nyoung = 1e8\npoisson = 0.3\nthickness = 5e-3\ndensity = 100.0\n"
        '[supports]\nclamped = "x < 0.001"\n[loads]\ngravity = [0, 0, -9.81]\n'
        '[model]\nname = "mwts"\nmodes = 4\n[output]\nfields = ["von_mises"]\n'
    )
    assert "von_mises: wrong" in ms.run_scene(scene, out=tmp_path).summary
    scene.write_text(scene.read_text().replace('"mwts"\nmodes = 4', '"ds"'))
    assert "wrong" not in ms.run_scene(scene, out=tmp_path).summary


def test_stored_motions_are_looked_at_when_they_are_coloured_anew(tmp_path):
    scene = tmp_path / "strip.toml"
    scene.write_text(
        '[mesh]\nshape = "flat_beam"\ncells = [16, 4]\n'
        "[material]\nyoung = 1e8\npoisson = 0.3\nthickness = 5e-3\ndensity = 100.0\n"
        '[supports]\nclamped = "x < 0.001"\n[loads]\ngravity = [0, 0, -9.81]\n'
        '[model]\nname = "mwts"\nmodes = 4\n[motion]\nduration = 0.1\n[output]\nlook = "plain"\n'
    )
    for color, wrong in (("displacement", 0), ("von_mises", 1), ("von_mises", 1)):
        result = ms.run_scene(scene, out=tmp_path, color=color)
        assert result.summary.count(": wrong") == wrong, color
