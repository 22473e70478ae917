"""A map folded by prescribed positions and released, with creases and without (reads the study ``folded_map``)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from modalshell.files.study_result import StudyResult
from modalshell.render import ShadedSurface, View, draw_views

COLORS = {True: "#1f5fa8", False: "#c8862a"}


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    rows = StudyResult.load(results, "folded_map").findings["rows"]
    finest = max(row["cells"] for row in rows)
    views = []
    for row in (row for row in rows if row["cells"] == finest):
        words = "with creases" if row["creases"] else "without creases"
        for shape, key, title in zip(row["shapes"], ("led", "kept"), ("folded", "released"), strict=True):
            angles = ", ".join(f"{angle:.0f}" for angle in row[key])
            surface = ShadedSurface(np.array(shape), np.array(row["faces"]), color=COLORS[row["creases"]])
            place = {"title": f"{words}, {title}", "subtitle": f"folds of {angles} degrees"}
            views.append(View([surface], **place, camera=(0.5, -1.0, 0.45)))
    return draw_views(views, folder / "folded_map.png", columns=2, size=(1200, 800))
