"""Work that needs more than the machine has is refused with its need; long work is announced or shows how far it is."""

import json
import shutil

import numpy as np
import pytest

import modalshell as ms
from modalshell.commands import terminal
from modalshell.commands.cli import main
from modalshell.commands.terminal import progress
from modalshell.core import memory
from modalshell.render.backend import open_painter
from modalshell.sweep.grid import load_sweep
from modalshell.sweep.plan import Plan


@pytest.fixture(scope="module")
def shell():
    mesh = ms.flat_beam(cells=(12, 4))
    return ms.Shell(mesh, ms.Material(20.0, 20.0, 0.05, 0.2), mesh.vertices[:, 0] < 0.1)


@pytest.fixture
def little(monkeypatch):
    """Sets how many bytes of memory are free, for demands of any size."""
    monkeypatch.setattr(memory, "_LITTLE", 0.0)
    return lambda size: monkeypatch.setattr(memory, "available_memory", lambda: size)


def test_modes_that_do_not_fit_are_refused(shell, little):
    little(200_000)
    with pytest.raises(ms.OptionError, match=r"30 modes of 65 vertices needs about .* of memory .*: take fewer modes"):
        ms.solve_modes(shell, 30)
    little(10**9)
    ms.solve_modes(shell, 30)
    little(2_000_000)
    with pytest.raises(ms.OptionError, match="the derivatives of 30 modes needs about"):
        ms.ModalDerivatives(shell, 30)


def test_rigid_motions_of_many_parts_are_counted(little):
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    vertices = np.concatenate([corners + np.array([0.0, 0.0, k]) for k in range(3000)])
    shell = ms.Shell(
        ms.TriangleMesh(vertices, np.arange(9000).reshape(-1, 3)), ms.Material(1.0, 1.0, 1.0, 1.0), loose_parts=True
    )
    little(4 * 10**9)
    with pytest.warns(ms.ModalShellWarning, match="3000 of 3000"), pytest.raises(ms.OptionError, match="18000 rigid"):
        ms.solve_modes(shell, 4)


@pytest.mark.slow
def test_a_trajectory_that_does_not_fit_is_refused_before_its_first_step(shell, little):
    model = ms.LinearModal(ms.solve_modes(shell, 2))

    def step(*_):
        raise AssertionError

    little(10**6)
    with pytest.raises(ms.OptionError, match=r"a trajectory of 30002 frames needs about .*store_every"):
        ms.simulate(model, duration=1000.0, dt=1.0 / 30.0, on_step=step)
    assert len(ms.simulate(model, duration=1000.0, dt=1.0 / 30.0, store_every=10_000).times) == 4


def test_a_run_that_does_not_fit_on_the_disk_is_refused(scene_file, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(10**6, 10**6 - 1000, 1000))
    with pytest.raises(SystemExit) as ended:
        main(["run", str(scene_file()), "--out", str(tmp_path / "out")])
    assert ended.value.code == 2
    assert "on the disk of" in capsys.readouterr().err


def test_pictures_and_flocks_that_do_not_fit_are_refused(little, tmp_path):
    little(10**9)
    with pytest.raises(ms.OptionError, match=r"a picture of 8192 x 8192 pixels needs about 13\.4 GB"):
        open_painter((8192, 8192))
    scene = tmp_path / "flock.toml"
    scene.write_text(
        """
        mesh = {file = "meshes/leaf.obj"}
        material = {stretch = 20.0, shear = 20.0, flexure = 0.05, density = 0.2}
        supports = {clamped = "x < 0.1"}
        model = {name = "mwts", modes = 2}
        motion = {duration = 1.0}
        flock = {count = 100000, radius = 50.0, camera = {position = [0.0, -100.0, 0.0]}}
        """
    )
    with pytest.raises(ms.OptionError, match="a flock of 100000 birds of 319 vertices needs about"):
        ms.run_scene(scene, out=tmp_path)


def test_many_instances_of_a_gltf_are_announced(tmp_path, monkeypatch):
    import trimesh

    monkeypatch.setattr("modalshell.mesh.file_checks._MANY_INSTANCES", 5)
    scene, part = trimesh.Scene(), trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], process=False)
    for k in range(6):
        scene.add_geometry(part, geom_name="part", transform=trimesh.transformations.translation_matrix([0, 0, k]))
    (tmp_path / "many.glb").write_bytes(scene.export(file_type="glb"))
    with pytest.warns(ms.ModalShellWarning, match="places 6 meshes, which takes about 0 s to read"):
        assert len(ms.load_mesh(tmp_path / "many.glb").faces) == 6


