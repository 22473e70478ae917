"""Speed-up of a sheet's steps against its size, with published ones (reads the study ``spring_sheet_speed``)."""

from __future__ import annotations

from pathlib import Path

from modalshell.files.study_result import StudyResult
from modalshell.render.curves import Curve, Panel, draw_curves

COLORS = {"numba, one thread": "#2b5fc8", "numba, free threads": "#c8322b", "Warp, one core": "#2f9e44"}
OTHER, PUBLISHED_COLORS = "#c8802b", {"OpenMP": "0.45", "GPU": "0.7"}
ENDS = (64, 1024)


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    found = StudyResult.load(results, "spring_sheet_speed").findings
    over_numpy, over_core = [], []
    keys = dict.fromkeys((row["way"], row["precision"]) for row in found["rows"] if row["way"] != "NumPy")
    for way, precision in keys:
        rows = [row for row in found["rows"] if (row["way"], row["precision"]) == (way, precision)]
        sizes = [row["size"] for row in rows]
        style = (f"{way}, {precision}", COLORS.get(way, OTHER), precision == "float32")
        over_numpy.append(Curve(sizes, [row["over_numpy_float64"] for row in rows], *style))
        if way != "numba, one thread":
            over_core.append(Curve(sizes, [row["over_one_core"] for row in rows], *style))
    for name, speed_ups in found["published"].items():
        over_core.append(Curve(ENDS, speed_ups, f"published: {name}, at 64 and 1024", PUBLISHED_COLORS[name]))
    label = "masses along each side"
    return draw_curves(
        [
            Panel(over_numpy, "over NumPy in float64", label, "speed-up", log=True, log_x=True),
            Panel(over_core, "over one core", label, "speed-up", log=True, log_x=True),
        ],
        folder / "spring_sheet_speed.png",
    )
