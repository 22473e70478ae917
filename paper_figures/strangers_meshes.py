"""Contact sheet of the films of strangers' meshes: each at its farthest from rest (reads ``strangers_meshes``)."""

from __future__ import annotations

from pathlib import Path

from modalshell.files.study_result import StudyResult
from modalshell.render import ShadedSurface, View, draw_views

COLUMNS, CELL, LETTERS = 8, (240, 200), 16


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    result = StudyResult.load(results, "strangers_meshes")
    views = []
    for index, row in enumerate(result.findings["rows"]):
        if f"faces_{index}" not in result.arrays:
            continue
        surface = ShadedSurface(result.arrays[f"positions_{index}"], result.arrays[f"faces_{index}"], smooth=False)
        package, _, name = row["name"].partition(": ")
        title = name if len(name) <= LETTERS else name[: LETTERS - 1] + "…"
        views.append(View([surface], title=title, subtitle=package))
    columns = min(COLUMNS, len(views))
    size = (CELL[0] * columns, CELL[1] * -(-len(views) // columns))
    return draw_views(views, folder / "strangers_meshes.png", columns=columns, size=size, link_cameras=False)