def test_more_instances_of_a_gltf_than_are_read_are_refused_at_once(tmp_path, monkeypatch):
    nodes = [{"mesh": 0}] * 50_000
    document = {"asset": {"version": "2.0"}, "nodes": nodes, "meshes": [{"primitives": []}]}
    (tmp_path / "many.gltf").write_text(json.dumps(document), encoding="utf-8")
    monkeypatch.setattr("modalshell.mesh.files._trimesh_load", lambda *_: pytest.fail("it was read"))
    with pytest.raises(ms.MeshError, match="places 50000 meshes, more than the 20000 that are read; join them"):
        ms.load_mesh(tmp_path / "many.gltf")


@pytest.mark.parametrize(
    "text",
    [
        ".".join("a" * 20_000) + " = 1",
        "[" + " . ".join("a" * 20_000) + "]",
        "x = {" + ".".join(['"a.b"', "'c'"] * 10_000) + " = 1}",
        "x = {a = 1, " + ".".join("a" * 60) + "=1}",
    ],
)
def test_keys_of_many_parts_are_refused_before_they_are_parsed(text, tmp_path, monkeypatch):
    monkeypatch.setattr("tomllib.loads", lambda _: pytest.fail("it was parsed"))
    (tmp_path / "scene.toml").write_text(text, encoding="utf-8")
    with pytest.raises(ms.SceneError, match="nested deeper than 50 levels"):
        ms.load_scene(tmp_path / "scene.toml")


@pytest.mark.parametrize(
    "text",
    [
        "# " + ". " * 100 + "=",
        'name = "' + "a." * 100 + '="',
        "name = [" + ", ".join(["1.5"] * 100) + "]",
        'x = """\n' + "a . " * 40 + '"""',
        ".".join("a" * 40) + " = 1",
    ],
)
def test_other_dots_are_no_long_keys(text, tmp_path):
    (tmp_path / "scene.toml").write_text(text, encoding="utf-8")
    with pytest.raises(ms.SceneError) as refused:
        ms.load_scene(tmp_path / "scene.toml")
    assert "deeper" not in str(refused.value)


def test_a_scene_that_does_not_fit_is_refused_before_its_mesh_is_made(little, scene_file, monkeypatch):
    scene = ms.load_scene(scene_file(("cells = [12, 4]", "cells = [2000, 2000]")))
    little(10**9)
    monkeypatch.setattr("modalshell.scene.scene.build_mesh", lambda *_: pytest.fail("the mesh was made"))
    with pytest.raises(ms.SceneError, match=r"mesh: a shell of 4004001 vertices needs about .* take a coarser mesh"):
        scene.build()


def test_a_sweep_tells_how_many_scenes_are_checked(tmp_path, scene_file):
    scene_file()
    file = tmp_path / "sweep.toml"
    file.write_text('scene = "scene.toml"\n[axes]\n"material.flexure" = {from = 0.1, to = 1.0, count = 7}\n')
    seen = []
    Plan(load_sweep(file), lambda done, total: seen.append((done, total)))
    assert seen == [(k, 7) for k in range(1, 8)]


def test_a_log_has_a_line_a_minute_with_the_time_left_which_a_slow_first_step_leaves_alone(capsys, monkeypatch):
    clock = [0.0]
    monkeypatch.setattr(terminal, "Stopwatch", lambda: lambda: clock[0])
    with progress("steps") as advance:
        for done in range(1, 11):
            clock[0] += 100.0 if done == 1 else 25.0
            advance(done, 10)
    assert capsys.readouterr().err.splitlines() == [
        "steps: 1 of 10 after 100 s, time left unknown",
        "steps: 4 of 10 after 175 s, 150 s left",
        "steps: 7 of 10 after 250 s, 75 s left",
        "steps: 10 of 10 after 325 s",
    ]
    assert terminal.log_line("steps", 0, 10, 61.0) == "steps: 0 of 10 after 61 s, time left unknown"


def test_bars_follow_one_another_and_may_wait(capsys):
    with progress("first") as first, progress("second", delay=1e9) as second, progress("third") as third:
        for advance in (first, second, third):
            for done in range(1, 4):
                advance(done, 3)
    told = capsys.readouterr().err
    assert "first" in told
    assert "third" in told
    assert "second" not in told
