"""Tutorials: each script runs from its first cell to its last, and says what it promises."""

import runpy
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[2] / "studies" / "tutorials"
PROMISES = {
    "first_film": ("converged", "completed 31 frames"),
    "plate_stress": ("converged", "reactions -200.000 N"),
    "snap": ("limit at", "linear buckling at"),
    "which_model": ("MWTS: ", "| rung |", "Take "),
}
WRITES = {"first_film": ("leaf.html", "leaf.clip", "modes.png"), "which_model": ("tradeoff.png",)}
SLOW = {"which_model"}


def test_every_tutorial_is_run():
    assert {path.stem for path in FOLDER.glob("*.py")} - {"__init__"} == set(PROMISES)


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] * (name in SLOW)) for name in PROMISES])
def test_a_tutorial_runs(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MODALSHELL_RENDERER", "built-in")
    text = (FOLDER / f"{name}.py").read_text(encoding="utf-8")
    assert text.count("# %%") >= 6
    found = runpy.run_path(str(FOLDER / f"{name}.py"))
    said = capsys.readouterr().out
    for promise in PROMISES[name]:
        assert promise in said
    assert all((tmp_path / file).stat().st_size > 1000 for file in WRITES.get(name, ()))
    if name == "plate_stress":
        assert found["deflection"] == pytest.approx(found["navier"], rel=0.03)
        assert found["at_middle"] == pytest.approx(found["expected"], rel=0.05)
