"""Reports on runs: their numbers against the package's own, the page, and what is refused."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from guide import ROOT
from printed import check_numbers, stands_for

import modalshell as ms
from modalshell.commands.cli import main
from modalshell.files.atomic_io import read_record, write_record
from modalshell.page.report import plain
from modalshell.run.protocol import result_digest
from modalshell.run.report_numbers import report_numbers

PLATE = """
[mesh]
shape = "sheet"
length = 0.5
width = 0.5
cells = [12, 12]
[material]
young = 210e9
poisson = 0.3
thickness = 1e-3
density = 7850.0
[[supports]]
kind = "pin"
sel = "boundary"
[[loads.pressure]]
p = 200.0
[model]
name = "ds"
[output]
color = "von_mises"
"""


@pytest.fixture
def plate(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MODALSHELL_RENDERER", "built-in")
    (tmp_path / "plate.toml").write_text(PLATE)
    return tmp_path


def command(*arguments):
    """The exit status of a command."""
    with pytest.raises(SystemExit) as end:
        main(["report", *map(str, arguments)])
    return end.value.code or 0


@pytest.mark.slow
def test_a_report_has_the_numbers_of_the_run(plate):
    assert command("plate.toml") == 0
    numbers = json.loads((plate / "results" / "plate_report.json").read_text())
    page = (plate / "results" / "plate_report.html").read_text()
    scene = ms.load_scene(plate / "plate.toml").require_shell()
    shell, run = scene.build_shell(), ms.load_trajectory(plate / "results" / "plate.npz")
    x = run.positions[-1]
    assert numbers["displacement"]["value"] == pytest.approx(np.linalg.norm(x - shell.rest_positions, axis=1).max())
    stresses = shell.fields(x).von_mises_faces
    assert numbers["stress"]["value"] == pytest.approx(stresses.max())
    assert stresses.max(axis=1).argmax() == numbers["stress"]["triangle"]
    assert numbers["load"][2] == pytest.approx(200.0 * 0.25, rel=1e-3)
    np.testing.assert_allclose(numbers["reactions"], -np.array(numbers["load"]), atol=1e-6)
    assert numbers["balance"] < 1e-8
    assert numbers["frequencies"][0] == pytest.approx(19.6, rel=0.02)
    assert numbers["buckling"].startswith("none: linear theory does not hold at the lowest factor")
    for shown in (
        f"{numbers['displacement']['value']:.5g} m",
        f"{numbers['stress']['value'] / 1e6:.5g} MPa",
        numbers["buckling"],
        f"{len(shell.mesh.vertices)} vertices",
        "modalshell report plate.toml",
        "young 2.1e+11",
        "m, kg, s, and so N, Pa: of the numbers below",
    ):
        assert shown in page
    assert not re.search(r'(?:src|href)="https?:', page)
    assert page.count("<img") == 1


@pytest.mark.slow
def test_a_run_by_ds_keeps_its_reactions_and_writes_tables_of_them(plate):
    (plate / "plate.toml").write_text(PLATE.replace('color = "von_mises"', 'formats = ["csv"]\nfields = ["von_mises"]'))
    ran = ms.run_scene("plate.toml", out="results")
    scene = ms.load_scene("plate.toml").require_shell()
    held = scene.build_shell().reactions(ran.answer.positions, loads=[ms.Pressure(200.0)])
    np.testing.assert_array_equal(ran.trajectory.reactions[0], held)
    np.testing.assert_allclose(ran.load, -held.sum(axis=0), atol=1e-6)
    assert f"load (0, 0, {ran.load[2]:.4g}) N in all" in ran.summary
    table = np.genfromtxt("results/plate.csv", delimiter=",", names=True)
    assert table["reaction_z_N"].sum() == pytest.approx(-200.0 * 0.25, rel=1e-3)
    triangles = plate / "results" / "plate_triangles.csv"
    whole = triangles.read_bytes()
    triangles.unlink()
    assert ms.run_scene("plate.toml", out="results").answer is None  # nothing is computed again
    assert triangles.read_bytes() == whole
    record = read_record("results/plate.json")
    ms.save_trajectory(replace(ran.trajectory, reactions=np.empty((0, 0, 3))), "results/plate.npz")  # as once stored
    record["digests"]["npz"] = result_digest(plate / "results", "plate", "npz")
    write_record("results/plate.json", record)
    np.testing.assert_array_equal(ms.run_scene("plate.toml", out="results").trajectory.reactions[0], held)
    for text in (PLATE.replace('"ds"', '"lma"'), PLATE + "[motion]\nduration = 0.001\ndt = 0.001\n"):
        (plate / "plate.toml").write_text(text)
        assert not ms.run_scene("plate.toml", out="others").trajectory.reactions.size


def test_coarser_meshes_come_on_request(plate):
    assert command("plate.toml", "--convergence", "--out", "own.html") == 0
    rows = json.loads((plate / "own.json").read_text())["convergence"]
    assert [row["cells"] for row in rows] == [[6, 6], [8, 8], [12, 12]]
    assert rows[0]["displacement"] != rows[2]["displacement"]
    assert rows[2]["displacement"] == pytest.approx(rows[1]["displacement"], rel=0.05)
    assert "6 x 6" in (plate / "own.html").read_text()
    assert not list(plate.glob("plate.*z"))


def test_a_file_that_cannot_be_written_is_refused_before_the_run(plate, capsys):
    assert command("plate.toml", "--out", "own.txt") == 2
    assert "--out must end in .html" in capsys.readouterr().err
    assert not list(plate.glob("**/plate.*z"))


@pytest.mark.slow
def test_a_run_needs_its_own_scene(plate, capsys):
    assert command("plate.toml") == 0
    archive = plate / "results" / "plate.npz"
    assert command(archive, "--out", "own.html") == 0
    assert command("results", "--out", "by_folder.html") == 0  # as 'open' and 'export' take folders
    of_folder, own = (json.loads((plate / f"{name}.json").read_text()) for name in ("by_folder", "own"))
    assert of_folder.pop("command") == "modalshell report results/plate.npz --scene results/../plate.toml"
    assert {name for name in own if own[name] != of_folder.get(name)} == {"command", "sha256"}
    (plate / "plate.toml").rename("moved.toml")
    assert command("results") == 2
    assert "with --scene FILE (got results/plate.npz, whose record names ../plate.toml" in capsys.readouterr().err
    (plate / "moved.toml").rename("plate.toml")
    (plate / "other.toml").write_text(PLATE.replace("p = 200.0", "p = 100.0"))
    assert command(archive, "--scene", "other.toml") == 2
    assert "is a run of another scene" in capsys.readouterr().err
    assert command(archive, "--scene", "plate.toml", "--out", "again.html") == 0
    (plate / "my scenes").mkdir()
    (plate / "my scenes" / "plate.toml").write_text(PLATE)
    assert command(archive, "--scene", "my scenes/plate.toml", "--out", "named.html") == 0
    told = json.loads((plate / "named.json").read_text())["command"]
    assert told == f"modalshell report {archive} --scene 'my scenes/plate.toml'"
    (plate / "results" / "plate.json").unlink()
    assert command(archive, "--scene", "plate.toml") == 2
    assert "is no record of a run" in capsys.readouterr().err


def test_a_report_on_a_motion_names_when(plate, scene_file):
    file = scene_file(("duration = 1", "duration = 0.2"))
    scene = ms.load_scene(file).require_shell()
    run = ms.run_scene(scene, out=plate / "moved").trajectory
    numbers = report_numbers(scene, scene.build_shell(), run)
    moved = np.linalg.norm(run.positions - run.rest_positions, axis=2)
    assert numbers["displacement"]["time"] == run.times[moved.max(axis=1).argmax()]
    assert (numbers["load"], numbers["balance"], numbers["buckling"]) == (None, None, None)
    assert command(file, "--out", "moved.html") == 0
    assert re.search(r"at \([^)]*\) m, at [\d.]+ s", (plate / "moved.html").read_text())


def test_a_report_on_a_free_shell_has_its_frequencies(plate):
    """Rigid motions took the places of all, and the page had a unit alone."""
    free = (
        PLATE.replace("width = 0.5", "width = 0.3")
        .replace('[[supports]]\nkind = "pin"\nsel = "boundary"\n', "")
        .replace('"ds"', '"rigid"')
    )
    (plate / "free.toml").write_text(free + "[motion]\nduration = 0.1\n")
    scene = ms.load_scene("free.toml").require_shell()
    shell, run = scene.build_shell(), ms.run_scene(scene, out="results").trajectory
    expected = ms.solve_modes(shell, 12).frequencies[6:]
    np.testing.assert_allclose(report_numbers(scene, shell, run)["frequencies"], expected, rtol=1e-6)


@pytest.mark.slow
def test_what_a_constraint_bears_is_not_called_missing(plate):
    held = (
        '[[constraints]]\nkind = "position"\nnearest = [0.25, 0.0, 0.0]\nrelative = true\ntarget = [0.0, 0.0, 1e-3]\n'
    )
    (plate / "held.toml").write_text(PLATE + held)
    assert command("held.toml") == 0
    numbers = json.loads((plate / "results" / "held_report.json").read_text())
    assert (numbers["load"], numbers["balance"]) == (None, None)


def test_reactions_are_told_of_answers_in_balance_alone(plate):
    """Those of LMA would be of a membrane that its answer stretches."""
    (plate / "modes.toml").write_text(PLATE.replace('"ds"', '"lma"'))
    assert command("modes.toml") == 0
    numbers = json.loads((plate / "results" / "modes_report.json").read_text())
    assert numbers["load"][2] == pytest.approx(200.0 * 0.25, rel=1e-3)
    assert (numbers["reactions"][:5], numbers["balance"]) == ("none:", None)
    page = (plate / "results" / "modes_report.html").read_text()
    assert "Resultant of the reactions" in page
    assert "Missing to their balance" not in page


@pytest.mark.slow
def test_reactions_and_stresses_of_a_yielded_crease_are_those_of_its_fold(plate):
    text = (
        PLATE[: PLATE.index("[[supports]]")].replace("12]", "3]")
        + """
