"""Golden numbers: what the quick studies find, kept in ``tests/golden/NAME.json`` with a tolerance each.

Every study (a module of ``studies`` with ``FIGURES``) has 4 to 10 of them, physical ones and no timings::

    {"tip drop of the flat beam, DS": {"path": "rows/beam=flat,flexure_factor=1.0/ds_tip_drop",
                                       "value": 0.8598, "relative": 1e-5, "why": "DS is solved to 1e-7 of its load"}}

``path`` leads through the study's findings: keys of dictionaries, and in a list either an index or ``key=value`` pairs
of the entry that is meant (rows that are sorted by time move from run to run). The tolerance is ``relative`` or
``absolute``; ``why`` says where it comes from. For a new study write such a file with any values and let
``python -m pytest tests/studies/test_golden.py --accept-golden -k NAME -m 'slow or not slow'`` fill them in: that
writes values, never tolerances.
"""

import json
import math
from pathlib import Path

import pytest

from modalshell.files.atomic_io import write_text
from modalshell.files.study_result import StudyResult
from studies.reproduce import studies

GOLDEN = Path(__file__).resolve().parents[1] / "golden"
TOLERANCES = ("relative", "absolute")


def number_at(findings, path):
    """The finding at ``path`` as a float; AssertionError where there is none."""
    value = findings
    for step in path.split("/"):
        if isinstance(value, list) and "=" in step:
            wanted = dict(pair.split("=", 1) for pair in step.split(","))
            value = [entry for entry in value if all(str(entry.get(key)) == text for key, text in wanted.items())]
            assert len(value) == 1, f"{path}: {len(value)} entries match {step}"
            value = value[0]
        else:
            try:
                value = value[int(step) if isinstance(value, list) else step]
            except (KeyError, IndexError, ValueError, TypeError) as fault:
                raise AssertionError(f"the study found nothing at {path} (no {step!r} there)") from fault
    assert isinstance(value, int | float), f"{path} is no number but {value!r}"
    assert math.isfinite(value), f"{path} is not finite"
    return float(value)


def check(name, findings, folder=GOLDEN, *, accept=False):
    """Hold the findings of a study against its golden numbers, or take them as these where ``accept`` says so."""
    command = f"python -m pytest tests/studies/test_golden.py --accept-golden -k {name} -m 'slow or not slow'"
    file = folder / f"{name}.json"
    assert file.is_file(), (
        f"study {name} has no golden numbers: write {file} (see the head of this test), then {command}"
    )
    golden = json.loads(file.read_text(encoding="utf-8"))
    found = {title: number_at(findings, entry["path"]) for title, entry in golden.items()}
    if accept:
        accepted = {title: entry | {"value": found[title]} for title, entry in golden.items()}
        write_text(file, json.dumps(accepted, indent=1) + "\n")
        return
    changed = []
    for title, entry in golden.items():
        (kind,) = (kind for kind in TOLERANCES if kind in entry)
        allowed = entry[kind] * (abs(entry["value"]) if kind == "relative" else 1.0)
        if not abs(found[title] - entry["value"]) <= allowed:
            tolerance = f"{kind} tolerance {entry[kind]:g}"
            changed.append(f"  {title}: old {entry['value']!r}, new {found[title]!r}, {tolerance} ({entry['why']})")
    assert not changed, "\n".join(
        [f"golden numbers of {name} changed:", *changed, f"if the new ones are right, accept them: {command}"]
    )


@pytest.mark.by_default("v_beam_accuracy")
@pytest.mark.parametrize("name", studies())
def test_golden_numbers(name, quick_study, request):
    findings = StudyResult.load(quick_study(name), name).findings
    check(name, findings, accept=request.config.getoption("--accept-golden"))


@pytest.mark.parametrize("name", studies())
def test_golden_files_are_of_physics_and_say_why(name):
    golden = json.loads((GOLDEN / f"{name}.json").read_text(encoding="utf-8"))
    assert 4 <= len(golden) <= 10, f"{GOLDEN / f'{name}.json'} has {len(golden)} golden numbers, a study has 4 to 10"
    for entry in golden.values():
        assert set(entry) - set(TOLERANCES) == {"path", "value", "why"}
        (tolerance,) = (entry[kind] for kind in TOLERANCES if kind in entry)
        assert tolerance > 0.0
        assert "relative" not in entry or tolerance <= 0.05
        assert len(entry["why"]) > 10
        assert not any(word in entry["path"] for word in ("second", "_ms", "preprocessing", "statics", "motion/"))


def test_no_golden_file_without_a_study():
    assert {file.stem for file in GOLDEN.glob("*.json")} == set(studies())


FINDINGS = {"rows": [{"beam": "flat", "factor": 1.0, "drop": 0.5}, {"beam": "v", "factor": 1.0, "drop": 0.25}], "n": 3}


@pytest.fixture
def golden(tmp_path):
    entries = {
        "drop": {"path": "rows/beam=v,factor=1.0/drop", "value": 0.25, "relative": 1e-3, "why": "to show it"},
        "count": {"path": "n", "value": 3.0, "absolute": 0.5, "why": "an integer"},
    }
    (tmp_path / "shown.json").write_text(json.dumps(entries))
    return tmp_path


def test_numbers_within_their_tolerances_pass(golden):
    check("shown", FINDINGS, golden)
    check("shown", json.loads(json.dumps(FINDINGS).replace("0.25", "0.2502")), golden)


def test_a_changed_number_fails_with_old_new_tolerance_and_command(golden):
    changed = json.loads(json.dumps(FINDINGS).replace("0.25", "0.26"))
    with pytest.raises(AssertionError) as caught:
        check("shown", changed, golden)
    message = str(caught.value)
    assert "drop: old 0.25, new 0.26, relative tolerance 0.001 (to show it)" in message
    assert "python -m pytest tests/studies/test_golden.py --accept-golden -k shown" in message
    assert "count" not in message


def test_accepting_writes_the_values_and_nothing_else(golden):
    changed = json.loads(json.dumps(FINDINGS).replace("0.25", "0.26"))
    before = json.loads((golden / "shown.json").read_text())
    check("shown", changed, golden, accept=True)
    check("shown", changed, golden)
    after = json.loads((golden / "shown.json").read_text())
    assert after["drop"]["value"] == 0.26
    before["drop"]["value"] = 0.26
    assert after == before


def test_a_study_without_golden_numbers_fails(golden):
    with pytest.raises(AssertionError, match=r"study other has no golden numbers: write .*other\.json"):
        check("other", FINDINGS, golden)


@pytest.mark.parametrize("path", ["rows/beam=w/drop", "rows/factor=1.0/drop", "rows/9/drop", "m", "rows/0/beam", "n/x"])
def test_a_path_that_leads_to_no_number_fails(path):
    with pytest.raises(AssertionError):
        number_at(FINDINGS, path)
