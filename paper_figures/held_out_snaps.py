"""Errors of the hybrid model through a snap, on loads drawn by a seed (reads the study ``held_out_snaps``)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from modalshell.render.curves import Curve, Panel, draw_curves
from modalshell.study import StudyResult


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    errors = 100.0 * StudyResult.load(results, "held_out_snaps").arrays["errors"]
    shares = 100.0 * (np.arange(len(errors)) + 0.5) / len(errors)
    labels = ("hybrid against coarse DS, which trained it", "hybrid against DS", "coarse DS against DS")
    colors = ("#e7298a", "#7b2d8e", "#66c2a5")
    curves = [
        Curve(np.sort(column), shares, label, color)
        for column, label, color in zip(errors.T, labels, colors, strict=True)
    ]
    panel = Panel(
        curves, f"{len(errors)} motions, loads drawn by a seed", "error of the motion [%]", "motions [%]", log_x=True
    )
    return draw_curves([panel], folder / "held_out_snaps.png")
