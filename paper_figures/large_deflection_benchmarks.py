"""Load over displacement of the benchmarks with published values (``large_deflection_benchmarks``)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from modalshell.files.study_result import StudyResult
from modalshell.render.curves import Curve, Panel, draw_curves
from paper_figures.energy_colors import COLORS

MOVED = {
    "3.1": ("tip back", "tip up"),
    "3.2": ("tip back", "tip up"),
    "3.3": ("inner corner", "outer corner"),
    "3.4": ("pulled point", "pushed point"),
    "3.5": ("pulled point", "side", "side of the end"),
    "3.6": ("pushed point", "side"),
    "3.7": ("pushed point, in hundredths",),
}
"""What the displacements of a problem are of, in the order of their columns."""


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    findings = StudyResult.load(results, "large_deflection_benchmarks").findings
    rows = findings["rows"]
    panels = []
    for problem in dict.fromkeys(row["problem"] for row in rows):
        curves = []
        for family, color in COLORS["Isotropic"].items():
            own = [row for row in rows if (row["problem"], row["mesh"]) == (problem, family)]
            found = np.array([row["found"] for row in own])
            for column, values in enumerate(found.T):
                label = family if column == 0 else "_same"  # in the legend once
                curves.append(Curve([row["share"] for row in own], values, label, color, points=False))
        first = [row for row in rows if row["problem"] == problem and row["mesh"] == rows[0]["mesh"]]
        for column, values in enumerate(np.array([row["published"] for row in first]).T):
            label = "Sze, Liu and Lo" if column == 0 else "_same"
            curves.append(Curve([row["share"] for row in first], values, label, "black", dashed=True))
        from_above = np.argsort(first[-1]["published"])[::-1]
        named = ", ".join(MOVED[problem][column] for column in from_above)
        order = ", from above at the end" if len(from_above) > 1 else ""
        title = f"{problem} {findings['names'][problem]}{order}: {named}"
        panels.append(Panel(curves, title, "share of the load", "displacement [units of the publication]"))
    return draw_curves(panels, folder / "large_deflection_benchmarks.png", columns=3)
