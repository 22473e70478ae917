"""Error of statics over time per query, and over the time of 20,000 (reads the study ``path_chart``)."""

from __future__ import annotations

from pathlib import Path

from modalshell.files.study_result import StudyResult
from modalshell.models.registry import models
from modalshell.render.pareto import Mark, ParetoPanel, draw_pareto

CHARTS = {"1 chart": ("#9a9a9a", "D"), "4 charts": ("#1f1f1f", "D"), "4 charts, then DS": ("#1f1f1f", "d")}
_FLOOR = 1e-4
"""Smallest error drawn."""


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    rows = StudyResult.load(results, "path_chart").findings["rows"]
    styles = {spec.name: (spec.color, spec.marker) for spec in models().values()} | CHARTS
    panels = []
    for cost, label in (("ms", "milliseconds per query"), ("minutes", "minutes for 20,000 queries and preparation")):
        marks, truth = [], None
        for row in rows:
            name, size = row["model"].rstrip("0123456789 "), row["model"].rpartition(" ")[2]
            color, marker = styles[name]
            if name == "DS":
                truth = Mark(row[cost], 0.0, name, name, False, color)
                continue
            error = 100.0 * max(row["family"][1], _FLOOR)
            marks.append(
                Mark(row[cost], error, name, size if size.isdigit() else name, row[f"front_{cost}"], color, marker)
            )
        panels.append(
            ParetoPanel(
                marks,
                "statics of the stiff V, loads of a family",
                label,
                "error, 90th percentile, or 0.01 [%]",
                truth=truth,
            )
        )
    return draw_pareto(panels, folder / "path_chart.png")
