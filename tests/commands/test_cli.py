import functools
import json
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

import modalshell as ms
from modalshell.commands import cli
from modalshell.commands.cli import main
from studies.benchmarks import discrete_shell

BAD = sorted(path for path in (Path(__file__).parents[1] / "data" / "bad").iterdir() if path.suffix in (".obj", ".ply"))


@pytest.fixture(autouse=True)
def _without_opengl(monkeypatch):
    monkeypatch.setenv("MODALSHELL_RENDERER", "built-in")


@pytest.fixture(scope="module")
def leaf(tmp_path_factory):
    path = tmp_path_factory.mktemp("mesh") / "leaf.obj"
    ms.save_mesh(ms.leaf(cells=(16, 6)), path)
    return str(path)


def run(capsys, *arguments):
    status = 0
    try:
        main(list(arguments))
    except SystemExit as exit_:
        status = exit_.code
    captured = capsys.readouterr()
    return status or 0, captured.out, captured.err


@pytest.mark.slow
@pytest.mark.parametrize("model", ["lma", "mwts", "ds"])
def test_simulate_writes_a_film_and_the_positions(capsys, tmp_path, leaf, model):
    options = ["--clamp", "x < 0.08", "--gravity", "0", "0", "-9.81", "--model", model, "--duration", "0.2"]
    status, out, err = run(capsys, "simulate", leaf, *options, "--out", str(tmp_path))
    assert status == 0, err
    assert "completed" in out
    with np.load(tmp_path / f"leaf_{model}.npz", allow_pickle=False) as stored:
        assert stored["positions"].shape[0] == stored["times"].size == 7
        assert np.isfinite(stored["positions"]).all()
        assert stored["positions"][-1, :, 2].mean() < stored["rest"][:, 2].mean()
    assert (tmp_path / f"leaf_{model}.mp4").stat().st_size > 1000


@pytest.mark.slow
def test_simulate_static_writes_a_picture(capsys, tmp_path, leaf):
    status, out, _ = run(capsys, "simulate", leaf, "--clamp", "x < 0.08", "--static", "--out", str(tmp_path))
    assert status == 0
    assert "converged" in out
    assert (tmp_path / "leaf_mwts.png").exists()


@pytest.mark.slow
@pytest.mark.parametrize("static", [True, False])
def test_work_that_does_not_succeed_ends_with_status_1(capsys, tmp_path, leaf, static):
    options = ["--clamp", "x < 0.08", "--gravity", "0", "0", "-1e6", "--thickness", "1e-4", "--out", str(tmp_path)]
    status, out, err = run(capsys, "simulate", leaf, *options, *(["--static"] if static else ["--duration", "0.5"]))
    assert status == 1, out + err
    assert "no fixed point" in out or "wound up" in out
    assert (tmp_path / "leaf_mwts.npz").exists()


def test_export_takes_the_folder_of_one_run(capsys, tmp_path, scene_file):
    ms.run_scene(scene_file(), out=tmp_path / "run")
    status, _, err = run(capsys, "export", str(tmp_path / "run"), "--to", "pc2")
    assert status == 0, err
    assert len(list((tmp_path / "run").glob("*.pc2"))) == 1
    status, _, err = run(capsys, "export", str(tmp_path), "--to", "pc2")
    assert status == 2
    assert "must hold one .npz file (got none)" in err


def test_modes_prints_frequencies_and_draws_shapes(capsys, tmp_path, leaf):
    status, out, _ = run(capsys, "modes", leaf, "--count", "8", "--out", str(tmp_path))
    assert status == 0
    assert out.count("rigid") == 6
    assert out.count("elastic") == 2
    assert (tmp_path / "leaf_modes.png").exists()
    assert ms.Basis.load(tmp_path / "leaf_basis.npz").rigid_modes == 6


