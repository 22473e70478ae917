"""Errors of a square plate's frequencies by mode, one panel a support (reads the study ``plate_frequencies``)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from modalshell.files.study_result import StudyResult
from modalshell.render.curves import Curve, Panel, draw_curves
from paper_figures.energy_colors import COLORS

SUPPORTS = {
    "CFFF": "one edge clamped",
    "FFFF": "free",
    "SSSS": "simply supported",
    "panel": "a curved edge clamped",
    "V-beam": "one end clamped",
}

FLOOR = 0.01
"""Smallest error [%] that is drawn; smaller ones are drawn there."""


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    rows = StudyResult.load(results, "plate_frequencies").findings["rows"]
    panels = []
    for supports, words in SUPPORTS.items():
        coarse, fine = (pick(row["cells"] for row in rows if row["supports"] == supports) for pick in (min, max))
        curves = []
        for row in rows:
            if row["supports"] != supports:
                continue
            size = np.maximum(100.0 * np.abs(row["errors"]), FLOOR)
            finest = row["cells"] == fine
            # matplotlib leaves labels that begin with an underscore out of the legend
            label = f"{row['energy']}, {row['mesh']}" if finest else f"_{row['energy']}"
            modes = np.arange(1, len(size) + 1)
            color = COLORS[row["energy"]][row["mesh"]]
            curves.append(Curve(modes, size, label, color, dashed=not finest, joined=False))
        further = f"; hollow {coarse}" if coarse < fine else ""
        title = f"{supports}: {words} ({fine} cells across{further})"
        label = f"size of the error [%], {FLOOR:g} at least"
        # Ticks of their own, so that the dots of a mode stand next to one another.
        ticks = {float(mode): str(mode) for mode in range(1, 1 + max(len(np.atleast_1d(curve.x)) for curve in curves))}
        panels.append(Panel(curves, title, "mode", label, log=True, x_ticks=ticks))
    return draw_curves(panels, folder / "plate_frequencies.png", columns=3, share_y=True, one_legend=True)
