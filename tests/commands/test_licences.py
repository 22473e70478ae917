"""The licences of what modalshell installs: all known, and nothing copyleft without a word."""

import tomllib

import pytest
from guide import ROOT

from modalshell.commands import licences as module
from modalshell.commands.cli import main
from modalshell.commands.licences import KNOWN, WORDS, Licence, licences, requirements

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def test_every_dependency_and_extra_is_listed():
    found = requirements()
    assert set(found) == set(KNOWN)
    assert {name for name, groups in found.items() if "core" in groups} == {
        module._name(line) for line in PROJECT["dependencies"]
    }
    assert found["pyvista"] == {"vtk", "web", "test", "dev"}  # extras of extras too
    assert found["pymeshlab"] == {"remesh", "dev"}
    assert set().union(*found.values()) == {"core", *PROJECT["optional-dependencies"]}


@pytest.mark.slow
def test_nothing_copyleft_stands_without_a_word():
    rows = licences()
    assert {row.package for row in rows if row.copyleft} <= set(WORDS)
    assert [row.package for row in rows if row.licence == "unknown"] == []
    assert {row.package for row in rows if row.copyleft and "core" in row.needed_by} == {"imageio-ffmpeg"}
    assert len(rows) > len(KNOWN)


def test_what_is_known_agrees_with_what_is_installed():
    for row in licences():
        if row.package in KNOWN and row.version:
            known = Licence(row.package, KNOWN[row.package], (), "")
            assert known.copyleft == row.copyleft, row


@pytest.mark.parametrize(
    ("licence", "expected"),
    [
        ("MIT", False),
        ("GPL3", True),
        ("LGPL-2.1-or-later", True),
        ("MPL-2.0", True),
        ("MIT OR GPL-2.0-only", False),
        ("BSD-3-Clause AND GPL-3.0-only", True),
        ("GNU General Public License v3", True),
        ("Apache-2.0 WITH LLVM-exception", False),
    ],
)
def test_copyleft_is_seen(licence, expected):
    assert Licence("toy", licence, (), "").copyleft is expected


@pytest.mark.slow
def test_a_package_without_a_word_ends_the_command_with_one(monkeypatch, capsys):
    with pytest.raises(SystemExit) as end:
        main(["licences"])
    assert end.value.code in (None, 0)
    said = capsys.readouterr().out
    assert "pymeshlab: only the extras remesh and dev install it" in said
    assert "modalshell is under MIT" in said
    monkeypatch.setattr(module, "WORDS", {name: word for name, word in WORDS.items() if name != "imageio-ffmpeg"})
    with pytest.raises(SystemExit) as end:
        main(["licences"])
    assert end.value.code == 1
    assert "imageio-ffmpeg: copyleft, and nothing is known of it here" in capsys.readouterr().out


def test_an_installed_copy_reads_its_own_metadata(tmp_path, monkeypatch):
    class Toy:
        requires = ("numpy>=1.26", "modalshell[vtk]; extra == 'web'", "pyvista>=0.44; extra == 'vtk'")

    monkeypatch.setattr(module, "distribution", lambda _: Toy())
    assert requirements(tmp_path / "none.toml") == {"numpy": {"core"}, "pyvista": {"vtk", "web"}}
