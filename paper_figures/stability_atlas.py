"""The stability atlas: a summary for a page, and a poster of every map (reads the study ``stability_atlas``)."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

from modalshell.files.study_result import StudyResult
from modalshell.render.maps import Boundary, MapPanel, draw_maps
from modalshell.render.shares import draw_shares

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


def draw(results: Path, folder: Path) -> list[Path]:
    """Draw from the result in ``results`` into ``folder``; return the PNGs' paths."""
    found = StudyResult.load(results, "stability_atlas").findings
    return [summary(found, folder / "stability_atlas.png"), poster(found, folder / "stability_atlas_poster.png")]


def summary(found: dict[str, Any], path: Path) -> Path:
    """Shares of the outcomes in each slice of each model, which fit a page."""
    shares = {}
    for name, maps in found["rows"].items():
        counts = [Counter(outcome for line in maps[key]["classes"] for outcome in line) for key in HEADINGS]
        shares[name] = [{outcome: n / count.total() for outcome, n in count.items()} for count in counts]
    return draw_shares(shares, list(HEADINGS.values()), COLORS, path)


def poster(found: dict[str, Any], path: Path) -> Path:
    """Every map."""
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
    return draw_maps(panels, COLORS, path, columns=len(HEADINGS), size=(2.7, 1.12), font=7.0, dpi=100.0)
