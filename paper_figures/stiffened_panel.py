"""Errors of sheets that meet over the cells of their meshes (reads the study ``stiffened_panel``)."""

from __future__ import annotations

from pathlib import Path

from modalshell.files.study_result import StudyResult
from modalshell.render.curves import Curve, Panel, draw_curves

TITLES = {"T": "T frame", "cross": "cross frame"}
COLORS = {"alternating": "#1f5fa8", "one-way": "#d0021b", "jittered": "#2f9e6b"}


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    rows = StudyResult.load(results, "stiffened_panel").findings["rows"]
    panels = []
    for shape in dict.fromkeys(row["shape"] for row in rows):
        curves = []
        for mesh, color in COLORS.items():
            own = [row for row in rows if (row["shape"], row["mesh"]) == (shape, mesh)]
            if own:
                errors = [100.0 * (row["found"] - 1.0) for row in own]
                curves.append(Curve([float(row["cells"]) for row in own], errors, mesh, color))
        panels.append(Panel(curves, TITLES.get(shape, shape), "cells along a sheet", "error against beam theory [%]"))
    return draw_curves(panels, folder / "stiffened_panel.png", columns=2, one_legend=True)
