"""Commands keep what they read, and files that something else wrote."""

import json
import os

import numpy as np
import pytest

import modalshell as ms
from modalshell.commands.cli import main
from modalshell.files.outputs import refuse_foreign
from modalshell.files.study_result import StudyResult


@pytest.fixture(autouse=True)
def _without_opengl(monkeypatch):
    monkeypatch.setenv("MODALSHELL_RENDERER", "built-in")


@pytest.fixture
def refused(capsys):
    """Runs a command that must leave the named files as they are, and returns its one line."""

    def run(*arguments, keeps):
        before = {path: path.read_bytes() for path in keeps}
        with pytest.raises(SystemExit) as stop:
            main([str(argument) for argument in arguments])
        assert {path: path.read_bytes() for path in keeps} == before
        assert stop.value.code == 2
        told = capsys.readouterr().err
        assert told.count("\n") == 1
        return told

    return run


def succeed(*arguments):
    with pytest.raises(SystemExit) as stop:
        main([str(argument) for argument in arguments])
    assert not stop.value.code


def test_page_and_fit_and_advise_spare_the_scene_and_the_data(refused, scene_file, tmp_path):
    scene, notes, link = scene_file(), tmp_path / "notes.txt", tmp_path / "link.html"
    notes.write_text("mine\n")
    link.symlink_to(scene)
    data = tmp_path / "tip.json"
    data.write_text('{"frequencies": [1.0]}')
    for out in (scene, notes):
        assert "--out must end in .html" in refused("page", scene, "--out", out, keeps=[scene, notes])
    assert "is an input" in refused("page", scene, "--out", link, keeps=[scene])
    (tmp_path / "hard.html").hardlink_to(scene)
    assert "is an input" in refused("page", scene, "--out", tmp_path / "hard.html", keeps=[scene])
    fit = ("fit", scene, "--data", data, "--wrt", "flexure")
    assert "is an input" in refused(*fit, "--out", data, keeps=[scene, data])
    assert "--out must end in .json" in refused(*fit, "--out", scene, keeps=[scene, data])
    assert "is an input" in refused("advise", scene, "--write", scene, keeps=[scene])
    assert "--write must end in .toml" in refused("advise", scene, "--write", notes, keeps=[scene, notes])


def test_a_companion_of_another_program_stays(refused, scene_file, tmp_path):
    run = ms.run_scene(scene_file(), out=tmp_path / "run")
    saved, rest = run.files[0], run.files[0].with_name(f"{run.files[0].stem}_rest.obj")
    rest.write_text("# mine\nv 0 0 0\n")
    assert "not written by modalshell" in refused("export", saved, "--to", "pc2", keeps=[rest])
    rest.unlink()
    for _ in range(2):  # its own is replaced
        succeed("export", saved, "--to", "pc2")
    basis = tmp_path / "modes.npz"
    ms.solve_modes(ms.load_scene(scene_file()).build_shell(), 2).save(basis)
    described = tmp_path / "modes_body.json"
    described.write_text('{"my": "settings"}')
    assert "not written by modalshell" in refused("export", basis, "--to", "body", keeps=[described, basis])
    described.unlink()
    for _ in range(2):
        succeed("export", basis, "--to", "body")
    assert json.loads(described.read_text())["layout"].startswith("modalshell")


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["npz", "json", "csv"])
def test_a_run_replaces_results_and_nothing_else(refused, scene_file, tmp_path, suffix):
    scene = scene_file(more='[output]\nformats = ["csv"]\n')
    name = ms.load_scene(scene).name
    foreign = tmp_path / f"{name}.{suffix}"
    if suffix == "npz":
        np.savez(foreign, measured=np.arange(3))
    else:
        foreign.write_text('{"my": "settings"}' if suffix == "json" else "z\n0.1\n")
    assert "not written by modalshell" in refused("run", scene, "--out", tmp_path, keeps=[foreign, scene])
    foreign.unlink()
    first = ms.run_scene(scene, out=tmp_path)
    foreign.write_bytes(foreign.read_bytes()[:-40])  # damaged results are ours still
    assert np.array_equal(ms.run_scene(scene, out=tmp_path).trajectory.positions, first.trajectory.positions)
    ms.run_scene(scene, out=tmp_path, restart=True)


