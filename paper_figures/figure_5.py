"""Paper Fig. 5: LMA, MWTS and DS overlaid on the V-beam (reads the study ``v_beam_accuracy``, soft membrane)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from modalshell.files.study_result import StudyResult
from modalshell.models.registry import models
from modalshell.render import ShadedSurface, View, draw_views

SHARES = (0.2, 0.5, 1.0)
"""Which loads are shown, as shares of the largest."""
OPACITIES = (0.6, 0.75, 1.0)
"""Of the models' shapes, cheapest model first."""


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    result = StudyResult.load(results, "v_beam_accuracy")
    rows = result.findings["soft"]["rows"]
    faces = result.arrays["soft_faces"]
    gravities = np.array([row["gravity"] for row in rows])
    views = []
    for share in SHARES:
        row = rows[int(np.argmin(np.abs(gravities - share * gravities.max())))]
        shapes = {key: result.arrays.get(f"soft_{key}_{row['gravity']:g}") for key in models()}
        shown = [(models()[key], positions) for key, positions in shapes.items() if positions is not None]
        surfaces = [
            ShadedSurface(positions, faces, color=spec.color, label=spec.name, opacity=opacity)
            for (spec, positions), opacity in zip(shown, OPACITIES, strict=True)
        ]
        errors = f"error: LMA {100 * row['lma_error']:.0f} %, MWTS {100 * row['mwts_error']:.1f} %"
        views.append(View(surfaces, title=f"Γ = {row['gamma']:.2g}", subtitle=errors, camera=(0.12, -1.0, 0.12)))
    return draw_views(views, folder / "figure_5.png", columns=3, size=(1800, 820))
