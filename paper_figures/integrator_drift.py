"""Drift of the summed warp over cycles and step size, and the closed form's (reads the study ``integrator_drift``)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from modalshell.files.study_result import StudyResult
from modalshell.render.curves import Curve, Panel, draw_curves

SCENES = {"v_beam": "V-beam, gravity (and side load)", "strip": "Strip, twist (and gravity)"}
LOADS = {"line": "one load", "loop": "two loads"}
SHADES = {"line": ("#b3c9f0", "#6d95de", "#2b5fc8"), "loop": ("#f2b8b4", "#dd716b", "#c8322b")}
GREEN, GREY = "#2f9e44", "0.45"
FLOOR = 1e-17
"""Where an exact zero is drawn on the logarithmic axes."""


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    findings = StudyResult.load(results, "integrator_drift").findings
    panels = []
    for scene, title in SCENES.items():
        panels += [cycle_panel(findings[scene], title), step_panel(findings[scene], title)]
    return draw_curves(panels, folder / "integrator_drift.png", columns=2)


def cycle_panel(found: dict[str, Any], title: str) -> Panel:
    """Drift after each cycle, for several steps, and the closed form's, the larger of both paths."""
    curves = []
    for path, words in LOADS.items():
        for (count, run), color in zip(found[path]["cycled"].items(), SHADES[path], strict=True):
            cycles = np.arange(1, len(run["sum"]) + 1)
            curves.append(Curve(cycles, run["sum"], f"sum, {words}, {count} steps a cycle", color))
    rest = np.max([found[path]["cycled"][count]["closed_form"] for path in LOADS], axis=0)
    curves.append(Curve(cycles, np.maximum(rest, FLOOR), "closed form, either", GREEN))
    return Panel(curves, f"{title}: drift over the cycles", "cycles", "distance from rest [L]", log=True, log_x=True)


def step_panel(found: dict[str, Any], title: str) -> Panel:
    """Drift of the sum after one cycle, over the step, the loop's with and without its limit."""
    line, loop = found["line"], found["loop"]
    step = 1.0 / np.array(line["steps"])
    ends = np.array([step.min(), step.max()])
    blue, red = (SHADES[path][-1] for path in LOADS)
    curves = [
        Curve(step, line["drift"], "sum, one load", blue),
        Curve(step, loop["drift"], "sum, two loads out of phase", red),
        Curve(step, loop["step_part"], f"the same, less its limit of {loop['path_part']:.2g} L", red, dashed=True),
        Curve(ends, 0.5 * line["drift"][0] * ends / ends[-1], "first order", GREY, dashed=True, points=False),
    ]
    words = "distance from rest after one cycle [L]"
    return Panel(curves, f"{title}: drift over the step", "step [share of a cycle]", words, log=True, log_x=True)
