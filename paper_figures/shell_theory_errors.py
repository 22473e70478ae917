"""Paper Fig. 6a on shell theory: errors over the load, modes of hinges dashed (reads the study ``error_budget``)."""

from __future__ import annotations

from pathlib import Path

from modalshell.files.study_result import StudyResult
from modalshell.models.registry import models
from modalshell.render.curves import Curve, Panel, draw_curves

MESH = "equilateral"


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    rows = [row for row in StudyResult.load(results, "error_budget").findings["rows"] if row["mesh"] == MESH]
    panels = []
    for case in dict.fromkeys(row["case"] for row in rows):
        own = [row for row in rows if row["case"] == case]
        loads = [row["load"] for row in own]
        curves = [Curve(loads, [100.0 * row["hinges"] for row in own], "DS of hinges", "black", dashed=True)]
        for model in own[0]["models"]:
            spec = models()[model]
            for key, dashed in (("on hinges", True), ("on shell theory", False)):
                errors = [100.0 * row["models"][model][key] for row in own]
                curves.append(Curve(loads, errors, f"{spec.name} {key}", spec.color, dashed=dashed))
        panels.append(Panel(curves, case, "share of the load", "error against shell theory [%]", log=True))
    return draw_curves(panels, folder / "shell_theory_errors.png", columns=3)
