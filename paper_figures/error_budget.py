"""Parts of the errors of modal models by shape, a row per model, equilateral cells (reads ``error_budget``)."""

from __future__ import annotations

from pathlib import Path

from modalshell.files.study_result import StudyResult
from modalshell.models.registry import models
from modalshell.render.curves import Curve, Panel, draw_curves

MESH = "equilateral"
FLOOR = 0.01
"""Smallest error [%] that is drawn; smaller ones are drawn there."""
MARKERS = ("o", "v", "s", "D", "_")


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    rows = [row for row in StudyResult.load(results, "error_budget").findings["rows"] if row["mesh"] == MESH]
    loads = list(dict.fromkeys(row["load"] for row in rows))
    panels = []
    for model in rows[0]["models"]:
        name = models()[model].name
        for load in loads:
            own = [row for row in rows if row["load"] == load]
            places = list(range(len(own)))
            parts = {
                "the model on hinges": ([row["models"][model]["on hinges"] for row in own], "black"),
                "error of the hinges": ([row["hinges"] for row in own], "#a3211b"),
                "error of modes and warp, on hinges": (
                    [row["models"][model]["modes and warp"] for row in own],
                    "#2b5fc8",
                ),
                "the model on shell theory": ([row["models"][model]["on shell theory"] for row in own], "#2f9e44"),
                "error of the mesh, shell theory": ([row["of the mesh"] for row in own], "#999999"),
            }
            curves = [
                Curve(
                    places, [max(100.0 * value, FLOOR) for value in values], label, color, marker=marker, joined=False
                )
                for (label, (values, color)), marker in zip(parts.items(), MARKERS, strict=True)
            ]
            ticks = {float(place): row["case"].replace(" ", "\n", 1) for place, row in zip(places, own, strict=True)}
            title = f"{name}, {load:g} of the load"
            label = f"error against shell theory [%]; least drawn: {FLOOR:g}"
            panels.append(Panel(curves, title, "", label, log=True, x_ticks=ticks))
    return draw_curves(panels, folder / "error_budget.png", columns=len(loads), share_y=True, one_legend=True)
