"""Engines as rows: what counts, what does not, and what is missing."""

import numpy as np
import pytest

from modalshell.study import StudyResult
from studies import engines

ENGINE = engines.Engine("none", "none", "pip install none", {"step": 1.0, "duration": 2.0, "limit": 9.0})
CASE = engines.case_of(engines.STRIP, (engines.SMALL, *engines.ELASTICA), ENGINE)


def exact():
    """An answer without error."""
    length = engines.STRIP["length"]
    tips = [[length, 0.0, -length * engines.SMALL / 8.0]]
    tips += [[length * reach, 0.0, -length * fall] for reach, fall in engines.ELASTICA.values()]
    mass = float(np.delete(CASE["masses"], CASE["held"]).sum())
    return {"version": "1", "tips": tips, "seconds": [1.0] * 4, "steps": [2] * 4, "mass": mass}


def test_an_exact_answer_counts_without_error():
    row = engines.judged("engine", exact(), engines.STRIP, CASE)
    assert row["outcome"] == "counts"
    assert np.abs(row["errors"]).max() < 1e-9


@pytest.mark.parametrize(
    ("change", "outcome"),
    [
        ({"mass": 1.0}, "conversion check failed: mass"),
        ({"steps": [2, 1, 2, 2]}, "not at rest after 9 s a load"),
        ({"outcome": "not installed: pip install none"}, "not installed"),
    ],
)
def test_what_fails_its_checks_has_no_errors(change, outcome):
    row = engines.judged("engine", exact() | change, engines.STRIP, CASE)
    assert row["outcome"].startswith(outcome)
    assert "errors" not in row
    soft = exact()
    soft["tips"][0][2] *= 1.2
    row = engines.judged("engine", soft, engines.STRIP, CASE)
    assert row["outcome"] == "conversion check failed: small drop +20 %"
    assert "errors" not in row


def test_processes_that_fail_are_rows(monkeypatch, tmp_path):
    monkeypatch.delenv("MODALSHELL_ENGINES", raising=False)
    monkeypatch.setattr(engines, "ADAPTERS", tmp_path)
    (tmp_path / "none.py").write_text("import no_such_engine")
    assert engines.run(ENGINE, CASE) == {"outcome": "not installed: pip install none"}
    (tmp_path / "none.py").write_text("import os; os._exit(7)")
    assert engines.run(ENGINE, CASE)["outcome"] == "ended with status 7: no message"
    (tmp_path / "none.py").write_text(
        "import json, sys; print('noise'); print(json.dumps({'got': json.load(sys.stdin)}))"
    )
    assert engines.run(ENGINE, CASE)["got"]["cells"] == [20, 2]
    monkeypatch.setattr(engines, "SECONDS", 0.5)
    (tmp_path / "none.py").write_text("import time; time.sleep(60)")
    assert engines.run(ENGINE, CASE)["outcome"] == "stopped after 0.5 s"
    monkeypatch.setenv("MODALSHELL_ENGINES", str(tmp_path / "no_python"))
    assert engines.run(ENGINE, CASE)["outcome"].startswith("did not start")


def test_the_shells_of_this_package_count():
    for energy, bound in (("Isotropic", 0.005), ("hinges", 0.01)):
        row = engines.ours(energy)
        assert row["outcome"] == "counts"
        assert max(row["errors"]) < bound


def test_a_quick_run_says_what_it_leaves_out(quick_study):
    result = StudyResult.load(quick_study("engines"), "engines")
    assert "left out of a quick run" in engines.table(result)
