"""Ratios of cost of both energies, and errors of a plate over seconds (reads the study ``energy_cost``)."""

from __future__ import annotations

from pathlib import Path

from modalshell.files.study_result import StudyResult
from modalshell.render.curves import Curve, Panel, draw_curves
from paper_figures.energy_colors import COLORS


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    findings = StudyResult.load(results, "energy_cost").findings
    work = list(dict.fromkeys(row["work"] for row in findings["ratios"]))
    places = list(range(len(work)))
    curves = []
    for family, color in COLORS["Isotropic"].items():
        own = [row for row in findings["ratios"] if row["mesh"] == family]
        ratios = [row["seconds"]["Isotropic"] / row["seconds"]["hinges"] for row in own]
        curves.append(Curve(places, ratios, family, color, joined=False))
    aims = [next(row["aim"] for row in findings["ratios"] if row["work"] == name) for name in work]
    curves.append(Curve(places, aims, "upper limit aimed at", "black", marker="_", joined=False))
    ticks = {float(place): name for place, name in zip(places, work, strict=True)}
    panels = [Panel(curves, "time of Isotropic over time of hinges", "", "ratio", x_ticks=ticks)]
    curves = []
    for energy, colors in COLORS.items():
        for family, color in colors.items():
            own = [row for row in findings["errors"] if (row["mesh"], row["energy"]) == (family, energy)]
            errors = [100.0 * row["error"] for row in own]
            curves.append(Curve([row["seconds"] for row in own], errors, f"{energy}, {family}", color))
    title = "supported plate under a uniform load"
    panels.append(Panel(curves, title, "time to the answer [s]", "error of the deflection [%]", log=True, log_x=True))
    return draw_curves(panels, folder / "energy_cost.png")
