"""Errors of a plate's deflection over refinement, one panel a problem and energy (reads the study ``mesh_bias``)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from modalshell.files.study_result import StudyResult
from modalshell.render.curves import Curve, Panel, draw_curves

COLORS = {
    "union-jack": "#2b5fc8",
    "right": "#7b2d8e",
    "equilateral": "#2f9e44",
    "lloyd": "#66c2a5",
    "delaunay": "#d98200",
    "jittered": "#c8322b",
    "random": "#000000",
}
WORDS = {
    "supported": "simply supported plate",
    "waves": "supported plate, four waves",
    "twisted": "plate in pure twist",
}
FLOOR = 1e-2
"""Smallest error [%] that is drawn; smaller ones are drawn there."""


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    rows = StudyResult.load(results, "mesh_bias").findings["rows"]
    panels = []
    for problem, words in WORDS.items():
        for energy in ("Isotropic", "hinges"):
            curves = []
            for name, color in COLORS.items():
                own = [r for r in rows if (r["mesh"], r["energy"], r["problem"]) == (name, energy, problem)]
                errors = [max(100.0 * abs(row["error"]), FLOOR) for row in own]
                curves.append(Curve([row["cells"] for row in own], errors, name, color))
            ticks = {float(cells): f"{cells}" for cells in dict.fromkeys(row["cells"] for row in rows)}
            title = f"{words}, {'shell theory' if energy == 'Isotropic' else 'calibrated hinges'}"
            if all(np.max(curve.y) <= FLOOR for curve in curves):
                title += " (exact)"
            label = "size of the error [%]"
            panels.append(Panel(curves, title, "cells a side", label, log=True, log_x=True, x_ticks=ticks))
    return draw_curves(panels, folder / "mesh_bias.png", columns=2, share_y=True)
