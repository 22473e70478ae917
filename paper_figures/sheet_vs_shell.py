"""Error of sheets of springs against discrete shells, over the load (reads the study ``sheet_vs_shell``)."""

from __future__ import annotations

import itertools
from pathlib import Path

from modalshell.files.study_result import StudyResult
from modalshell.render.curves import Curve, Panel, draw_curves

TITLES = {
    "strip": "Flat strip of decreasing stiffness",
    "cloth": "Square cloth of decreasing stiffness",
    "v_beam": "V-beam under increasing load",
    "panel": "Curved panel under increasing load",
}
COLORS = ("#e3c48f", "#a6761d", "#5c400d")
"""Shades of the colour of springs, of rising fold."""


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    found = StudyResult.load(results, "sheet_vs_shell").findings
    panels = []
    for name, rows in found["sheets"].items():
        curves = []
        for index, (fold, color) in enumerate(zip(found["folds"], COLORS, strict=False)):
            label = f"fitted at a fold of {fold:g} rad"
            errors = [(row["gamma"], row["springs"][index]["error"]) for row in rows]
            for missing, run in itertools.groupby(errors, key=lambda point: point[1] is None):  # no line over a gap
                if not missing:
                    gammas, known = zip(*run, strict=True)
                    curves.append(Curve(gammas, [100.0 * error for error in known], label, color))
        error = "displacement error against DS [%]"
        panels.append(Panel(curves, TITLES[name], "gravity Γ", error, log=True, log_x=True))
    title = "No point: DS or the springs did not converge"
    return draw_curves(panels, folder / "sheet_vs_shell.png", columns=2, one_legend=True, title=title)
