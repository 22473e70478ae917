"""The stability atlas: a summary for a page, and a poster of every map (reads the study ``stability_atlas``)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from matplotlib.patches import Patch

from modalshell.files.study_result import StudyResult
from modalshell.render.maps import Boundary, MapPanel, draw_maps

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


def draw_shares(
    shares: Mapping[str, Sequence[Mapping[str, float]]], headings: Sequence[str], colors: Mapping[str, str], path: Path
) -> Path:
    """Draw a table of bars, one row per label and a column per heading, each bar split by the shares of its classes."""
    figure = Figure(figsize=(11.0, 7.6), layout="constrained", dpi=130.0)
    columns = figure.subplots(1, len(headings), sharey=True, squeeze=False)[0]
    places = range(len(shares))
    for column, (axes, heading) in enumerate(zip(columns, headings, strict=True)):
        starts = [0.0] * len(shares)
        for name, color in colors.items():
            widths = [bars[column].get(name, 0.0) for bars in shares.values()]
            axes.barh(places, widths, left=starts, height=0.78, color=color)
            starts = [start + width for start, width in zip(starts, widths, strict=True)]
        axes.set_xlim(0.0, 1.0)
        axes.set_xticks([0.0, 0.5, 1.0], ["0", "50 %", "100 %"], fontsize=8)
        axes.set_title(heading, fontsize=10)
        axes.spines[["top", "right", "left"]].set_visible(False)
        axes.tick_params(axis="y", length=0)
    columns[0].set_yticks(places, list(shares), fontsize=9)
    columns[0].set_ylim(len(shares) - 0.4, -0.6)
    handles = [Patch(facecolor=color, label=name) for name, color in colors.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    figure.savefig(path)
    return path


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
