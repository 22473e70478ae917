"""Maps of the cheapest rung that a strip needs (reads the study ``validity_map``)."""

from __future__ import annotations

from pathlib import Path

from modalshell.files.study_result import StudyResult
from modalshell.models.registry import models
from modalshell.render.curves import Style
from modalshell.render.maps import Boundary, MapPanel, draw_maps

NO_ANSWER = "#dddddd"
MARKS: tuple[tuple[str, str, Style, str], ...] = (
    ("limit", "limit point of DS (snap)", "-", "black"),
    ("bifurcation", "bifurcation of DS", "-", "#ffd92f"),
    ("stable_again", "stable again", "--", "#00d8ff"),
)
AXES = {
    "fold": ("fold [degrees]", "fold, membrane {membrane:g} N/m"),
    "membrane": ("membrane stiffness [N/m]", "membrane, fold {fold:g}°"),
}


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    result = StudyResult.load(results, "validity_map")
    found = result.findings
    panels = []
    for axis, (label, title) in AXES.items():
        rows = found["maps"][axis]["rows"]
        boundaries = [
            Boundary([[] if case[name] is None else [case[name]] for case in rows], words, style, color)
            for name, words, style, color in MARKS
        ]
        for tolerance, cheapest in zip(found["tolerances"], found["maps"][axis]["cheapest"], strict=True):
            panels.append(
                MapPanel(
                    found["gammas"],
                    found["maps"][axis]["values"],
                    cheapest,
                    f"cheapest within {100 * tolerance:g} %: " + title.format(**result.record["parameters"]["fixed"]),
                    "gravity Γ",
                    label,
                    x_scale="log",
                    boundaries=boundaries,
                )
            )
    present = {name for panel in panels for row in panel.classes for name in row}
    colors = {spec.name: spec.color for spec in models().values() if spec.name in present}
    if "no answer" in present:
        colors["no answer"] = NO_ANSWER
    return draw_maps(panels, colors, folder / "validity_map.png", columns=3)
