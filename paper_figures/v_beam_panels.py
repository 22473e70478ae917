"""The two panels that Fig. 6a and 6b share: one a regime of the study ``v_beam_accuracy``, its snap marked."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from modalshell.compare.draw import model_colors
from modalshell.render.curves import Curve, Panel
from modalshell.study import StudyResult

TITLES = {"soft": "soft membrane: the fold keeps its shape", "stiff": "stiff membrane: the fold flattens and snaps"}


def v_beam_panels(results: Path, models: Sequence[str], quantity: str, label: str, log: bool = False) -> list[Panel]:
    """Panels of ``{model}_{quantity}`` [%] over Gamma, read from ``results``."""
    result = StudyResult.load(results, "v_beam_accuracy")
    panels = []
    for regime, title in TITLES.items():
        rows, snap = result.findings[regime]["rows"], result.findings[regime]["snap"]
        gamma = [row["gamma"] for row in rows]
        curves = [
            Curve(gamma, [100 * row[f"{model.lower()}_{quantity}"] for row in rows], model, model_colors()[model])
            for model in models
        ]
        panels.append(
            Panel(
                curves,
                title,
                "gravity Γ",
                label,
                log=log,
                band=tuple(snap["gamma"]) if snap else None,
                band_label=f"after the snap of DS at Γ = {snap['gamma'][1]:.2f}" if snap else "",
            )
        )
    return panels