def test_simulate_modes_and_path_keep_arrays_of_others(refused, scene_file, tmp_path):
    ms.save_mesh(ms.sheet(length=1.0, width=0.3, cells=(6, 2)), tmp_path / "strip.obj")
    for name in ("strip_mwts.npz", "strip_basis.npz", "scene_path.npz"):
        np.savez(tmp_path / name, measured=np.arange(3))
    for command, file in (("simulate", "strip_mwts.npz"), ("modes", "strip_basis.npz")):
        told = refused(command, tmp_path / "strip.obj", "--out", tmp_path, keeps=[tmp_path / file])
        assert "not written by modalshell" in told
    scene = scene_file()
    foreign = tmp_path / f"{ms.load_scene(scene).name}_path.npz"
    np.savez(foreign, measured=np.arange(3))
    assert "not written by modalshell" in refused("path", scene, "--out", tmp_path, keeps=[foreign])


@pytest.mark.parametrize("suffix", ["npz", "json"])
@pytest.mark.parametrize("command", ["tradeoff", "advise"])
def test_measurements_keep_files_of_others_before_any_work(refused, scene_file, tmp_path, monkeypatch, command, suffix):
    scene = scene_file()
    foreign = tmp_path / f"{ms.load_scene(scene).name}_tradeoff.{suffix}"
    if suffix == "npz":
        np.savez(foreign, measured=np.arange(3))
    else:
        foreign.write_text('{"my": "settings"}')
    monkeypatch.setattr(ms, command, lambda *_, **__: pytest.fail("it was measured"))
    assert "not written by modalshell" in refused(command, scene, "--out", tmp_path, keeps=[foreign, scene])


def test_simulate_finds_arrays_of_others_before_any_mode(refused, tmp_path, monkeypatch):
    ms.save_mesh(ms.sheet(length=1.0, width=0.3, cells=(6, 2)), tmp_path / "strip.obj")
    np.savez(tmp_path / "strip_mwts.npz", measured=np.arange(3))
    for place in ("modalshell.commands.meshes.model_basis", "modalshell.solve_modes"):
        monkeypatch.setattr(place, lambda *_: pytest.fail("modes were solved"))
    told = refused("simulate", tmp_path / "strip.obj", "--out", tmp_path, keeps=[tmp_path / "strip_mwts.npz"])
    assert "not written by modalshell" in told


def test_a_study_replaces_its_own_results_alone(tmp_path):
    result = StudyResult("study", {"rows": []}, {"a": np.arange(3)}, {})
    for _ in range(2):
        result.save(tmp_path)
    (tmp_path / "study.json").write_text('{"my": "settings"}')
    with pytest.raises(ms.OptionError, match="not written by modalshell"):
        result.save(tmp_path)
    assert (tmp_path / "study.json").read_text() == '{"my": "settings"}'


def test_a_run_keeps_its_mesh(refused, scene_file, tmp_path):
    pytest.importorskip("pygltflib", reason="writes GLB (extra interchange)")
    mesh = tmp_path / "beam.glb"
    ms.save_mesh(ms.v_beam(cells=(12, 4)), mesh)
    scene = scene_file(('shape = "v_beam"\ncells = [12, 4]', 'file = "beam.glb"'))
    scene.write_text('name = "beam"\n' + scene.read_text() + '[output]\nformats = ["glb"]\n')
    assert "is an input" in refused("run", scene, "--out", tmp_path, keeps=[mesh])


def test_an_empty_file_and_a_link_to_nothing(tmp_path):
    (tmp_path / "a.json").touch()
    refuse_foreign(tmp_path / "a.json", tmp_path / "none.npz")
    (tmp_path / "b.npz").symlink_to(tmp_path / "b.npz")
    with pytest.raises(ms.OptionError, match="move it away"):
        refuse_foreign(tmp_path / "b.npz")


def test_what_cannot_be_written_is_refused_before_any_work(refused, scene_file, tmp_path, monkeypatch):
    """A page was computed and then lost; so were trade-offs and paths of a folder that others own."""
    scene, notes = scene_file(), tmp_path / "notes.txt"
    notes.write_text("mine\n")
    (tmp_path / "folder.html").mkdir()
    for place in ("commands.scenes.scene_page", "commands.scenes.scene_path", "tradeoff"):
        monkeypatch.setattr(f"modalshell.{place}", lambda *_, **__: pytest.fail("it was computed"))
    assert "notes.txt is no folder open to you" in refused("page", scene, "--out", notes / "a.html", keeps=[notes])
    assert "is a folder" in refused("page", scene, "--out", tmp_path / "folder.html", keeps=[scene])
    monkeypatch.setattr(os, "access", lambda *_, **__: False)
    assert "is no folder open to you" in refused("page", scene, "--out", tmp_path / "a.html", keeps=[scene])
    for command in ("tradeoff", "path"):
        assert "no folder for results (Permission denied)" in refused(command, scene, "--out", tmp_path, keeps=[scene])
