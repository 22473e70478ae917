"""Boids, instances and vertices a second (reads the study ``flock_scaling``)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from modalshell.render.curves import Curve, Panel, draw_curves
from modalshell.study import StudyResult

SERIES = (
    ("mwts", "MWTS", "#2b5fc8", False),
    ("placed", "MWTS, placed", "#2f9e44", False),
    ("products", "two products alone (BLAS)", "#c8322b", True),
    ("writing", "writing positions alone", "#777777", True),
)


def draw(results: Path, folder: Path) -> list[Path]:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    found = StudyResult.load(results, "flock_scaling").findings
    flock = []
    for search, label, color, dashed in (
        ("grid", "grid of cells", "#2b5fc8", False),
        ("all_pairs", "all pairs", "#c8322b", True),
    ):
        rows = [row for row in found["flock"] if row["search"] == search]
        rates = [row["boids"] * row["steps_per_second"] for row in rows]
        flock.append(Curve([row["boids"] for row in rows], rates, label, color, dashed))
    panels = [Panel(flock, "flock", "boids", "boid steps a second", log=True, log_x=True)]
    panels.append(_panel(found["instances"], "instances", "float64", "crowd of a bird of 493 vertices, float64"))
    panels.append(_panel(found["instances"], "instances", "float32", "the same, float32"))
    panels.append(_panel(found["vertices"], "vertices", "float64", "crowds of finer birds, float64"))
    return [draw_curves(panels, folder / "flock_scaling.png", columns=2)]


def _panel(rows: list[dict[str, Any]], over: str, dtype: str, title: str) -> Panel:
    """Vertices a second of one precision over instances or vertices."""
    chosen = [row for row in rows if row["dtype"] == dtype]
    x = [row[over] for row in chosen]
    curves = [
        Curve(x, [row[f"per_second_{name}"] * row["vertices"] for row in chosen], label, color, dashed)
        for name, label, color, dashed in SERIES
    ]
    label = "instances" if over == "instances" else "vertices of one instance"
    return Panel(curves, title, label, "vertices a second", log=True, log_x=True)
