"""Paper Fig. 5 on both energies: modal models over the whole mesh, by shape (reads the study ``error_budget``)."""

from __future__ import annotations

from pathlib import Path

from modalshell.files.study_result import StudyResult
from modalshell.models.registry import models
from modalshell.render import ShadedSurface, View, draw_views

MESH = "equilateral"
CASES = ("V-beam", "twisted strip")
ENERGIES = {"hinges": "modes of hinges", "theory": "modes of shell theory"}
TRUTH_COLOR = "#222222"
CAMERA = (0.3, -1.0, 0.25)


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    result = StudyResult.load(results, "error_budget")
    rows = [row for row in result.findings["rows"] if row["mesh"] == MESH]
    cases = [case for case in CASES if any(row["case"] == case for row in rows)]
    views, across = [], 1
    for case in cases:
        row = [row for row in rows if row["case"] == case][-1]
        faces, at = result.arrays[f"{case}, {MESH}, faces"], f"{case}, {MESH}, {row['load']:g}"
        truth = ShadedSurface(result.arrays[f"{at}, whole theory"], faces, color=TRUTH_COLOR, style="outline")
        across = len(row["models"])
        for energy, title in ENERGIES.items():
            key = "on hinges" if energy == "hinges" else "on shell theory"
            for model, part in row["models"].items():
                spec = models()[model]
                shape = ShadedSurface(result.arrays[f"{at}, {model} {energy}"], faces, color=spec.color)
                told = f"{case}, {title}\n{100 * part[key]:.1f} % off"
                views.append(View([shape, truth], title=spec.name, subtitle=told, camera=CAMERA))
    size = (480 * across, 320 * -(-len(views) // across))
    title = "outlined: shell theory, every vertex free"
    path = folder / "shell_theory_shapes.png"
    return draw_views(views, path, columns=across, size=size, legend=False, title=title)
