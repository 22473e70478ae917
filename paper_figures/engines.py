"""Errors of the engines whose conversion held over their time to answer, a panel a scene (reads ``engines``)."""

from __future__ import annotations

from pathlib import Path

from modalshell.render.curves import Curve, Panel, draw_curves
from modalshell.study import StudyResult

COLORS = ("#8fb4e8", "#2f9e44", "#2b5fc8", "#c8322b", "#d98200", "#7b2d8e", "#66c2a5")
TICKS = {10.0**power: f"{10.0**power:g}" for power in range(-2, 3)}
MARKERS = ("o", "s", "D", "^", "v", "X", "P")


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    findings = StudyResult.load(results, "engines").findings
    rows = [row for row in findings["rows"] if any(error is not None for error in row.get("errors", ()))]
    names = list(dict.fromkeys(row["engine"] for row in rows))
    panels = []
    for scene in dict.fromkeys(row["scene"] for row in rows):
        curves = []
        for row in (row for row in rows if row["scene"] == scene):
            place = names.index(row["engine"])
            errors = [100.0 * error for error in row["errors"] if error is not None]
            curves.append(
                Curve([row["seconds"]] * len(errors), errors, row["engine"], COLORS[place], marker=MARKERS[place])
            )
        axes = "time to answer [s]", "error of displacement [%]"
        panels.append(Panel(curves, scene, *axes, log=True, log_x=True, x_ticks=TICKS))
    plates = [row for row in findings["plates"] if "deviations" in row]
    modes = [float(mode) for mode in range(1, 1 + len(plates[0]["deviations"]))]
    curves = [
        Curve(modes, [100.0 * one for one in row["deviations"]], row["engine"], color)
        for row, color in zip(plates, (COLORS[2], COLORS[3]), strict=False)
    ]
    panels.append(Panel(curves, "square plate clamped on one edge", "mode", "deviation of the frequency [%]"))
    return draw_curves(panels, folder / "engines.png", columns=3)
