"""Errors of the engines whose conversion held over their time to answer, a panel a scene (reads ``engines``)."""

from __future__ import annotations

from pathlib import Path

from modalshell.compare.engines.engine import ENGINES
from modalshell.files.study_result import StudyResult
from modalshell.models.registry import models
from modalshell.render.curves import Curve, Panel, draw_curves

OURS = {f"modalshell {spec.name}": (spec.color, spec.marker) for spec in models().values()}
LOOKS = OURS | {engine.name: (engine.color, engine.marker) for engine in ENGINES}
TICKS = {10.0**power: f"{10.0**power:g}" for power in range(-2, 3)}


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    findings = StudyResult.load(results, "engines").findings
    rows = [row for row in findings["rows"] if any(error is not None for error in row.get("errors", ()))]
    panels = []
    for scene in dict.fromkeys(row["scene"] for row in rows):
        curves = []
        for row in (row for row in rows if row["scene"] == scene):
            name = row["engine"]
            color, marker = LOOKS.get(name) or LOOKS[name.rstrip(" 0123456789")]  # "LMA 8" is LMA
            errors = [100.0 * error for error in row["errors"] if error is not None]
            curves.append(Curve([row["seconds"]] * len(errors), errors, name, color, marker=marker))
        axes = "time to answer [s]", "error of displacement [%]"
        panels.append(Panel(curves, scene, *axes, log=True, log_x=True, x_ticks=TICKS))
    plates = [row for row in findings["plates"] if "deviations" in row]
    modes = [float(mode) for mode in range(1, 1 + len(plates[0]["deviations"]))]
    curves = [
        Curve(modes, [100.0 * one for one in row["deviations"]], name, LOOKS.get(name, LOOKS["modalshell DS"])[0])
        for name, row in ((row["engine"], row) for row in plates)
    ]
    panels.append(Panel(curves, "square plate clamped on one edge", "mode", "deviation of the frequency [%]"))
    return draw_curves(panels, folder / "engines.png", columns=3)
