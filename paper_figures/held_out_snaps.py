"""Errors of the hybrid model on loads drawn by a seed, and a film through the snap (reads ``held_out_snaps``)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from modalshell.files.study_result import StudyResult
from modalshell.render import ShadedSurface, write_film
from modalshell.render.curves import Curve, Panel, draw_curves

APART = 0.35
"""Distance between the shells of the film [m]."""
CAMERA = (0.9, -1.0, 0.45)


def draw(results: Path, folder: Path) -> list[Path]:
    """Draw from the result in ``results`` into ``folder``; return the paths of the PNG and the MP4."""
    result = StudyResult.load(results, "held_out_snaps")
    rows = [row for row in result.findings["rows"] if row["drawn"]]
    errors = 100.0 * np.array([[row[key] for key in ("coarse", "fine", "coarse_to_fine")] for row in rows])
    shares = 100.0 * (np.arange(len(errors)) + 0.5) / len(errors)
    labels = ("hybrid against coarse DS, which trained it", "hybrid against DS", "coarse DS against DS")
    colors = ("#e7298a", "#7b2d8e", "#66c2a5")
    curves = [
        Curve(np.sort(column), shares, label, color)
        for column, label, color in zip(errors.T, labels, colors, strict=True)
    ]
    shared = "motions with at most this error [%]"
    panel = Panel(curves, f"{len(errors)} motions, loads drawn by a seed", "error of the motion [%]", shared)
    return [draw_curves([panel], folder / "held_out_snaps.png"), film(result, folder / "held_out_snaps.mp4")]


def film(result: StudyResult, path: Path) -> Path:
    """DS and the hybrid side by side, under a gravity tilted aside and released."""
    rest, faces = result.arrays["rest"], result.arrays["faces"]
    surfaces, motions = [], []
    for place, (name, color) in enumerate((("film_DS", "#2f9e44"), ("film_hybrid", "#e7298a"))):
        moved = np.array([0.0, APART * place, 0.0])
        surfaces.append(ShadedSurface(rest + moved, faces, color=color, label=name.removeprefix("film_")))
        motions.append(np.concatenate([rest[None], result.arrays[name]]) + moved)
    title = "green: DS; pink: the hybrid, not trained on this load"
    return write_film(path, surfaces, motions, fps=15.0, camera=CAMERA, size=(800, 600), title=title)
