"""Errors of the engines whose conversion held, over the load (reads the study ``engines``)."""

from __future__ import annotations

from pathlib import Path

from modalshell.render.curves import Curve, Panel, draw_curves
from modalshell.study import StudyResult

COLORS = ("#2b5fc8", "#2f9e44", "#c8322b", "#d98200", "#7b2d8e", "#66c2a5")


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    findings = StudyResult.load(results, "engines").findings
    loads = [float(load) for load in findings["elastica"]]
    counted = [row for row in findings["rows"] if "errors" in row]
    strips = [
        Curve(loads, [100.0 * error for error in row["errors"]], row["engine"], color)
        for row, color in zip(counted, COLORS, strict=False)
    ]
    plates = [row for row in findings["plates"] if "deviations" in row]
    modes = [float(mode) for mode in range(1, 1 + len(plates[0]["deviations"]))]
    curves = [
        Curve(modes, [100.0 * one for one in row["deviations"]], row["engine"], color)
        for row, color in zip(plates, (COLORS[0], COLORS[2]), strict=False)
    ]
    ticks = {load: f"{load:g}" for load in loads}
    first = Panel(strips, "Strip under its weight", "load", "error of the tip [%]", log=True, log_x=True, x_ticks=ticks)
    second = Panel(curves, "Square plate clamped on one edge", "mode", "deviation of the frequency [%]")
    return draw_curves([first, second], folder / "engines.png", columns=2)
