"""The two panels that Fig. 6a and 6b share: one a regime of the study ``v_beam_accuracy``, its snap marked."""

from __future__ import annotations

from pathlib import Path

from modalshell.files.study_result import StudyResult
from modalshell.models.registry import models
from modalshell.render.curves import Curve, Line, Panel, Style

MARKS: tuple[tuple[str, str, Style], ...] = (
    ("bifurcation", "bifurcation: twisting", ":"),
    ("limit", "limit point", "-"),
    ("stable_again", "stable again", "--"),
)
TITLES = {"soft": "soft membrane: the fold keeps its shape", "stiff": "stiff membrane: the fold flattens and snaps"}


def v_beam_panels(results: Path, quantity: str, label: str, log: bool = False) -> list[Panel]:
    """Panels of a quantity [%] over Gamma, read from ``results``, one curve for every model that has it."""
    result = StudyResult.load(results, "v_beam_accuracy")
    panels = []
    for regime, title in TITLES.items():
        rows, snap = result.findings[regime]["rows"], result.findings[regime]["snap"]
        gamma = [row["gamma"] for row in rows]
        curves = [
            Curve(gamma, [100 * row[f"{spec.key}_{quantity}"] for row in rows], spec.name, spec.color)
            for spec in models().values()
            if f"{spec.key}_{quantity}" in rows[0]
        ]
        panels.append(
            Panel(
                curves,
                title,
                "gravity Γ",
                label,
                log=log,
                band=(snap["gamma"], snap["gamma"]) if snap else None,
                band_label=f"after the snap of DS at Γ = {snap['gamma']:.3f}" if snap else "",
                lines=[
                    Line(snap[key], f"{text} at Γ = {snap[key]:.3f}", style)
                    for key, text, style in MARKS
                    if snap and snap[key] is not None
                ],
            )
        )
    return panels
