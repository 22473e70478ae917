"""Errors of shells in contact, by scene, and of each rung on a table (reads the study ``contact_truth``)."""

from __future__ import annotations

from pathlib import Path

from modalshell.files.study_result import StudyResult
from modalshell.render.curves import Curve, Panel, draw_curves
from paper_figures.model_colors import model_color

COLORS = {"union-jack": "#1f6fb4", "equilateral": "#d1495b", "delaunay": "#2f9e6b"}
FLOOR = 1e-4
"""Smallest error [%] that is drawn; smaller ones are drawn there."""


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    found = StudyResult.load(results, "contact_truth").findings

    def size(rows: list[dict[str, float]], key: str) -> list[float]:
        return [max(FLOOR, 100.0 * abs(row[key])) for row in rows]

    panels = []
    for key, words in (("force", "lifting force"), ("drawn", "drawn-in length")):
        curves = []
        for family, color in COLORS.items():
            for cells in (40, 80):
                of = family, cells, "free"
                rows = [row for row in found["lifted"] if (row["mesh"], row["cells"], row["end"]) == of]
                if rows:
                    heights = [row["height"] for row in rows]
                    label = f"{family}, {cells} cells"
                    curves.append(Curve(heights, size(rows, key), label, color, dashed=cells == 40))
        title = f"Sheet lifted off a table: {words}"
        height = "height over (bending stiffness / weight per area)^(1/3)"
        panels.append(Panel(curves, title, height, "size of the error [%]", log=True, log_x=True))
    plates = []
    for family, color in COLORS.items():
        rows = [row for row in found["rings"] if row["mesh"] == family]
        if rows:
            gaps = [float(row["case"].split()[2]) for row in rows]
            plates.append(Curve(gaps, size(rows, "force"), family, color))
    panels.append(Panel(plates, "Ring between plates: force", "gap [R]", "size of the error [%]", log=True))
    rungs = []
    for name in dict.fromkeys(row["model"] for row in found["table"]):
        rows = [row for row in found["table"] if row["model"] == name]
        cost = [1e3 * row["touching"] for row in rows]
        rungs.append(Curve(cost, size(rows, "error"), f"{name}, displacement", model_color(name)))
        rungs.append(Curve(cost, size(rows, "force"), f"{name}, force", model_color(name), dashed=True))
    counts = [row["modes"] for row in found["table"]]
    title = f"Cantilever on a table: rungs of {min(counts)} to {max(counts)} modes against DS"
    axis = "processor time of a frame [microseconds]"
    panels.append(Panel(rungs, title, axis, "size of the error [%]", log=True, log_x=True))
    return draw_curves(panels, folder / "contact_truth.png", columns=2)
