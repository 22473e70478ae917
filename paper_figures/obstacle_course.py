"""Errors of the obstacle course over the number of vertices, one panel a problem (reads ``obstacle_course``)."""

from __future__ import annotations

from pathlib import Path

from modalshell.files.study_result import StudyResult
from modalshell.render.curves import Curve, Panel, draw_curves
from paper_figures.energy_colors import COLORS


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    rows = StudyResult.load(results, "obstacle_course").findings["rows"]
    panels = []
    for name in dict.fromkeys(row["problem"] for row in rows):
        shown = [row for row in rows if row["problem"] == name]
        if not shown[0]["reference"]:
            continue  # patch tests
        curves = []
        for family, color in COLORS["Isotropic"].items():
            own = [row for row in shown if row["mesh"] == family]
            if own:
                errors = [100.0 * row["error"] for row in own]
                curves.append(Curve([row["vertices"] for row in own], errors, family, color))
        ends = [min(row["vertices"] for row in shown), max(row["vertices"] for row in shown)]
        for sign, label in ((1.0, "aim"), (-1.0, "_same")):
            aim = sign * 100.0 * shown[0]["bound"]
            curves.append(Curve(ends, [aim, aim], label, "black", dashed=True, points=False))
        panels.append(Panel(curves, name, "vertices", "error [%]", log_x=True, legend_inside=False))
    return draw_curves(panels, folder / "obstacle_course.png", columns=3, one_legend=True)
