"""Special files are refused at once by whatever reads files, and so is what does not fit into memory."""

import os
import re
import socket
import threading
from pathlib import Path

import numpy as np
import pytest

import modalshell as ms
from modalshell.commands.cli import main
from modalshell.core import memory
from modalshell.core.memory import available_memory, demand_memory
from modalshell.files.atomic_io import read_npz, read_record
from modalshell.files.lock import acquire_lock
from modalshell.files.regular import open_regular, read_regular, read_text
from modalshell.files.study_result import StudyResult
from modalshell.run import RunFollower
from modalshell.sweep.store import CaseFolder

pytestmark = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names here")
KINDS = ("pipe", "device", "socket", "folder", "huge")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Places a special file of a kind at a path."""
    sockets = []

    def place(kind, path):
        path.unlink(missing_ok=True)
        if kind == "pipe":
            os.mkfifo(path)
        elif kind == "device":
            path.symlink_to("/dev/zero")
        elif kind == "folder":
            path.mkdir()
        elif kind == "huge":
            with open(path, "wb") as file:
                file.truncate(10**13)
        else:
            sockets.append(socket.socket(socket.AF_UNIX))
            short = tmp_path_factory.mktemp("s") / "s"
            sockets[-1].bind(str(short))
            path.symlink_to(short)
        return path

    yield place
    for opened in sockets:
        opened.close()


READERS = {
    "mesh.obj": ms.load_mesh,
    "mesh.ply": ms.load_mesh,
    "scene.toml": ms.load_scene,
    "sweep.toml": ms.run_sweep,
    "basis.npz": ms.Basis.load,
    "run.npz": ms.load_trajectory,
    "study.json": lambda path: StudyResult.load(path.parent, "study"),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", READERS)
def test_special_files_are_refused_at_once(kind, name, made, tmp_path):
    with pytest.raises(ms.ModalShellError) as caught:
        READERS[name](made(kind, tmp_path / name))
    words = {"pipe": "pipe", "device": "device", "socket": "socket", "folder": "folder|directory"}
    if kind in words:
        assert any(word in str(caught.value) for word in words[kind].split("|"))


@pytest.mark.parametrize("kind", KINDS)
def test_special_files_in_the_place_of_stored_ones_are_missing(kind, made, tmp_path):
    assert read_record(made(kind, tmp_path / "run.json")) is None
    digest = "0" * 64
    with CaseFolder(tmp_path / "cases") as cases:
        made(kind, cases.folder / f"{digest}.json")
        assert cases.read(digest) is None


@pytest.mark.parametrize("kind", ["pipe", "device", "socket"])
def test_runs_neither_follow_nor_write_to_special_files(kind, made, tmp_path):
    frames = made(kind, tmp_path / "beam.frames")
    with pytest.raises(OSError, match="not a regular file"):
        RunFollower(frames).poll()
    with pytest.raises(ms.OptionError, match="cannot be written"):
        acquire_lock(frames)


@pytest.mark.parametrize("kind", ["pipe", "device", "socket"])
def test_gltf_buffers_are_regular_files_of_the_meshs_own_folder(kind, made, tmp_path):
    text = '{"asset": {"version": "2.0"}, "buffers": [{"byteLength": 36, "uri": "%s"}], "bufferViews": [{"buffer": 0, '
    text += '"byteLength": 36}], "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}], '
    text += '"meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}], "nodes": [{"mesh": 0}], "scenes": '
    text += '[{"nodes": [0]}], "scene": 0}'
    made(kind, tmp_path / "mesh.bin")
    (tmp_path / "mesh.gltf").write_text(text % "mesh.bin")
    with pytest.raises(ms.MeshError, match="not a regular file"):
        ms.load_mesh(tmp_path / "mesh.gltf")
    (tmp_path / "inside").mkdir()
    (tmp_path / "inside" / "mesh.gltf").write_text(text % "../mesh.bin")
    with pytest.raises(ms.MeshError, match="outside"):
        ms.load_mesh(tmp_path / "inside" / "mesh.gltf")


def test_regular_files_are_read(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("é", encoding="utf-8")
    (tmp_path / "link").symlink_to(path)
    assert read_text(tmp_path / "link") == "é"
    assert read_regular(path, 2) == "é".encode()
    with pytest.raises(OSError, match=r"it has 2e-06 MB, above the 1e-06 MB that are read"):
        open_regular(path, 1)
    with pytest.raises(FileNotFoundError):
        open_regular(tmp_path / "missing")


def test_a_reader_does_not_wait_for_a_pipe(tmp_path):
    os.mkfifo(tmp_path / "mesh.obj")

    def load():
        with pytest.raises(ms.MeshError):
            ms.load_mesh(tmp_path / "mesh.obj")

    tried = threading.Thread(target=load, daemon=True)
    tried.start()
    tried.join(30)
    assert not tried.is_alive()


def test_free_memory_counts_every_limit(tmp_path, monkeypatch):
    before = available_memory()
    assert before > 0
    (tmp_path / "most").write_text("1000\n")
    (tmp_path / "used").write_text("400\n")
    monkeypatch.setattr(memory, "_CGROUPS", (("missing", "missing"), (tmp_path / "most", tmp_path / "used")))
    assert available_memory() == 600
    (tmp_path / "memory.stat").write_text("anon 50\ninactive_file 200\nactive_file 150\n")
    assert available_memory() == 950  # files that were read or written stay in memory until it is needed
    (tmp_path / "most").write_text("max\n")
    assert available_memory() > 600
    with pytest.raises(ms.OptionError, match=r"the work needs about 1e\+30 GB of memory \(got .* free\): do less"):
        demand_memory("the work", 1e39, "do less")


def test_work_that_does_not_fit_is_refused_before_it_starts(monkeypatch, tmp_path, capsys, scene_text):
    mesh = ms.flat_beam(cells=(60, 20))
    monkeypatch.setattr(memory, "available_memory", lambda: 3_000_000)
    with pytest.raises(ms.OptionError, match=r"a shell of 1281 vertices needs about 3\.46 MB of memory"):
        ms.Shell(mesh, ms.Material(20.0, 20.0, 0.05, 0.2))
    with pytest.raises(ms.OptionError, match="a mesh of 1000 x 20 cells needs about 14 MB"):
        ms.flat_beam(cells=(1000, 20))
    scene = tmp_path / "scene.toml"
    scene.write_text(scene_text(("cells = [12, 4]", "cells = [1000000, 2]")))
    with pytest.raises(SystemExit) as caught:
        main(["run", str(scene), "--out", str(tmp_path)])
    assert caught.value.code == 2
    assert re.fullmatch(r"modalshell: .*a shell of 3000003 vertices needs about .*\n", capsys.readouterr().err)


@pytest.mark.slow
def test_long_work_is_announced():
    with pytest.warns(ms.ModalShellWarning, match=r"160000 x 2 cells and a shell on it take about 7 s and 1\.6 GB"):
        ms.flat_beam(cells=(160_000, 2))


def test_packed_arrays_that_do_not_fit_are_refused(tmp_path, monkeypatch):
    np.savez_compressed(tmp_path / "a.npz", a=np.zeros(10**6))
    monkeypatch.setattr("modalshell.files.atomic_io.available_memory", lambda: 10**6)
    with pytest.raises(ValueError, match="a needs 8 MB, 1 MB are free"):
        read_npz(tmp_path / "a.npz")


def test_links_are_not_written_through(tmp_path, scene_file):
    """A link with the name of a run's frames: what it leads to stays as it is."""
    mine = tmp_path / "mine.txt"
    mine.write_text("mine")
    scene = scene_file(("duration = 1", "duration = 0.1"))
    out = tmp_path / "out"
    out.mkdir()
    (out / "scene.frames").symlink_to(mine)
    for options in ({}, {"restart": True}):
        with pytest.raises(ms.OptionError, match="it is a link"):
            ms.run_scene(scene, out=out, **options)
    assert mine.read_text() == "mine"
    assert Path(out / "scene.frames").is_symlink()


@pytest.mark.parametrize("told", ["Unable to allocate 22.4 GiB for an array", ""])
def test_memory_that_runs_out_is_one_line(told, monkeypatch, capsys):
    def no_memory(_path, **_):
        raise MemoryError(told)

    monkeypatch.setattr("modalshell.commands.cli.ms.load_mesh", no_memory)
    with pytest.raises(SystemExit) as caught:
        main(["modes", "mesh.obj"])
    assert caught.value.code == 2
    assert re.fullmatch(
        rf"modalshell: out of memory: {told}.* are free: take a coarser mesh.*\n", capsys.readouterr().err
    )
