"""Parts of the error of modal warping by shape, one panel a load, equilateral cells (reads ``error_budget``)."""

from __future__ import annotations

from pathlib import Path

from modalshell.render.curves import Curve, Panel, draw_curves
from modalshell.study import StudyResult

MESH = "equilateral"
PARTS = {
    "mwts on hinges": ("MWTS on hinges (2007)", "black"),
    "hinges": ("of that the hinges", "#a3211b"),
    "modes and warp": ("of that modes and warp", "#2b5fc8"),
    "mwts on shell theory": ("MWTS on shell theory", "#2f9e44"),
    "of the mesh": ("the mesh", "#999999"),
}
FLOOR = 0.01
"""Smallest error [%] that is drawn; smaller ones are drawn there."""


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    rows = [row for row in StudyResult.load(results, "error_budget").findings["rows"] if row["mesh"] == MESH]
    panels = []
    for load in dict.fromkeys(row["load"] for row in rows):
        own = [row for row in rows if row["load"] == load]
        places = list(range(len(own)))
        curves = [
            Curve(places, [max(100.0 * row[key], FLOOR) for row in own], label, color, dashed=key != "mwts on hinges")
            for key, (label, color) in PARTS.items()
        ]
        ticks = {float(place): row["case"].replace(" ", "\n", 1) for place, row in zip(places, own, strict=True)}
        title = f"{load:g} of the load"
        panels.append(Panel(curves, title, "", "error against shell theory [%]", log=True, x_ticks=ticks))
    return draw_curves(panels, folder / "error_budget.png", share_y=True)
