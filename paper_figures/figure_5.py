"""Paper Fig. 5: LMA, MWTS and DS side by side on the V-beam (reads the study ``v_beam_accuracy``, soft membrane)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from modalshell.files.study_result import StudyResult
from modalshell.models.registry import TRUTH, models
from modalshell.render import ShadedSurface, View, draw_views
from paper_figures.model_colors import paler

SHARES = (0.2, 0.5, 1.0)
"""Which loads are shown, as shares of the largest."""
PALER = (0.6, 0.3, 0.0)
"""Shares of white in the colours of these loads."""
WHAT = {"lma": "linear modes", "mwts": "modal warping", "ds": "every vertex free"}
"""Models from left to right, in words."""
CAMERA = (0.3, -1.0, 0.25)


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    result = StudyResult.load(results, "v_beam_accuracy")
    rows, faces = result.findings["soft"]["rows"], result.arrays["soft_faces"]
    gravities = np.array([row["gravity"] for row in rows])
    chosen = [rows[int(np.argmin(np.abs(gravities - share * gravities.max())))] for share in SHARES]
    views = []
    for key, words in WHAT.items():
        spec, surfaces = models()[key], []
        for row, share in zip(chosen, PALER, strict=True):
            shape, truth = (result.arrays[f"soft_{name}_{row['gravity']:g}"] for name in (key, TRUTH))
            surfaces.append(ShadedSurface(shape, faces, color=paler(spec.color, share)))
            if key != TRUTH:
                surfaces.append(ShadedSurface(truth, faces, color=models()[TRUTH].color, style="outline"))
        if key == TRUTH:
            told = "the reference, outlined in green at the left"
        else:
            errors = [100.0 * row[f"{key}_error"] for row in chosen]
            told = f"{', '.join(f'{error:.0f}' for error in errors[:-1])} and {errors[-1]:.0f} % off the reference"
        views.append(View(surfaces, title=f"{spec.name}: {words}", subtitle=told, camera=CAMERA))
    return draw_views(views, folder / "figure_5.png", columns=3, size=(1800, 760), legend=False)
