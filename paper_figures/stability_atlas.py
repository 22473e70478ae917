"""The stability atlas: one map a model and slice, on one page (reads the study ``stability_atlas``)."""

from __future__ import annotations

from pathlib import Path

from modalshell.render.maps import Boundary, MapPanel, draw_maps
from modalshell.study import StudyResult

COLORS = {
    "converged": "#7fc29b",
    "agrees with half the step": "#cde6d3",
    "inaccurate": "#f2d98d",
    "cycling": "#8fb3e8",
    "wound up": "#7d5fb2",
    "steps not converged": "#e8975a",
    "diverged": "#b0304f",
    "refused": "#b5b5b5",
}
HEADINGS = {
    "ratio": "step and stiffness",
    "load": "step and load",
    "damping": "load and damping",
    "needles": "needles and stiffness",
    "fold": "fold and load",
}
NAMES = {
    "step": "step [s]",
    "ratio": "membrane/bend.",
    "gamma": "Γ",
    "damping": "damping ratio",
    "aspect": "aspect of needles",
    "fold": "rest fold [°]",
}


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    found = StudyResult.load(results, "stability_atlas").findings
    panels = []
    names = list(found["rows"])
    for name in names:
        for key, plane in found["slices"].items():
            maps = found["rows"][name][key]
            title = name if key == "ratio" else ""
            if name == names[0]:
                title = f"{HEADINGS[key]}\n{title}"
            coloured = [[] if step is None else [step] for step in maps["coloured"]]
            panels.append(
                MapPanel(
                    plane["x_values"],
                    plane["y_values"],
                    maps["classes"],
                    title,
                    NAMES[plane["x"]] if name == names[-1] else "",
                    NAMES[plane["y"]],
                    x_scale="even" if key == "fold" else "log",
                    boundaries=[
                        Boundary(maps["limits"], "limit of stability, theory"),
                        Boundary(coloured, "integrator adds 5 % damping, or shifts the frequency by 5 %", ":"),
                    ],
                )
            )
    return draw_maps(
        panels, COLORS, folder / "stability_atlas.png", columns=len(HEADINGS), size=(2.7, 1.12), font=7.0, dpi=100.0
    )
