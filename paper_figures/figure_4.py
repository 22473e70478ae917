"""Paper Fig. 4: flat and V-beam, side by side, at flexure x1, x10 and x100 (reads the study ``flat_vs_v_beam``)."""

from __future__ import annotations

from pathlib import Path

from modalshell.render import ShadedSurface, View, draw_views
from modalshell.study import StudyResult


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    result = StudyResult.load(results, "flat_vs_v_beam")
    views = []
    for row in result.findings["rows"]:
        name, factor = row["beam"], row["flexure_factor"]
        positions = result.arrays[f"{name}_x{factor:g}_mwts"]
        faces = result.arrays[f"{name}_faces"]
        surfaces = [
            ShadedSurface(positions, faces, color="#7fa8d6", edges=True),
            ShadedSurface(result.arrays[f"{name}_rest"], faces, color="#999999", style="outline"),
        ]
        beam = "flat" if name == "flat" else f"V, {row['fold_degrees']:g}°"
        views.append(
            View(
                surfaces,
                title=f"{beam}, flexure ×{factor:g}",
                subtitle=f"tip drop {row['mwts_tip_drop']:.3f} L (DS {row['ds_tip_drop']:.3f} L)",
                camera=(0.55, -1.0, 0.35),
            )
        )
    return draw_views(views, folder / "figure_4.png", columns=2, size=(1500, 1350))
