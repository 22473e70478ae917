"""The report on a sweep: its numbers, and the printable page of them."""

from __future__ import annotations

import csv
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from modalshell.core.outcome import Outcome
from modalshell.core.units import with_unit
from modalshell.page.report import data_table, document, figure, listing, paragraph, plain, section, sentence, table
from modalshell.sweep.driver import SweepResult
from modalshell.sweep.figure import axis_text, checked_value, draw_summary
from modalshell.sweep.grid import Sweep
from modalshell.sweep.summary import MEASURES, unit_rows

_CASES = 400
"""Cases that the printed table names at most; the file has all."""
_SHOWN = ("displacement", "peak_displacement", "error", "error_bar", "area_change", "iterations", "unconverged_steps")
"""Measures of the printed table, where any case has them."""
_NAMES = {"error": "relative error", "unconverged_steps": "steps that did not converge"}


def sweep_numbers(sweep: Sweep, result: SweepResult) -> dict[str, Any]:
    """All numbers of a report on a sweep.

    Keys: ``axes`` (key and values of each), ``counts`` of outcomes, ``value`` (the drawn measure), ``extremes`` (the
    cases of its least and of its largest value; None without any), ``cases`` (the rows of the summary), ``units`` of
    their columns, ``scene`` and ``truth`` as declared, and ``versions`` and ``seconds`` of what computed the cases.
    """
    value = checked_value(sweep.output.value, sweep.truth is not None, MEASURES, sweep.file)
    runs = next(file for file in result.files if file.name.endswith("_runs.csv"))
    with runs.open(encoding="utf-8", newline="") as text:
        ran = list(csv.DictReader(text))
    known = [row for row in result.rows if row[value] is not None]
    ends = [pick(known, key=lambda row: row[value]) for pick in (min, max)] if known else []
    extremes = {name: {key: row[key] for key in ("case", value)} for name, row in zip(_ENDS, ends, strict=False)}
    return {
        "axes": [{"key": axis.key, "values": list(axis.values)} for axis in sweep.axes],
        "counts": {str(outcome): count for outcome, count in result.counts().items()},
        "value": value,
        "extremes": extremes or None,
        "cases": result.rows,
        "units": {row["column"]: row["unit"] for row in unit_rows(result.rows, (raw for _, raw in sweep.points()))},
        "scene": sweep.scene,
        "truth": sweep.truth,
        "versions": sorted({row["versions"] for row in ran if row["versions"]}),
        "seconds": sum(float(row["building_seconds"]) + float(row["solving_seconds"]) for row in ran),
    }


_ENDS = ("least", "largest")


def sweep_page(sweep: Sweep, numbers: Mapping[str, Any]) -> str:
    """The HTML of a report on a sweep, from its numbers."""
    rows, units = numbers["cases"], numbers["units"]
    axes = [
        (with_unit(axis["key"], units.get(axis["key"], "")), ", ".join(map(axis_text, axis["values"])))
        for axis in numbers["axes"]
    ]
    shown = [key for key in _SHOWN if any(row.get(key) is not None for row in rows)]
    if all(row["peak_displacement"] == row["displacement"] for row in rows):
        shown = [key for key in shown if key != "peak_displacement"]
    if not any(row.get("unconverged_steps") for row in rows):
        shown = [key for key in shown if key != "unconverged_steps"]
    heading = [with_unit(_name(key), units.get(key, "")) for key in shown]
    keys = [axis.key for axis in sweep.axes]
    cases = [
        (
            str(row["case"]),
            *(axis_text(value) for value in values),
            str(row["outcome"]),
            *(_cell(row.get(key)) for key in shown),
        )
        for row, (values, _) in zip(rows[:_CASES], sweep.points(), strict=False)
    ]
    parts = [
        paragraph(_headline(sweep, numbers)),
        _picture(sweep, numbers),
        section("Axes", table(axes)),
        section("Cases", data_table(("", *keys, "outcome", *heading), cases)),
    ]
    if len(rows) > _CASES:
        parts.append(paragraph(f"The first {_CASES} of {len(rows)} cases; the file of this report's numbers has all."))
    if said := _remarks(rows):
        parts.append(section("Remarks", table(said)))
    declared = {name: value for name, value in numbers["scene"].items() if name != "output"}
    made = [
        ("Command", numbers["command"]),
        ("Reference", plain(numbers["truth"])),
        ("Versions", "; ".join(numbers["versions"])),
        ("Time of all cases, one thread each", f"{numbers['seconds']:.4g} s"),
    ]
    parts += [
        section("Scene", table([(name, plain(value)) for name, value in declared.items()])),
        section("How it was made", table(made)),
        section("Sweep file", listing(sweep.file.read_text(encoding="utf-8"))),
    ]
    return document(f"{sweep.name}: sweep", parts)


def _headline(sweep: Sweep, numbers: Mapping[str, Any]) -> str:
    """How many cases there are, how they ended, and between what their drawn measure lies."""
    counts = ", ".join(f"{count} {outcome}" for outcome, count in numbers["counts"].items())
    text = f"{len(numbers['cases'])} cases over {' and '.join(axis.key for axis in sweep.axes)}: {counts}."
    if numbers["extremes"] is None:
        return text
    value = numbers["value"]
    between = " to ".join(f"{_cell(one[value])} (case {one['case']})" for one in numbers["extremes"].values())
    unit = numbers["units"].get(value, "1")
    return f"{text} {sentence(f'{_name(value)}: {between}' + ('' if unit == '1' else f' {unit}'))}"


def _picture(sweep: Sweep, numbers: Mapping[str, Any]) -> str:
    """The drawn measure over the axes, or why there is no picture."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "sweep.png"
        note = draw_summary(numbers["cases"], sweep.axes, numbers["value"], file, sweep.name, numbers["units"], 2)
        if note:
            return paragraph(sentence(note))
        name = _name(numbers["value"])
        drawn = file.read_bytes()
    return figure(drawn, f"The {name} over the axes of the sweep", f"The {name} over the axes.")


def _remarks(rows: list[dict[str, Any]]) -> list[tuple[str, str]]:
    """What solvers said of cases that are no plain answers, equal texts in one line."""
    said: dict[str, list[str]] = {}
    for row in rows:
        for name, begin in (("", ""), ("truth_", "reference: ")):
            if row.get(f"{name}message") and row[f"{name}outcome"] != Outcome.CONVERGED:
                text = f"{begin}{row[f'{name}outcome']}: {row[f'{name}message']}"
                said.setdefault(text, []).append(str(row["case"]))
    return [(f"Case{'s' * (len(cases) > 1)} {', '.join(cases)}", text) for text, cases in said.items()]


def _name(measure: str) -> str:
    return _NAMES.get(measure, measure.replace("_", " "))


def _cell(value: Any) -> str:
    if value is None:
        return "none"
    return f"{value:.5g}" if isinstance(value, float) else str(value)
