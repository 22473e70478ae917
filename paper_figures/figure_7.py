"""Paper Fig. 7: a flat beam whose tip has a target position, orientation or both (reads the study ``manipulation``)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from modalshell.files.study_result import StudyResult
from modalshell.models.registry import TRUTH, models
from modalshell.render import ShadedSurface, View, draw_views
from paper_figures.glyphs import axes, sphere

CAMERA = (-0.55, -1.0, 0.5)
ARM = 0.2


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    result = StudyResult.load(results, "manipulation")
    arrays = result.arrays
    faces, tip = arrays["faces"], int(arrays["tip"])
    views = []
    for number, row in enumerate(result.findings["rows"], start=1):
        key = f"case_{number}"
        positions = arrays[f"{key}_mwts"]
        surfaces = [
            ShadedSurface(positions, faces, color="#8fb3d9", edges=True, label=models()["mwts"].name),
            ShadedSurface(arrays["rest"], faces, color="#aaaaaa", style="outline"),
        ]
        if f"{key}_ds" in arrays:
            surfaces.append(
                ShadedSurface(arrays[f"{key}_ds"], faces, color="#2ca02c", style="outline", label=models()[TRUTH].name)
            )
        held = positions[tip]
        if row["position"] is not None:
            target = sphere(row["position"], 0.034)
            surfaces.append(
                ShadedSurface(*target, "#ffb000", opacity=0.55, smooth=True, lined=False, label="target position")
            )
        vertex = sphere(held, 0.018)
        surfaces.append(ShadedSurface(*vertex, "#3a3a3a", smooth=True, lined=False, label="constrained vertex"))
        if row["rotation_vector"] is not None:
            # The target's axes are longer and pale, so that they show beyond the vertex's own where both agree.
            surfaces += axes(held, row["rotation_vector"], 1.6 * ARM, opacity=0.4)
            surfaces += axes(held, arrays[f"{key}_turn"], ARM)
        views.append(View(surfaces, title=row["case"], subtitle=_caption(row), camera=CAMERA))
    modes = result.record["parameters"]["modes"]
    title = (
        f"A flat beam with targets at its tip: MWTS, {modes} modes\nAxes: red x, green y, blue z; long and pale: target"
    )
    return draw_views(views, folder / "figure_7.png", columns=3, size=(1800, 1150), title=title)


def _caption(row: dict[str, object]) -> str:
    worst = float(np.max(np.asarray(row["residuals"], dtype=np.float64)))
    text = f"residual {worst:.0e}, {row['modal_energy']:.2f} J"
    return text + (f" (DS {row['ds_energy']:.2f} J)" if "ds_energy" in row else "")
