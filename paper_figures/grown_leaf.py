"""A leaf whose margins grow more than its midrib, at three growths (reads the study ``grown_leaf``)."""

from __future__ import annotations

from pathlib import Path

from modalshell.files.study_result import StudyResult
from modalshell.render import ShadedSurface, View, draw_views

COLOR = "#4f8f3a"


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    result = StudyResult.load(results, "grown_leaf")
    leaf = result.findings["leaves"][-1]
    faces = result.arrays[f"faces_{leaf['cells']}"]
    views = []
    for index, growth in enumerate(result.record["parameters"]["shown"]):
        row = next(row for row in leaf["rows"] if row["growth"] == growth)
        surface = ShadedSurface(result.arrays[f"shape_{leaf['cells']}_{index}"], faces, color=COLOR)
        subtitle = f"{row['waves']:.1f} waves a margin, {100.0 * row['followed']:.0f} % of the growth followed"
        title = f"margins grown by {100.0 * growth:.1f} %"
        views.append(View([surface], title=title, subtitle=subtitle, camera=(-0.2, -1.0, 0.8)))
    return draw_views(views, folder / "grown_leaf.png", columns=1, size=(900, 360 * len(views)))
