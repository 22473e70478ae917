"""A fitted tip curve, and intervals of the modulus from noisy ones (reads the study ``identification``)."""

from __future__ import annotations

from pathlib import Path

from modalshell.files.study_result import StudyResult
from modalshell.render.curves import Curve, Panel, draw_curves

MEASURED, FITTED, TRUE = "#c8322b", "#2b5fc8", "#000000"


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    findings = StudyResult.load(results, "identification").findings
    curve, exact = findings["curve"], findings["true"]
    loads = curve["gravities"]
    curves = [
        Curve(loads, [100.0 * drop for drop in curve["fitted"]], "with the modulus found", FITTED, points=False),
        Curve(loads, [100.0 * drop for drop in curve["measured"]], "finite elements", MEASURED, joined=False),
    ]
    first = Panel(curves, "Tip curve of a strip", "gravity [m/s²]", "drop of the tip [cm]")
    noisy = sorted(findings["noisy"], key=lambda found: found["young"])
    numbers = [float(number) for number in range(1, len(noisy) + 1)]
    young, low, high = ([found[key] / exact for found in noisy] for key in ("young", "low", "high"))
    label = "found, with its interval of 95 %"
    curves = [Curve(numbers, young, label, FITTED, joined=False, low=low, high=high)]
    curves.append(Curve([1.0, float(len(noisy))], [1.0, 1.0], "true", TRUE, points=False))
    second = Panel(curves, "Noisy tip curves, in order", "curve", "modulus over the true one", legend_inside=False)
    return draw_curves([first, second], folder / "identification.png", columns=2)
