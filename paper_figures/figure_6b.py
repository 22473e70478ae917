"""Paper Fig. 6b: relative area change of LMA, MWTS and DS over gravity (reads the study ``v_beam_accuracy``)."""

from __future__ import annotations

from pathlib import Path

from modalshell.render.curves import draw_curves
from paper_figures.v_beam_panels import v_beam_panels


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    panels = v_beam_panels(results, "area_change", "relative area change [%]")
    return draw_curves(panels, folder / "figure_6b.png")
