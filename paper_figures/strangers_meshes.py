"""Contact sheet of the films of strangers' meshes: each at its farthest from rest (reads ``strangers_meshes``)."""

from __future__ import annotations

from pathlib import Path

from modalshell.files.study_result import StudyResult
from modalshell.render import ShadedSurface, View, draw_views

COLUMNS, CELL = 8, (240, 210)
LETTERS = 17
"""Letters of a name that fit on a line."""


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    result = StudyResult.load(results, "strangers_meshes")
    views = []
    for index, row in enumerate(result.findings["rows"]):
        if f"faces_{index}" not in result.arrays:
            continue
        surface = ShadedSurface(result.arrays[f"positions_{index}"], result.arrays[f"faces_{index}"], smooth=False)
        package, _, name = row["name"].partition(": ")
        first, rest = broken(name.removeprefix("Parametric") or name)
        views.append(View([surface], title=f"{first}\n{rest}" if rest else first, subtitle=package))
    columns = _columns(len(views))
    size = (CELL[0] * columns, CELL[1] * -(-len(views) // columns))
    return draw_views(views, folder / "strangers_meshes.png", columns=columns, size=size, link_cameras=False)


def broken(name: str) -> tuple[str, str]:
    """A name on two lines, if it is too long for one: broken after a mark between words or before a capital.

    Where it can be, no line is longer than fits, and the longer one as short as it gets; no suffix stands alone.
    """
    if len(name) <= LETTERS:
        return name, ""
    places = [k for k in range(4, LETTERS + 1) if name[k - 1] in "_- " or (name[k].isupper() and name[k - 1].islower())]
    place = min(places, key=lambda k: max(k, len(name) - k), default=LETTERS)
    return name[:place], name[place:]


def _columns(count: int) -> int:
    """Columns up to :data:`COLUMNS` that leave the fewest places of the last row empty, more before fewer."""
    return min(
        range(min(COLUMNS, count), 0, -1), key=lambda across: -count % across if across > COLUMNS // 2 else count
    )
