"""Meshes that other packages bring: which are tried, and what their table says."""

import json
from pathlib import PurePosixPath

import numpy as np
import pytest
import trimesh

import modalshell as ms
from modalshell.files.study_result import StudyResult
from modalshell.mesh.files import read_polygons
from studies import strangers, strangers_meshes


class File(PurePosixPath):
    """An entry of a distribution's list of files."""

    folder = None

    def locate(self):
        return File.folder / self


class Package:
    def __init__(self, name, *files):
        self.name, self.files = name, [File(file) for file in files]


def test_files_are_taken_from_many_folders_of_each_package(tmp_path, monkeypatch):
    monkeypatch.setattr(File, "folder", tmp_path)
    monkeypatch.setattr(strangers, "LARGEST_FILE", 100)
    packages = [
        Package(
            "one", *(f"one/a/{k}.stl" for k in range(5)), "one/b/x.obj", "one/c.ply", "one/code.py", "one/huge.off"
        ),
        Package("modalshell", "modalshell/leaf.obj"),
        Package("copies", "copies/0.stl"),
        Package("none"),
        Package("gone", "gone/lost.stl"),
    ]
    packages[3].files = None
    for number, file in enumerate(file for package in packages[:3] for file in package.files):
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file).write_bytes(b"x" * (200 if "huge" in str(file) else 10 + number))
    (tmp_path / "copies/0.stl").write_bytes((tmp_path / "one/a/0.stl").read_bytes())
    monkeypatch.setattr(strangers, "distributions", lambda: packages)

    def names(per_package):
        return [stranger.name for stranger in strangers.installed_files(per_package)]

    assert names(3) == ["copies: 0.stl", "one: 3.stl", "one: x.obj", "one: c.ply"]
    assert len(names(5)) == 6
    assert len(names(99)) == 7  # of copies the first one
    assert all("huge" not in name and "leaf" not in name for name in names(99))


def test_items_are_spread_evenly():
    assert strangers.spread([], 3) == []
    assert strangers.spread("abc", 9) == list("abc")
    assert strangers.spread(range(11), 3) == [0, 5, 10]


@pytest.mark.slow
def test_generated_shapes_are_written_as_they_are(tmp_path):
    found = strangers.generated(tmp_path, 99, only="trimesh")
    assert len(found) >= 10
    torus = next(one for one in found if one.name == "trimesh: torus")
    expected = trimesh.creation.torus(major_radius=1.0, minor_radius=0.3)
    assert ms.load_mesh(torus.path).area == pytest.approx(expected.area)
    assert all(len(read_polygons(one.path).sizes) for one in found)
    assert len(strangers.generated(tmp_path, 3, only="trimesh")) == 3


def test_a_missing_package_is_skipped(tmp_path, monkeypatch):
    monkeypatch.setattr(strangers, "GENERATORS", {"no_such_package": None})
    assert strangers.generated(tmp_path, 3) == []


def entry(told, seconds=3.0, moved=None):
    return {"film": told == "film", "message": told, "seconds": seconds, "moved": moved, "traceback": False}


def test_the_table_and_the_finding_tell_films_repairs_and_refusals():
    refused = entry("refused: a.obj: edge (0, 2) has 3 faces")
    rows = [
        {"name": "p: a", "triangles": 1200, "parts": 2, "repair": ["split 1 edges"], "plain": refused,
         "mended": entry("film", 7.0, 0.2)},
        {"name": "p: b", "triangles": 20, "parts": 1, "repair": [], "plain": entry("film", 2.0, 0.15),
         "mended": entry("film", 2.0, 0.15)},
        {"name": "q: c", "triangles": 30, "parts": 30, "repair": [], "plain": refused, "mended": refused},
    ]  # fmt: skip
    result = StudyResult("strangers_meshes", {"rows": rows, "unread": []}, {}, {})
    lines = [line.split(" | ") for line in strangers_meshes.table(result).splitlines() if line.startswith("| ")]
    heads, *cells, unread = lines
    assert [line[heads.index("with it")] for line in cells] == ["film", "the same", "the same"]
    assert [line[-1] for line in cells] == ["20 |", "15 |", "- |"]
    assert unread == ["| file", "message |"]
    told = strangers_meshes.finding(result)
    assert "of 1 of 3 meshes of 2 other packages, with `--repair` of 2, one of the two or both of 2;" in told
    assert "none comes of q: c." in told
    assert "slowest took 7 s of one core; the largest mesh has 1,200 triangles" in told


def test_parts_that_nothing_holds_are_found():
    faces = np.array([[0, 1, 2], [2, 1, 3], [4, 5, 6]])
    assert strangers_meshes._loose_parts(faces, np.array([True] + 6 * [False])) == 1
    assert strangers_meshes._loose_parts(faces, np.array([True] + 3 * [False] + [True] + 2 * [False])) == 0


@pytest.mark.slow
def test_the_quick_study_gives_pictures_and_no_traceback(quick_study):
    folder = quick_study("strangers_meshes")
    rows = json.loads((folder / "strangers_meshes.json").read_text())["findings"]["rows"]
    assert len(rows) == len(strangers_meshes.QUICK)
    for row in rows:
        assert not row["plain"]["traceback"]
        assert row["plain"]["film"] != (row["name"] == "trimesh: soup")
    (soup,) = (row for row in rows if row["name"] == "trimesh: soup")
    assert "30 single triangles" in soup["plain"]["message"]
