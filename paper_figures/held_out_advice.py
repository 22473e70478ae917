"""Errors of the advised models at loads that were not measured for the advice (reads the study ``held_out_advice``)."""

from __future__ import annotations

from pathlib import Path

from modalshell.files.study_result import StudyResult
from modalshell.render.curves import Curve, Panel, draw_curves

_LEAST = 0.01
"""Error at which smaller ones are drawn [%]: where DS is advised there is none."""


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    rows = StudyResult.load(results, "held_out_advice").findings["rows"]
    advised = sorted((row for row in rows if row["chosen"] is not None), key=lambda row: float(row["error"]))
    scenes = range(1, len(advised) + 1)
    colors = {"error": "0.4", "measured_error": "#8fb3e8", "held_out_error": "#2b5fc8"}
    labels = ("tolerance", "of the advised model, at measured loads", "at held-out loads")
    markers = {"error": "_"}
    curves = [
        Curve(
            scenes,
            [max(100.0 * row[key], _LEAST) for row in advised],
            label,
            color,
            marker=markers.get(key, "o"),
            joined=False,
        )
        for (key, color), label in zip(colors.items(), labels, strict=True)
    ]
    excluded = [(scene, row) for scene, row in zip(scenes, advised, strict=True) if row.get("missed_error") is not None]
    if excluded:
        places, errors = [scene for scene, _ in excluded], [100.0 * row["missed_error"] for _, row in excluded]
        label = "at held-out loads that the advice excludes"
        curves.append(Curve(places, errors, label, "#c8322b", joined=False))
    title = "Is the advice right?"
    panel = Panel(
        curves, title, "random scenes, by tolerance", f"largest displacement error [%], {_LEAST:g} at least", log=True
    )
    return draw_curves([panel], folder / "held_out_advice.png")