[[supports]]
kind = "clamp"
sel = "x < 0.01"
[loads]
gravity = [0.0, 0.0, -30.0]
[model]
name = "ds"
[[creases]]
sel = "x > 0.24 and x < 0.26"
yield_moment = 0.2
[output]
fields = ["von_mises_faces"]
"""
    )
    (plate / "creased.toml").write_text(text)
    assert command("creased.toml") == 0
    numbers = json.loads((plate / "results" / "creased_report.json").read_text())
    run = ms.load_trajectory(plate / "results" / "creased.npz")
    assert np.abs(run.crease_angles).max() > 0.1
    folds, kept = numbers["creases"], run.crease_angles[-1]
    assert abs(folds["largest"]) == np.abs(kept).max()
    assert folds["largest"] in kept
    assert (folds["edges"], folds["yielded"], folds["heat"]) == (len(kept), (kept != 0).sum(), run.crease_heat[-1])
    page = (plate / "results" / "creased_report.html").read_text()
    assert f"{folds['yielded']} of {len(kept)} edges have yielded; " in page
    assert f"stays {np.degrees(folds['largest']):.4g}°" in page
    assert numbers["balance"] < 1e-6
    assert numbers["stress"]["value"] == pytest.approx(run.fields["von_mises_faces"].max())


def test_a_report_has_the_error_bar_of_its_run(plate):
    text = PLATE.replace('name = "ds"', 'name = "mwts"').replace("[mesh]", "bar = true\n[mesh]", 1)
    text = text.replace('kind = "pin"', 'kind = "clamp"').replace('sel = "boundary"', 'sel = "x < 0.05"')
    (plate / "barred.toml").write_text(text.replace("p = 200.0", "p = 0.5"))
    assert command("barred.toml") == 0
    numbers = json.loads((plate / "results" / "barred_report.json").read_text())
    assert "from DS" in numbers["bar"]
    assert numbers["bar"].replace("<", "&lt;") in (plate / "results" / "barred_report.html").read_text()


@pytest.mark.slow
def test_a_report_prints_on_two_pages(plate, browser):
    assert command("plate.toml", "--convergence") == 0
    page = browser.new_page(viewport={"width": 390, "height": 800})
    page.goto((plate / "results" / "plate_report.html").as_uri())
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    page.pdf(path=plate / "plate.pdf", prefer_css_page_size=True)
    assert len(re.findall(rb"/Type\s*/Page\b", (plate / "plate.pdf").read_bytes())) == 2
    page.close()


def test_a_report_says_what_is_too_coarse_and_what_is_not_joined(plate, capsys):
    coarse = PLATE.replace("cells = [12, 12]", "cells = [4, 4]")
    assert coarse != PLATE
    (plate / "coarse.toml").write_text(coarse)
    assert command("coarse.toml") == 0
    numbers = json.loads((plate / "results" / "coarse_report.json").read_text())
    assert any(text.startswith("frequencies: ") and "half wave" in text for text in numbers["warnings"])
    assert "half wave" in (plate / "results" / "coarse_report.html").read_text()
    ms.save_mesh(ms.sheet(length=1.0, width=1.0, cells=(4, 4)), plate / "own.obj")
    start, end = PLATE.index("[mesh]"), PLATE.index("[material]")
    (plate / "own.toml").write_text(PLATE[:start] + '[mesh]\nfile = "own.obj"\n' + PLATE[end:])
    capsys.readouterr()
    assert command("own.toml", "--convergence") == 2
    assert "one from a file has no coarser one" in capsys.readouterr().err
    assert not (plate / "results" / "own.npz").exists()
    (plate / "numbers.toml").write_text(PLATE.replace('"boundary"', "[0, 12, 156, 168]"))  # its corners, on that mesh
    assert command("numbers.toml", "--convergence") == 2
    assert "sel selects vertices by number, and those are others on a coarser mesh" in capsys.readouterr().err


def test_a_number_stands_for_a_value_to_its_own_digits():
    assert stands_for("1.235", 1.2349)
    assert stands_for("1.235", 1.2349e6)
    assert stands_for("12", 0.1203)
    assert not stands_for("1.235", 1.2341)
    assert not stands_for("-1.235", 1.235)


@pytest.mark.slow
def test_the_report_on_the_plate_of_the_readme_prints_on_two_pages_of_its_own_numbers(tmp_path, monkeypatch, browser):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MODALSHELL_RENDERER", "built-in")
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (scene,) = [part for part in re.findall(r"```toml\n(.*?)```", text, re.DOTALL) if 'shape = "sheet"' in part]
    (tmp_path / "plate.toml").write_text(scene)
    assert command("plate.toml") == 0
    page = browser.new_page()
    page.goto((tmp_path / "results" / "plate_report.html").as_uri())
    page.pdf(path=tmp_path / "plate.pdf", prefer_css_page_size=True)
    assert len(re.findall(rb"/Type\s*/Page\b", (tmp_path / "plate.pdf").read_bytes())) == 2
    rows = page.eval_on_selector_all("tr", "rows => rows.map(row => [...row.children].map(cell => cell.innerText))")
    page.close()
    files = [json.loads(path.read_text()) for path in (tmp_path / "results").glob("*.json")]
    assert check_numbers(rows, files) > 30


def test_a_table_is_written_with_its_zeros_and_short_numbers():
    """Poisson's ratio 0 was left out as if it were not set, and moduli of two directions had all their digits."""
    table = {"young": (2e8, 5e7), "poisson": 0.0, "calibrated": False, "times": None, "entries": []}
    assert plain(table) == "young (2e+08, 5e+07); poisson 0"
    assert plain({"translations": [[0, 0, 0], [0, 0, 0.05]]}) == "translations (0, 0, 0); (0, 0, 0.05)"