@pytest.mark.slow
def test_bench_prints_and_saves_its_rows(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(discrete_shell, "assembly", functools.partial(discrete_shell.assembly, side=32))
    status, out, _ = run(capsys, "bench", "--only", "assembly", "--out", str(tmp_path))
    assert status == 0
    assert "1024" in out
    document = json.loads((tmp_path / "benchmarks_assembly.json").read_text())
    assert document["rows"]["assembly"][0]["faces"] == 1922
    assert (tmp_path / "benchmarks_assembly.md").read_text().startswith("# Benchmarks")


@pytest.mark.parametrize("path", BAD, ids=lambda path: path.name)
def test_bad_meshes_give_one_line_and_status_2(capsys, path):
    status, out, err = run(capsys, "simulate", str(path))
    assert status == 2
    assert out == ""
    assert err.startswith("modalshell: ")
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        (("simulate", "no_such_file.obj"), "no_such_file"),
        (("simulate", "LEAF", "--clamp", "x <"), "selection"),
        (("simulate", "LEAF", "--clamp", "x < -99"), "--clamp selects no vertex"),
        (("simulate", "LEAF", "--clamp", "x < 99"), "--clamp holds all"),
        (("simulate", "LEAF", "--young", "-3"), "--young must be"),
        (("simulate", "LEAF", "--model", "magic"), "magic"),
        (("simulate", "LEAF", "--duration", "0"), "--duration must be"),
        (("simulate", "LEAF", "--duration", "0.01", "--clamp", "x < 0.1"), "--duration must be at least one step"),
        (("simulate", "LEAF", "--thickness", "none.txt"), "--thickness must be a number"),
        (("simulate", "LEAF", "--gravity", "0", "0", "nan"), "--gravity must be finite"),
        (("simulate", "LEAF", "--damping", "-1", "0"), "--damping[0] must be"),
        (("simulate", "LEAF", "--modes", "9999", "--clamp", "x < 0.1"), "--modes must be at most"),
        (("simulate", "LEAF", "--modes", "0"), "--modes must be"),
        (("simulate", "LEAF", "--modes", "2.5"), "--modes: must be a whole number (got 2.5)"),
        (("modes", "LEAF", "--component", "0.5"), "--component: must be a whole number (got 0.5)"),
        (("simulate", "LEAF", "--modes", "2.5e0"), "--modes: must be a whole number (got 2.5e0)"),
        (("simulate", "LEAF", "--modes", "2_5.5"), "--modes: must be a whole number (got 2_5.5)"),
        (("simulate", "LEAF", "--modes", "-2.5"), "--modes: must be a whole number (got -2.5)"),
        (("simulate", "LEAF", "--modes", "inf"), "--modes: must be a whole number (got inf)"),
        (
            ("simulate", "LEAF", "--clamp", "x < 0.1", "--duration", "0.1", "--still", "0.2"),
            "from 0 to 0.1 s (got 0.2)",
        ),
        (
            ("simulate", "LEAF", "--clamp", "x < 0.1", "--static", "--still", "0.2"),
            "--still must be a time of the film",
        ),
        (("simulate", "LEAF", "--gravity", "0", "0"), "gravity"),
        (("reproduce", "--only", "nothing"), "nothing"),
        (("bench", "--only", "nothing"), "nothing"),
        (("fly",), "fly"),
    ],
)
def test_bad_options_give_one_line_and_status_2(capsys, tmp_path, leaf, arguments, match):
    given = [leaf if argument == "LEAF" else argument for argument in arguments]
    status, _, err = run(capsys, *given, *(["--out", str(tmp_path)] if arguments[0] != "fly" else []))
    assert status == 2
    assert match in err
    assert err.startswith("modalshell: ")
    assert err.count("\n") == 1


def test_bundled_meshes_and_scenes_are_found_from_any_folder(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status, out, _ = run(capsys, "repair", "meshes/leaf.obj", "--out", "leaf.ply")
    assert (status, out.splitlines()[-1]) == (0, "leaf.ply")
    status, _, err = run(capsys, "path", "studies/scenes/flat_beam.toml")
    assert status == 2
    assert "has no path of equilibria" in err
    status, _, err = run(capsys, "report", "none.npz", "--scene", "studies/scenes/flat_beam.toml")
    assert (status, "none.json" in err, "studies" in err) == (2, True, False), err
    status, _, err = run(capsys, "repair", "meshes/none.obj", "--out", "leaf2.ply")
    assert "meshes/none.obj: no such file" in err
    assert run(capsys, "page", "--drape", "--out", "studies/scenes/leaf.html")[0] == 0
    assert (tmp_path / "studies" / "scenes" / "leaf.html").is_file()  # outputs go where they were asked for


@pytest.mark.slow
def test_debug_shows_the_traceback():
    command = [sys.executable, "-m", "modalshell", "simulate", "no_such_file.obj"]
    plain = subprocess.run(command, capture_output=True, text=True)
    assert "Traceback" not in plain.stderr
    assert plain.returncode == 2
    with pytest.raises(ms.OptionError, match="no_such_file"):  # Python itself shows where it was raised
        main([*command[3:], "--debug"])


def test_a_warning_is_shown_once(capsys, monkeypatch):
    def warn_twice(*_, **__):
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            for _ in range(2):
                warnings.warn("the sheet is cut open", UserWarning, stacklevel=1)

    monkeypatch.setattr(cli, "app", warn_twice)
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)
    cli.main([])
    assert capsys.readouterr().err.count("cut open") == 1
