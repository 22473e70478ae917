"""Drop and reach of a strip over the load, and the errors of its tip (reads the study ``cantilever_master_curve``)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from modalshell.files.study_result import StudyResult
from modalshell.render.curves import Curve, Panel, draw_curves
from paper_figures.energy_colors import COLORS

LOAD = "Γ = (weight per length) L³ / EI"


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    found = StudyResult.load(results, "cantilever_master_curve").findings
    gamma = found["gamma"]
    shown = next(row for row in found["rows"] if row["energy"] == "Isotropic" and row["mesh"] == "delaunay")
    shapes = [
        Curve(gamma, shown["drop"], "drop, Isotropic, delaunay", "#2b5fc8"),
        Curve(gamma, shown["reach"], "reach, Isotropic, delaunay", "#8fb0ee"),
        Curve(gamma, found["drop"], "elastica", "black", points=False),
        Curve(gamma, found["reach"], "_elastica", "black", points=False),  # not named twice in the legend
    ]
    errors = []
    for row in found["rows"]:
        color = COLORS[row["energy"]][row["mesh"]]
        percent = np.maximum(100.0 * np.array(row["error"]), 1e-6)
        errors.append(Curve(gamma, percent, f"{row['energy']}, {row['mesh']}", color))
    panels = [
        Panel(shapes, "Tip of a clamped strip under its weight", LOAD, "length [L]", log_x=True),
        Panel(errors, "Distance of the tip from the elastica's", LOAD, "error [% of L]", log=True, log_x=True),
    ]
    return draw_curves(panels, folder / "cantilever_master_curve.png", columns=1)
