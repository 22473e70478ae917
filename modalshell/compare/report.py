"""Comparison results as a Markdown table."""

from __future__ import annotations

import html
import re
from collections.abc import Sequence
from typing import Any

from modalshell.compare.bifurcation import bifurcation_text
from modalshell.compare.runs import ANSWER_FRAMES
from modalshell.core.outcome import Outcome

_HEADS = (
    *("rung", "elements", "solves", "kB read", "ms a frame", "statics [s]", "preprocessing [s]", "time to answer [s]"),
    *("worst error", "at the largest load", "area"),
    *("tip turn", "first frequency"),
)


def markdown_table(findings: dict[str, Any]) -> str:
    """One row per model, cheapest frame first, the Pareto front in bold, with notes."""
    outside = any(row["outside_error"] is not None for row in findings["rows"])
    near = findings.get("near_factors", ())
    heads = [*_HEADS, *(["next to the snap"] if near else []), *(["outside solution"] if outside else []), "notes"]
    lines = [f"| {' | '.join(heads)} |", "|" + "---|" * len(heads)]
    for row in findings["rows"]:
        cells = [f"**{row['label']}**" if row["front"] else row["label"]]
        cells += [f"{row['elements']:.0f}", f"{row['solves']:.3g}", f"{row['bytes_read'] / 1000.0:.0f}"]
        cells += [f"{row['frame_ms']:.3g}", f"{row['statics']:.2g}", f"{row['preprocessing']:.2g}"]
        cells += [f"{row['answer_seconds']:.2g}"]
        cells += [percent(row["worst_error"]), percent(row["final_error"]), percent(_last(row["area_errors"]), "+.2f")]
        turn, frequency = _last(row["tip_turns"]), row["frequency"]
        cells += ["-" if turn is None else f"{turn:.1f}°", "-" if frequency is None else f"{frequency:.3f}"]
        if near:
            cells.append(" / ".join(percent(error) for error in row["near_errors"]))
        cells += [percent(row["outside_error"])] if outside else []
        lines.append(f"| {' | '.join([*cells, _notes(row)])} |")
    shares = ", ".join(f"{factor:g}" for factor in findings["load_factors"])
    lines += [
        "",
        f"{findings['vertices']} vertices; static answers at {shares} of the load, in the time named statics. Element "
        "evaluations, solves and bytes of model data are those of a frame, the same on every machine; they order the "
        f"rows. The time to answer is that of preprocessing and {ANSWER_FRAMES} frames. Errors are "
        "of displacement against DS, area less that of DS, frequency over that of DS at rest; in bold what no cheaper "
        "frame matches in error.",
    ]
    if near:
        lines[-1] += f" Next to the snap: errors at {' and '.join(f'{factor:.4g}' for factor in near)} of the load."
    for text in (findings["note"], f"The shell {findings['snap']}." if findings["snap"] else ""):
        lines += ["", text] if text else []
    lines += [part for text in bifurcation_text(findings.get("bifurcation")) for part in ("", text)]
    if findings["left_out"]:
        lines += ["", *(f"- Not run: {label}: {reason}" for label, reason in findings["left_out"].items())]
    return "\n".join(lines)


def html_table(markdown: str) -> str:
    """The table of :func:`markdown_table` for a notebook."""
    rows = [line.strip("|").split("|") for line in markdown.splitlines() if line.startswith("| ")]
    cells = ["".join(f"<td>{html.escape(cell.strip())}</td>" for cell in row) for row in rows]
    table = "".join(f"<tr>{row}</tr>" for row in cells)
    return "<table>" + re.sub(r"\*\*(.+?)\*\*", r"<b>\1</b>", table) + "</table>"


def percent(value: float | None, form: str = ".3g") -> str:
    """A fraction in per cent; a dash for None."""
    return "-" if value is None else f"{100.0 * value:{form}} %"


def _notes(row: dict[str, Any]) -> str:
    """What went wrong, each kind once."""
    wrong = list(dict.fromkeys(status for status in row["statuses"] if status != Outcome.CONVERGED))
    return "; ".join(wrong + ([f"motion: {row['motion']}"] if row["motion"] != "completed" else []))


def _last(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return known[-1] if known else None
