"""Four fabrics that hang over a disc, with measured and computed drape (reads the study ``fabric_drape``)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from modalshell.files.study_result import StudyResult
from modalshell.render import ShadedSurface, View, draw_views

COLORS = {
    "cotton broad": "#c9a227",
    "polyester tropical": "#7b6fb0",
    "wool tropical": "#3f7fa6",
    "polyester faille": "#b5533c",
}
RIM = 90
"""Sides of the disc as it is drawn."""


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    result = StudyResult.load(results, "fabric_drape")
    edge = min(row["edge"] for row in result.findings["rows"])
    rows = {row["fabric"]: row for row in result.findings["rows"] if row["edge"] == edge and row["discs"] == "Cusick"}
    _, radius = result.record["parameters"]["sizes"]["Cusick"]
    turn = 2.0 * np.pi * np.arange(RIM) / RIM
    disc = np.vstack([np.zeros(3), np.stack([radius * np.cos(turn), radius * np.sin(turn), 0.0 * turn], axis=1)])
    disc[:, 2] += 1e-3
    fan = np.stack([np.zeros(RIM, dtype=int), 1 + np.arange(RIM), 1 + (np.arange(RIM) + 1) % RIM], axis=1)
    views = []
    for fabric in result.findings["fabrics"]:
        name = fabric["fabric"]
        row, key = rows[name], f"Cusick_{1e3 * edge:g}"
        hung = ShadedSurface(result.arrays[f"{name}_{key}"], result.arrays[f"faces_{key}"], color=COLORS[name])
        held = ShadedSurface(disc, fan, color="#d9d9d9")
        subtitle = (
            f"drape {100.0 * row['drape']:.0f} %, measured {100.0 * fabric['drape']:.0f} %; "
            f"{row['folds']} folds, measured {fabric['folds']}"
        )
        views.append(View([hung, held], title=name, subtitle=subtitle, camera=(-0.3, -1.0, 0.8)))
    return draw_views(views, folder / "fabric_drape.png", columns=2, size=(1200, 820))
