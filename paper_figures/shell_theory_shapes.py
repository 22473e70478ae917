"""Paper Fig. 5 on both energies: modal models over the whole mesh, by shape (reads the study ``error_budget``)."""

from __future__ import annotations

from pathlib import Path

from modalshell.files.study_result import StudyResult
from modalshell.models.registry import models
from modalshell.render import ShadedSurface, View, draw_views

MESH = "equilateral"
CASES = ("V-beam", "twisted strip")
ENERGIES = {"hinges": "modes of hinges", "theory": "modes of shell theory"}
OPACITY = 0.6
"""Of the modal models' shapes; the truth is opaque."""


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    result = StudyResult.load(results, "error_budget")
    rows = [row for row in result.findings["rows"] if row["mesh"] == MESH]
    cases = [case for case in CASES if any(row["case"] == case for row in rows)]
    views = []
    for case in cases:
        row = [row for row in rows if row["case"] == case][-1]
        faces = result.arrays[f"{case}, {MESH}, faces"]
        for energy, title in ENERGIES.items():
            surfaces = [
                ShadedSurface(
                    result.arrays[f"{case}, {MESH}, {row['load']:g}, {model} {energy}"],
                    faces,
                    color=models()[model].color,
                    label=models()[model].name,
                    opacity=OPACITY,
                )
                for model in row["models"]
            ]
            truth = result.arrays[f"{case}, {MESH}, {row['load']:g}, whole theory"]
            surfaces.append(ShadedSurface(truth, faces, color="#bbbbbb", label="shell theory", opacity=1.0))
            key = "on hinges" if energy == "hinges" else "on shell theory"
            errors = ", ".join(f"{models()[m].name} {100 * part[key]:.1f} %" for m, part in row["models"].items())
            views.append(
                View(surfaces, title=f"{case}, {title}", subtitle=f"error: {errors}", camera=(0.3, -1.0, 0.25))
            )
    return draw_views(views, folder / "shell_theory_shapes.png", columns=2, size=(1800, 1300))
