"""A study takes two modules, one that computes and one that draws; those of CONTRIBUTING.md run as their own would."""

import importlib
import sys

import pytest
from guide import source

import paper_figures
import studies
from modalshell.files.study_result import StudyResult
from studies.reproduce import reproduce
from studies.reproduce import studies as known_studies

NAME = "tip_drop"


@pytest.fixture
def toy(tmp_path, monkeypatch):
    """The two modules in folders that the packages look into as well."""
    for package in (studies, paper_figures):
        folder = tmp_path / package.__name__
        folder.mkdir()
        (folder / f"{NAME}.py").write_text(source(f"{package.__name__}/{NAME}.py"), encoding="utf-8")
        monkeypatch.setattr(package, "__path__", [*package.__path__, str(folder)])
    monkeypatch.setenv("MODALSHELL_RENDERER", "built-in")
    importlib.invalidate_caches()
    known_studies.cache_clear()
    yield
    known_studies.cache_clear()
    for package in (studies, paper_figures):
        sys.modules.pop(f"{package.__name__}.{NAME}", None)
        vars(package).pop(NAME, None)


@pytest.mark.usefixtures("toy")
def test_the_study_of_the_guide_is_found_run_and_drawn(tmp_path):
    written = reproduce(NAME, tmp_path, tmp_path / "figures", quick=True)
    assert {path.name for path in written} == {f"{NAME}{suffix}" for suffix in (".npz", ".json", ".md", ".png")}
    result = StudyResult.load(tmp_path, NAME)
    rows = result.findings["rows"]
    assert [row["gravity"] for row in rows] == [1.0, 2.0, 4.0]
    assert all(0.0 < row["drops"]["ds"] < 0.4 for row in rows)
    assert all(abs(row["drops"]["mwts"] / row["drops"]["ds"] - 1.0) < 0.1 for row in rows)
    assert f"| 4 | {rows[-1]['drops']['mwts']:.4f} |" in (tmp_path / f"{NAME}.md").read_text(encoding="utf-8")
    assert known_studies()[NAME].finding(result).startswith("At the largest load the tip drops 0.")
