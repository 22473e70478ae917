"""Load-deflection paths through snaps, and shapes on them (reads the study ``snap``)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from modalshell.files.study_result import StudyResult
from modalshell.render import ShadedSurface, View, draw_views
from modalshell.render.curves import Curve, Panel, draw_curves, path_curves
from paper_figures.model_colors import model_color

PANELS = {
    "V 150°": ("displacement along the load [m]", "gravity [m/s²]"),
    "V 160°": ("displacement along the load [m]", "gravity [m/s²]"),
    "panel": ("displacement along the load [m]", "gravity [m/s²]"),
    "tape spring": ("deflection of the end [R]", "couple over D α"),
    "roof 12.7 mm": ("deflection of the centre [mm]", "load [N]"),
    "roof 6.35 mm": ("deflection of the centre [mm]", "load [N]"),
    "Lee's frame": ("drop under the load [L]", "load [EI / L²]"),
    "tape plateau": ("turn of the end [degrees]", "moment over D α"),
}
GREYS = {1.3: "black", 0.7: "0.6"}
"""Colours of theory's moments of a tape spring: dashes are for what is unstable."""
CAMERA = (0.9, -1.0, 0.55)


def draw(results: Path, folder: Path) -> list[Path]:
    """Draw from the result in ``results`` into ``folder``; return the PNGs' paths."""
    result = StudyResult.load(results, "snap")
    views = []
    for case in PANELS:
        if f"{case}_positions" in result.arrays:
            views += shapes(case, result.arrays[f"{case}_positions"], result.arrays[f"{case}_faces"])
    rows = -(-len(views) // 4)
    shown = draw_views(
        views, folder / "snap_shapes.png", columns=4, size=(1600, 330 * rows), link_cameras=False, legend=False
    )
    return [draw_paths(result, folder), shown]


def draw_paths(result: StudyResult, folder: Path) -> Path:
    """Draw the load-deflection paths into ``folder``; return the PNG's path."""
    panels = []
    for case, (x_label, y_label) in PANELS.items():
        curves: list[Curve] = []
        for number, one in enumerate(row for row in result.findings["curves"] if row["case"] == case):
            color, marks = model_color(one["model"], number), "twisted" not in one["model"]
            label = one["model"].replace("Isotropic", "DS of shell theory")
            if "moment" in one:
                turn, moment = np.array(one["turn"]), np.array(one["moment"])
                curves.append(Curve(turn, moment, f"DS of shell theory, {label}", color, points=False))
                exact = 1.3 if "opposite" in one["model"] else 0.7
                ends = [turn.min(), turn.max()]
                shade = GREYS[exact]
                curves.append(Curve(ends, [exact] * 2, f"theory, {label}", shade, points=False))
                continue
            events = one["events"] if len(one["events"]) <= 8 else []
            curves += path_curves(
                one["displacements"], one["factors"], one["stable"], events, label, color, marks=marks
            )
            if "elastica_loads" in one:
                drops, loads = one["elastica_drops"][::6], one["elastica_loads"][::6]
                curves.append(Curve(drops, loads, "elastica", "black", joined=False))
        panels.append(Panel(curves, case, x_label, y_label))
    start = panels[0].curves[0]
    text = "unstable (triangles: limit points, squares: bifurcations)"
    unstable = Curve(np.ravel(start.x)[:1], np.ravel(start.y)[:1], text, "0.35", dashed=True, points=False)
    panels[0] = replace(panels[0], curves=[*panels[0].curves, unstable])
    return draw_curves(panels, folder / "snap.png", columns=2, one_legend=True)


def shapes(case: str, positions: np.ndarray, faces: np.ndarray) -> list[View]:
    """At rest, at the first and the second limit point, and at the end, or as many of them as there are."""
    if len(positions) > 4:
        positions = positions[[0, 1, 2, -1]]
    names = [*("at rest", "first limit point", "second limit point")[: len(positions) - 1], "end"]
    return [
        View([ShadedSurface(x, faces, smooth=True)], title=case, subtitle=name, camera=CAMERA)
        for name, x in zip(names, positions, strict=True)
    ]
