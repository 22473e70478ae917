"""Errors of a plate's deflection over refinement, one panel a problem and energy (reads the study ``mesh_bias``)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

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
IN_WORDS = "twisted"
"""The problem whose errors do not change with refinement: it is told in words."""


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    rows = StudyResult.load(results, "mesh_bias").findings["rows"]
    panels = []
    for problem, words in WORDS.items():
        for energy in ("Isotropic", "hinges") if problem != IN_WORDS else ():
            curves = []
            for name, color in COLORS.items():
                own = [r for r in rows if (r["mesh"], r["energy"], r["problem"]) == (name, energy, problem)]
                errors = [100.0 * abs(row["error"]) for row in own]
                curves.append(Curve([row["cells"] for row in own], errors, name, color))
            ticks = {float(cells): f"{cells}" for cells in dict.fromkeys(row["cells"] for row in rows)}
            title = f"{words}, {'shell theory' if energy == 'Isotropic' else 'calibrated hinges'}"
            label = "size of the error [%]"
            panels.append(Panel(curves, title, "cells a side", label, log=True, log_x=True, x_ticks=ticks))
    return draw_curves(
        panels, folder / "mesh_bias.png", columns=2, share_y=True, one_legend=True, title=twist_in_words(rows)
    )


def twist_in_words(rows: list[dict[str, Any]]) -> str:
    """What the rows of pure twist say."""
    twisted = [row for row in rows if row["problem"] == IN_WORDS]
    theory, hinges = (
        [100.0 * abs(row["error"]) for row in twisted if row["energy"] == energy] for energy in ("Isotropic", "hinges")
    )
    exact = "exact to rounding" if max(theory) < 1e-6 else f"at most {max(theory):.2g} % off"
    return (
        f"In pure twist shell theory is {exact} on every mesh; calibrated hinges are {min(hinges):.0f} to "
        f"{max(hinges):.0f} % off, on the finest meshes too."
    )
