"""Seconds a frame of implicit cloth, and the share of each task, over its size (reads the study ``cloth_scaling``)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from modalshell.files.study_result import StudyResult
from modalshell.render.curves import Curve, Panel, draw_curves

COLORS = {
    "force": "#8fb3e8",
    "matrix update": "#c8322b",
    "acceleration": "#2b5fc8",
    "velocity": "#5bb98b",
    "position": "#d9a6c2",
}


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    found = StudyResult.load(results, "cloth_scaling").findings
    rows, published = found["rows"], found["published"]
    particles = np.array([row["particles"] for row in rows])
    threads = max(row["threads"] for row in rows)
    mark = f"published, {published['threads']} threads"
    times = [
        Curve([published["particles"]], [published["frame"]], mark, "0.2"),
        Curve(particles, [row["explicit"]["frame"] for row in rows], "explicit, 1 thread", "0.55", dashed=True),
        Curve(particles, [row["one"]["frame"] for row in rows], "implicit, 1 thread", "#8fb3e8"),
        Curve(particles, [row["free"]["frame"] for row in rows], f"implicit, up to {threads} threads", "#2b5fc8"),
    ]
    shares = [
        Curve(
            particles,
            [100.0 * row["free"]["tasks"][task] / row["free"]["frame"] for row in rows],
            task,
            color,
        )
        for task, color in COLORS.items()
    ]
    shares.append(
        Curve([published["particles"]], [100.0 * published["matrix_share"]], "matrix update, published", "0.2")
    )
    panels = [
        Panel(times, "Three steps of ten iterations", "particles", "seconds a frame", log=True, log_x=True),
        Panel(shares, "Where the time goes", "particles", "share of a frame [%]", log_x=True),
    ]
    return draw_curves(panels, folder / "cloth_scaling.png", columns=2)
