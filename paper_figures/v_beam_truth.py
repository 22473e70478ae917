"""Drops of V-beams under growing gravity: models of both energies against finite elements (``v_beam_truth``)."""

from __future__ import annotations

from pathlib import Path

from modalshell.files.study_result import StudyResult
from modalshell.models.registry import models
from modalshell.render.curves import Curve, Panel, draw_curves

WORDS = {"Isotropic": "shell theory", "hinges": "hinges"}


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    rows = StudyResult.load(results, "v_beam_truth").findings["rows"]
    panels = []
    for beam in dict.fromkeys(row["beam"] for row in rows):
        curves = []
        for energy, words in WORDS.items():
            for key in dict.fromkeys(row["model"] for row in rows):
                own = [r for r in rows if (r["beam"], r["energy"], r["model"]) == (beam, energy, key)]
                spec = models()[key]
                gamma, drop = [r["gamma"] for r in own], [r["drop"] for r in own]
                label = f"{spec.name}, {words}"
                curves.append(Curve(gamma, drop, label, spec.color, dashed=energy == "hinges", points=False))
        gamma, exact = [r["gamma"] for r in own], [r["reference_drop"] for r in own]
        curves.append(Curve(gamma, exact, "finite elements", "black"))
        # LMA leaves the picture; the others do not.
        kept = [curve for curve in curves if not curve.label.startswith("LMA")]
        panels.append(Panel(kept, beam.replace(" deg", "°"), "gravity Γ", "drop of the ridge's tip [L]"))
    return draw_curves(panels, folder / "v_beam_truth.png", columns=2)
