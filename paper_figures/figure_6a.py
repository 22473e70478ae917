"""Paper Fig. 6a: relative displacement error of LMA and MWTS over gravity (reads the study ``v_beam_accuracy``)."""

from __future__ import annotations

from pathlib import Path

from modalshell.render.curves import MODEL_COLORS, Curve, Panel, draw_curves
from modalshell.study import StudyResult

TITLES = {"soft": "soft membrane: the fold keeps its shape", "stiff": "stiff membrane: the fold flattens and snaps"}


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    result = StudyResult.load(results, "v_beam_accuracy")
    panels = []
    for regime, title in TITLES.items():
        rows, snap = result.findings[regime]["rows"], result.findings[regime]["snap"]
        gamma = [row["gamma"] for row in rows]
        curves = [
            Curve(gamma, [100 * row[f"{model.lower()}_error"] for row in rows], model, MODEL_COLORS[model])
            for model in ("LMA", "MWTS")
        ]
        panels.append(
            Panel(
                curves,
                title,
                "gravity Γ",
                "displacement error against DS [%]",
                log=True,
                band=tuple(snap["gamma"]) if snap else None,
                band_label=f"after the snap of DS at Γ = {snap['gamma'][1]:.2f}" if snap else "",
            )
        )
    return draw_curves(panels, folder / "figure_6a.png")
