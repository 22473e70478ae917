"""Six scenes by several engines: errors of this package, rows of others, and the page."""

import numpy as np
import pytest

import modalshell as ms
from modalshell.compare.engines import EngineAnswer
from modalshell.files.study_result import StudyResult
from studies import engines


def test_an_exact_answer_has_no_error():
    scene = engines.strip(True)
    length, (reach, fall) = engines.STRIP["length"], engines.ELASTICA[3.0]
    exact = np.array(scene.shell.rest_positions)
    tip = exact[:, 0] > length - 1e-9
    exact[tip, 0], exact[tip, 2] = length * reach, -length * fall
    assert scene.error(exact, 1) < 1e-9
    assert scene.error(exact, 2) > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("make", [engines.strip, engines.swept, engines.cloth])
def test_the_shells_of_this_package_are_near_the_truth(make):
    row = engines.ours(make(True), "ds")
    assert row["outcome"] == "counts"
    assert row["errors"][0] < 0.035
    assert row["seconds"] > 0.0


def test_an_engine_that_stops_at_a_load_has_errors_up_to_it(monkeypatch):
    scene = engines.swept(True)
    rest = scene.shell.rest_positions
    answer = EngineAnswer("Fake", "counts", "1", 0.0, 1.0, None, None, rest[None], "no equilibrium beyond load 1")
    monkeypatch.setattr(engines, "answered", lambda *_: answer)
    row = engines.foreign(scene, engines.ENGINES[0])
    assert row["errors"] == [pytest.approx(1.0), None, None, None]
    told = engines.table(StudyResult("engines", {"rows": [{"scene": "a", "truth": "b", **row}], "plates": []}, {}, {}))
    assert "counts: no equilibrium beyond load 1 | 100.00, -, -, -" in told


def test_plates_are_compared_with_ritz():
    row = engines.our_plate(12)
    assert np.abs(row["deviations"]).max() < 0.08
    assert len(row["deviations"]) == engines.MODES
    assert ms.solve_modes(engines.plate(4), 1).frequencies[0] > 0.0


def test_a_quick_run_says_what_it_leaves_out(quick_study):
    result = StudyResult.load(quick_study("engines"), "engines")
    assert "left out of a quick run" in engines.table(result)
