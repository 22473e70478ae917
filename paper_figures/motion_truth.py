"""Errors over work by rule, and damping ratio over steps per period (reads the study ``motion_truth``)."""

from __future__ import annotations

from pathlib import Path

from modalshell.files.study_result import StudyResult
from modalshell.models.registry import TRUTH, models
from modalshell.render.curves import Curve, Panel, draw_curves

COLORS = {
    "exponential": "#2b5fc8",
    "implicit_midpoint": "#66c2a5",
    "composite": "#2f9e44",
    "sdirk2": "#8a5a9e",
    "bdf2": "#d98200",
    "implicit_euler": "#c8322b",
}
NAMES = {"exponential": "exponential", "implicit_midpoint": "midpoint", "sdirk2": "SDIRK2", "bdf2": "BDF2"}
NAMES |= {"implicit_euler": "implicit Euler", "composite": "composite"}
WARPING, COARSE, REFERENCE = models()["mwts"].name, models()["coarse-ds"].name, models()[TRUTH].name
MARKERS = {WARPING: "s", COARSE: "v", REFERENCE: "o"}


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    findings = StudyResult.load(results, "motion_truth").findings
    panels = []
    for rows, title in (
        (findings["cost"], "strip released under gravity, one period, damping ratio 0.03"),
        ([row for row in findings["snap"] if row["rung"] == COARSE], f"V-beam through its snap, {COARSE}"),
    ):
        curves = []
        for rung in dict.fromkeys(row["rung"] for row in rows):
            for rule in dict.fromkeys(row["rule"] for row in rows if row["rung"] == rung):
                own = [row for row in rows if (row["rung"], row["rule"]) == (rung, rule)]
                errors, work = [100.0 * row["error"] for row in own], [1e3 * row["cost"] for row in own]
                label, dashed = f"{rung}, {NAMES[rule]}", rung == COARSE
                curves.append(Curve(work, errors, label, COLORS[rule], dashed, marker=MARKERS[rung]))
        panels.append(
            Panel(curves, title, "counted work [ms of a reference machine]", "error [% of the length]", True, True)
        )
    curves = []
    for rung in (WARPING, REFERENCE):
        rows = [
            row for row in findings["damping"] if (row["energy"], row["rung"], row["asked"]) == ("hinges", rung, 0.03)
        ]
        for row in rows:
            if rung == REFERENCE or row["rule"] == "exponential":
                label = f"{rung}, {NAMES[row['rule']]}"
                curves.append(Curve(row["steps"], row["obtained"], label, COLORS[row["rule"]], marker=MARKERS[rung]))
    ends = [3.0, max(row["steps"][-1] for row in findings["damping"])]
    curves.append(Curve(ends, [0.03, 0.03], "prescribed", "black", dashed=True, points=False))
    panels.append(Panel(curves, "damping ratio of the motion", "steps per period", "damping ratio", True, True))
    return draw_curves(panels, folder / "motion_truth.png", columns=2)
