"""modalshell open: motions, bases and other results in the browser."""

import tempfile
import webbrowser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import numpy as np
import pytest

import modalshell as ms
from modalshell.commands.cli import main


@pytest.fixture
def opened(monkeypatch):
    """Files that a browser was asked to show."""
    asked = []

    def show(address):
        asked.append(Path(unquote(urlsplit(address).path)))
        return True

    monkeypatch.setattr(webbrowser, "open", show)
    return asked


def run(*arguments):
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    return ended.value.code


@pytest.fixture
def basis():
    mesh = ms.flat_beam(cells=(8, 2))
    shell = ms.Shell(mesh, ms.Isotropic(1e8, 0.3, 5e-3, 100.0), mesh.vertices[:, 0] < 1e-6)
    return ms.solve_modes(shell, 2)


@pytest.mark.slow
def test_motions_and_bases_open_as_pages(tmp_path, opened, basis, capsys):
    motion = ms.simulate(ms.LinearModal(basis), duration=0.1, dt=0.05, gravity=(0, 0, -1))
    (tmp_path / "run").mkdir()
    ms.save_trajectory(motion, tmp_path / "run" / "motion.npz")
    basis.save(tmp_path / "basis.npz")
    for result in (tmp_path / "run", tmp_path / "run" / "motion.npz", tmp_path / "basis.npz"):
        assert run("open", result) == 0
    assert [file.name for file in opened] == ["motion.html", "motion.html", "basis.html"]
    assert all("webgl" in file.read_text(encoding="utf-8") for file in opened)
    assert "motion.html" in capsys.readouterr().out


def test_pictures_open_as_they_are_and_others_are_refused(tmp_path, opened, capsys, monkeypatch):
    picture = tmp_path / "a picture.png"
    picture.write_bytes(b"png")
    assert run("open", picture) == 0
    assert opened == [picture]
    scene = tmp_path / "scene.toml"
    scene.write_text("")
    assert run("open", scene) == 2
    assert "modalshell view" in capsys.readouterr().err
    assert run("open", tmp_path / "missing.png") == 2
    (tmp_path / "notes.npz").write_bytes(b"")
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    assert run("open", tmp_path / "notes.npz") == 2
    assert not list((tmp_path / "temporary").iterdir())
    monkeypatch.setattr(webbrowser, "open", lambda _: False)
    assert run("open", picture) == 0
    assert "no browser" in capsys.readouterr().out


@pytest.mark.parametrize("command", [("open",), ("export", "--to", "page")])
def test_a_damaged_basis_is_named_as_one(tmp_path, basis, capsys, command):
    """It was said to be no trajectory."""
    saved = tmp_path / "basis.npz"
    basis.save(saved)
    with np.load(saved) as stored:
        arrays = {name: stored[name] for name in stored.files if name != "modes"}
    np.savez(saved, **arrays)
    assert run(command[0], saved, *command[1:]) == 2
    assert "cannot read a saved basis from" in capsys.readouterr().err
