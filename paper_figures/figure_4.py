"""Paper Fig. 4: flat and V-beam, each at flexure x1, x10 and x100 (reads the study ``flat_vs_v_beam``)."""

from __future__ import annotations

from pathlib import Path

from modalshell.files.study_result import StudyResult
from modalshell.models.registry import models
from modalshell.render import ShadedSurface, View, draw_views
from paper_figures.model_colors import paler

PALER = (0.5, 0.25, 0.0)
"""Shares of white in the colour of MWTS, of rising flexure: paler ones would look grey in the shade."""


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    result = StudyResult.load(results, "flat_vs_v_beam")
    views = []
    for name in dict.fromkeys(row["beam"] for row in result.findings["rows"]):
        rows = [row for row in result.findings["rows"] if row["beam"] == name]
        faces = result.arrays[f"{name}_faces"]
        surfaces = [
            ShadedSurface(
                result.arrays[f"{name}_x{row['flexure_factor']:g}_mwts"], faces,
                color=paler(models()["mwts"].color, white), label=f"flexure ×{row['flexure_factor']:g}",
            )
            for row, white in zip(rows, PALER, strict=True)
        ]  # fmt: skip
        surfaces.append(ShadedSurface(result.arrays[f"{name}_rest"], faces, color="#999999", style="outline"))
        warped, truth = (", ".join(f"{row[key]:.3f}" for row in rows) for key in ("mwts_tip_drop", "ds_tip_drop"))
        views.append(
            View(
                surfaces,
                title="flat" if name == "flat" else f"V, {rows[0]['fold_degrees']:g}°",
                subtitle=f"tip drop {warped} L\n(DS {truth} L)",
                camera=(0.55, -1.0, 0.35),
            )
        )
    return draw_views(views, folder / "figure_4.png", columns=2, size=(1500, 840), link_cameras=False)
