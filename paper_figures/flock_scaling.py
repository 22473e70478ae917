"""Boids, instances and vertices a second (reads the study ``flock_scaling``)."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from modalshell.files.study_result import StudyResult
from modalshell.models.registry import models
from modalshell.render.curves import Curve, Panel, draw_curves

MWTS = models()["mwts"]
LABELS = {
    MWTS.key: MWTS.name,
    "placed": f"{MWTS.name}, placed",
    "products": "products",
    "writing": "writing alone",
}
COLORS = {MWTS.key: MWTS.color, "placed": "#2f9e44", "products": "#c8322b", "writing": "#777777"}


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
    instances = [
        curve
        for dtype, colors in (("float64", ("#2b5fc8", "#c8322b")), ("float32", ("#2f9e44", "#c8802b")))
        for curve in _curves(found["instances"], "instances", dtype, zip((MWTS.key, "products"), colors, strict=True))
    ]
    finer = _curves(found["vertices"], "vertices", "float64", COLORS.items())
    label = "vertices a second"
    panels = [
        Panel(flock, "flock", "boids", "boid steps a second", log=True, log_x=True),
        Panel(instances, "birds of 493 vertices", "instances", label, log=True, log_x=True),
        Panel(finer, "finer birds", "vertices of one instance", label, log=True, log_x=True),
    ]
    return [draw_curves(panels, folder / "flock_scaling.png")]


def _curves(rows: list[dict[str, Any]], over: str, dtype: str, series: Iterable[tuple[str, str]]) -> list[Curve]:
    """Vertices a second of one precision over instances or vertices; bounds are dashed."""
    chosen = [row for row in rows if row["dtype"] == dtype]
    x = [row[over] for row in chosen]
    return [
        Curve(
            x,
            [row[f"per_second_{name}"] * row["vertices"] for row in chosen],
            f"{LABELS[name]}, {dtype}",
            color,
            dashed=name in ("products", "writing"),
        )
        for name, color in series
    ]
