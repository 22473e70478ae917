"""Other engines on the case of a comparison: rows, table and marks."""

from __future__ import annotations

from typing import Any

from modalshell.compare.case import Case
from modalshell.compare.engines import ENGINES, answered
from modalshell.compare.report import percent
from modalshell.core.typing import Array, Progress, unheard
from modalshell.render.pareto import Mark
from modalshell.shell import measure

_FINDINGS = ("name", "outcome", "version", "drop", "frame_ms", "step", "seconds")
_HEADS = (
    *("engine", "outcome", "small drop off", "error"),
    *("ms a step", "stable step [s]", "time to answer [s]", "version"),
)


def engine_rows(case: Case, truth: Array | None, on_step: Progress = unheard) -> list[dict[str, Any]]:
    """Outcome, error under the whole load against ``truth`` (n, 3) [m], and cost of every engine."""
    rows = []
    for done, engine in enumerate(ENGINES, start=1):
        answer = answered(engine, case.shell, [(None, case.load)])
        error = None
        if answer.counts and truth is not None and answer.positions is not None:
            error = measure.displacement_error(answer.positions[-1], truth, case.shell)
        row = {name: getattr(answer, name) for name in _FINDINGS} | {"error": error}
        step = None if answer.step is None else case.units.seconds * answer.step  # [s], of the shell's unit of time
        rows.append(row | {"step": step})
        on_step(done, len(ENGINES))
    return rows


def engine_lines(rows: list[dict[str, Any]]) -> list[str]:
    """A table of :func:`engine_rows` in Markdown; nothing without rows."""
    if not rows:
        return []
    lines = ["", f"| {' | '.join(_HEADS)} |", "|" + "---|" * len(_HEADS)]
    for row in rows:
        times = (f"{row[key]:.3g}" if row[key] is not None else "-" for key in ("frame_ms", "step", "seconds"))
        errors = percent(row["drop"], "+.1f"), percent(row["error"])
        lines.append(f"| {' | '.join([row['name'], row['outcome'], *errors, *times, row['version']])} |")
    note = (
        "Engines get the same mesh, constants, supports and load, converted as their adapters say. A row counts where "
        "the conversion held on a strip of the same sheet (mass within 1 %, small drop within 10 %). Errors are under "
        "the whole load."
    )
    return [*lines, "", note]


def engine_marks(rows: list[dict[str, Any]], floor: float) -> list[Mark]:
    """Marks of the engines that count and step in time, at their error and milliseconds a step."""
    looks = {engine.name: (engine.color, engine.marker) for engine in ENGINES}
    marks = []
    for row in rows:
        if row["error"] is not None and row["frame_ms"] is not None:
            error, name = 100.0 * max(row["error"], floor), row["name"]
            marks.append(Mark(row["frame_ms"], error, name, name, False, *looks.get(name, ())))
    return marks
