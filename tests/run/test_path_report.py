"""Reports on equilibrium paths: their numbers against the path's own, and the page."""

import json
import re

import numpy as np
import pytest
from printed import check_numbers, rows_of
from scenes import stiff_beam_text

import modalshell as ms
from modalshell.commands.cli import main
from modalshell.run.path_files import scene_path
from modalshell.run.path_report import path_numbers

SNAPPING = (
    stiff_beam_text(40)
    + """[loads]
gravity = [0.0, 0.0, -70.0]
[model]
name = "ds"
[path]
branches = 1
"""
)


def command(*arguments):
    """The exit status of a command."""
    with pytest.raises(SystemExit) as end:
        main(["report", *map(str, arguments)])
    return end.value.code or 0


@pytest.fixture(scope="module")
def reported(tmp_path_factory):
    """A folder with the report on a beam that bifurcates and snaps."""
    folder = tmp_path_factory.mktemp("reported")
    (folder / "snap.toml").write_text(SNAPPING)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setenv("MODALSHELL_RENDERER", "built-in")
        assert command("snap.toml", "--path") == 0
    return folder


def test_a_report_has_the_numbers_of_the_path(reported):
    numbers = json.loads((reported / "results" / "snap_path_report.json").read_text())
    stored = np.load(reported / "results" / "snap_path.npz")
    assert [one["name"] for one in numbers["paths"]] == ["path", "branch 1", "branch 2"]
    for begin, one in zip(("", "branch_1_", "branch_2_"), numbers["paths"], strict=True):
        for key in ("factors", "displacements", "unstable_directions", "residuals"):
            np.testing.assert_array_equal(one[key], stored[f"{begin}{key}"])
        assert [event["kind"] for event in one["events"]] == stored[f"{begin}event_kinds"].tolist()
        for event in one["events"]:
            assert event["factor"] == pytest.approx(one["factors"][event["point"]], rel=1e-9)
            assert event["displacement"] == one["displacements"][event["point"]]
        assert sum(part["points"] for part in one["parts"]) == len(one["factors"])
        counts = np.repeat([p["unstable_directions"] for p in one["parts"]], [p["points"] for p in one["parts"]])
        np.testing.assert_array_equal(counts, one["unstable_directions"])
    kinds = {event["kind"] for one in numbers["paths"] for event in one["events"]}
    assert kinds == {"limit", "bifurcation"}
    bifurcation = numbers["paths"][0]["events"][0]
    # The point of a bifurcation is singular: its own sign is rounding.
    assert numbers["paths"][0]["parts"][0]["points"] - bifurcation["point"] in (0, 1)
    assert numbers["paths"][1]["leaves"] == bifurcation["point"]


def test_every_printed_number_is_in_the_file(reported):
    page = (reported / "results" / "snap_path_report.html").read_text()
    numbers = json.loads((reported / "results" / "snap_path_report.json").read_text())
    assert check_numbers(rows_of(page), [numbers]) > 200
    assert page.count("<img") == 2
    assert not re.search(r'(?:src|href)="https?:', page)
    for event in numbers["paths"][0]["events"]:
        assert f"{event['factor']:.6g}" in page
    assert "modalshell report snap.toml --path" in page


@pytest.mark.slow
def test_a_path_without_events_says_so_and_one_that_ends_early_why(reported):
    text = SNAPPING.replace("branches = 1", "until = 0.05")
    (reported / "calm.toml").write_text(text)
    scene = ms.load_scene(reported / "calm.toml").require_shell()
    numbers = path_numbers(scene, scene.build_shell(), scene_path(scene))
    (one,) = numbers["paths"]
    assert (one["events"], len(one["parts"]), one["factors"][-1]) == ([], 1, 0.05)
    short = path_numbers(scene, scene.build_shell(), scene_path(scene, points=2, until=1.0))
    assert short["outcome"] != "converged"
    assert short["message"]


def test_a_path_of_a_scene_refuses_loads_that_follow_the_shell(tmp_path):
    """They were left out in silence beside others."""
    (tmp_path / "a.toml").write_text(SNAPPING.replace("[model]", "[[loads.pressure]]\np = 1.0\n[model]"))
    with pytest.raises(ms.SceneError, match="path: a path is followed under dead loads"):
        scene_path(ms.load_scene(tmp_path / "a.toml"))


def test_path_goes_with_scenes_alone(reported, monkeypatch, capsys):
    monkeypatch.chdir(reported)
    (reported / "sweep.toml").write_text('scene = "snap.toml"\n[axes]\n"mesh.fold" = [140.0]\n')
    for arguments in (["results", "--path"], ["sweep.toml", "--path"]):
        assert command(*arguments) == 2
        assert "--path goes with a scene file" in capsys.readouterr().err
    assert command("snap.toml", "--path", "--convergence") == 2
    assert "--convergence is for the run of a scene" in capsys.readouterr().err
    (reported / "mine").mkdir()
    monkeypatch.chdir(reported / "mine")
    (reported / "mine" / "own.json").write_text('{"mine": 1}')
    assert command("../snap.toml", "--path", "--out", "own.html") == 2
    assert "own.json' is there already" in capsys.readouterr().err


@pytest.mark.slow
def test_a_report_on_a_path_prints_and_fits_a_phone(reported, browser):
    page = browser.new_page(viewport={"width": 390, "height": 800})
    page.goto((reported / "results" / "snap_path_report.html").as_uri())
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    page.pdf(path=reported / "snap.pdf", prefer_css_page_size=True)
    page.set_viewport_size({"width": 700, "height": 900})  # about a printed page: no table is cut there
    assert page.evaluate("[...document.querySelectorAll('.data')].every(one => one.scrollWidth <= one.clientWidth)")
    assert 2 <= len(re.findall(rb"/Type\s*/Page\b", (reported / "snap.pdf").read_bytes())) <= 4
    page.close()
