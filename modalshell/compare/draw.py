"""Pictures of comparisons: Pareto fronts, and the models' shapes with that of DS."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modalshell.compare.engine_runs import engine_marks
from modalshell.core.typing import Array
from modalshell.models.registry import TRUTH, models
from modalshell.render import ShadedSurface, View, draw_views
from modalshell.render.pareto import Mark, ParetoPanel, draw_pareto

Shapes = tuple[dict[str, Any], Mapping[str, Array], NDArray[np.int64]]
"""Results of a comparison, positions under the whole load by label, and faces."""

GAIN = 0.02
"""Relative decrease of the error by which a costlier model counts as better: mode counts often change nothing."""
_FLOOR = 1e-6
"""Smallest error drawn."""
_CAMERA = (0.9, -1.0, 0.45)
"""Direction from which shapes are seen."""


def draw_fronts(findings: Sequence[dict[str, Any]], path: str | Path, titles: Sequence[str] | None = None) -> Path:
    """Draw one Pareto panel for the findings of each tradeoff."""
    names = titles or [one["case"] for one in findings]
    panels = [pareto_panel(one, title) for one, title in zip(findings, names, strict=True)]
    return draw_pareto(panels, path, columns=min(len(panels), 3))


def pareto_panel(findings: dict[str, Any], title: str) -> ParetoPanel:
    """Error over milliseconds per frame; with an external reference DS is a point like the others."""
    key = "worst_error" if all(row["outside_error"] is None for row in findings["rows"]) else "outside_error"
    marks, truth, ladder = [], None, models()
    for row in sorted(findings["rows"], key=lambda row: ladder[row["key"]].cost):
        spec, name = ladder[row["key"]], row["rung"]
        if row["key"] == TRUTH and key == "worst_error":
            truth = Mark(row["frame_ms"], 0.0, name, name, False, spec.color)
        elif row[key] is not None:
            error = 100.0 * max(row[key], _FLOOR)
            text = row["size"] or name
            marks.append(Mark(row["frame_ms"], error, name, text, False, spec.color, spec.marker))
    marks = marked_front(marks) + engine_marks(findings.get("engines", []), _FLOOR)
    label = "worst displacement error [%]" if key == "worst_error" else "error against the outside solution [%]"
    return ParetoPanel(marks, title, y_label=label, truth=truth)


def marked_front(marks: Sequence[Mark]) -> list[Mark]:
    """The marks, those on the front that no cheaper one matches in error, by the measured cost that is drawn.

    Tables rank by counted work, which does not change from run to run; a front by one and drawn over the other would
    run up again.
    """
    ordered = sorted(marks, key=lambda mark: (mark.x, mark.y))
    return [
        replace(mark, front=front) for mark, front in zip(ordered, on_front([mark.y for mark in ordered]), strict=True)
    ]


def on_front(errors: Sequence[float | None]) -> list[bool]:
    """Which errors, in the order of their cost, no earlier one matches; tiny gains do not count, None never does."""
    best, front = np.inf, []
    for error in errors:
        value = np.inf if error is None else error
        front.append(value < (1.0 - GAIN) * best)
        best = value if front[-1] else best
    return front


def draw_shapes(shapes: Sequence[Shapes], path: str | Path, titles: Sequence[str] | None = None) -> Path:
    """Draw the shape of each rung's best size over the outline of DS.

    Of several tradeoffs each has a row below its title, by default its case, with the rungs that have an answer in all.
    """
    rows = [best_sizes(findings) for findings, _, _ in shapes]
    common = set.intersection(*({row["rung"] for row in best} for best in rows))
    views = []
    for (_, positions, faces), best in zip(shapes, rows, strict=True):
        for row in best:
            if row["rung"] not in common:
                continue
            surfaces = [ShadedSurface(positions[row["label"]], faces, color=models()[row["key"]].color)]
            truth = models()[TRUTH]
            if row["key"] != TRUTH:
                surfaces.append(ShadedSurface(positions[truth.name], faces, color="#1b6e2c", style="outline"))
            error = "the truth" if row["key"] == TRUTH else f"{100.0 * row['final_error']:.2g} % off"
            text = f"{error}, {row['frame_ms']:.2g} ms"
            views.append(View(surfaces, title=row["label"], subtitle=text, camera=_CAMERA))
    if len(rows) == 1:
        return draw_views(views, path, legend=False)
    headings = titles or [findings["case"] for findings, _, _ in shapes]
    size = (380 * len(common), 340 * len(rows))  # text grows with the height of the page
    return draw_views(views, path, columns=len(common), size=size, link_cameras=False, headings=headings, legend=False)


def best_sizes(findings: dict[str, Any]) -> list[dict[str, Any]]:
    """Of each rung with an answer the row of the smallest error, in the order of their cost; DS last."""
    best: dict[str, dict[str, Any]] = {}
    for row in findings["rows"]:
        if row["final_error"] is not None and models()[row["key"]].pictured:
            kept = best.get(row["rung"])
            if kept is None or row["worst_error"] < kept["worst_error"]:
                best[row["rung"]] = row
    return sorted(best.values(), key=lambda row: (row["key"] == TRUTH, row["frame_ms"]))
