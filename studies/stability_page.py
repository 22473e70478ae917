"""The page of the study ``stability_atlas``: what its maps and limits say, in words."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from modalshell.study import StudyResult


def page(result: StudyResult) -> str:
    """Where each row works and what ends it, in words; then every limit that has a theory beside its measurement."""
    found = result.findings
    planes = {key: SimpleNamespace(**plane) for key, plane in found["slices"].items()}
    base, cells = (result.record["parameters"][key] for key in ("base", "cells"))
    lines = [
        f"A strip clamped at one end, {cells[0]} x {cells[1]} cells, at the base point: step 1/30 s (explicit: half "
        f"its limit), membrane over bending stiffness {base['ratio']:g}, Γ = {base['gamma']:g}, damping ratio "
        f"{base['damping']:g} of mode 1. Each column leaves it along one line; Γ and the damping ratio cross at "
        "Γ = 1 and a damping ratio of 1. Converged means a tip within "
        f"{100.0 * result.record['parameters']['tolerance']:g} % of the truth: DS statics where the run settles, "
        "else the same model at half the step.",
        "",
        "| model | step [s] | stiffness ratio | Γ | damping ratio | needles, aspect | fold [°] |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, maps in found["rows"].items():
        words = [
            across(maps, planes, "ratio", base),
            down(maps, planes, "ratio", base),
            across(maps, planes, "damping", base | {"damping": 1.0}),
            down(maps, planes, "damping", base),
            across(maps, planes, "needles", base),
            across(maps, planes, "fold", base),
        ]
        lines.append(f"| {name} | " + " | ".join(words) + " |")
    lines += ["", "Limits, by theory and by measurement:", "", "| model | limit | theory | measured | ratio |"]
    lines.append("|---|---|---|---|---|")
    for limit in found["limits"]:
        theory, measured, ratio = (limit[key] for key in ("theory", "measured", "ratio"))
        unit = "" if limit["unit"] == "1" else f" [{limit['unit']}]"
        shown = ["none found" if value is None else f"{value:.4g}" for value in (theory, measured)]
        if "beside" in limit:
            shown[0] = "–"
        lines.append(
            f"| {limit['row']} | {limit['what']}{unit} | {shown[0]} | {shown[1]} | "
            + ("–" if ratio is None else f"{ratio:.3f}")
            + " |"
        )
    counts = [sum(line.count(c) for maps in found["rows"].values() for m in maps.values() for line in m["classes"])
              for c in found["outcomes"]]  # fmt: skip
    lines += ["", "Cells: " + ", ".join(f"{n} {c}" for n, c in zip(counts, found["outcomes"], strict=True)) + "."]
    return "\n".join(lines)


def nearest(values: tuple[float, ...], wanted: float) -> int:
    """Place of the value nearest ``wanted``, by ratio where both are positive."""
    array = np.array(values)
    away = np.abs(np.log(array / wanted)) if wanted > 0.0 and (array > 0.0).all() else np.abs(array - wanted)
    return int(np.argmin(away))


def across(maps: dict[str, Any], planes: dict[str, SimpleNamespace], key: str, base: dict[str, float]) -> str:
    """Where a row of a map, through the base point, is converged."""
    plane = planes[key]
    return reach(plane.x_values, maps[key]["classes"][nearest(plane.y_values, base[plane.y])], base[plane.x])


def down(maps: dict[str, Any], planes: dict[str, SimpleNamespace], key: str, base: dict[str, float]) -> str:
    """Where a column of a map, through the base point, is converged."""
    plane = planes[key]
    place = nearest(plane.x_values, base[plane.x])
    return reach(plane.y_values, [line[place] for line in maps[key]["classes"]], base[plane.y])


def reach(values: tuple[float, ...], classes: list[str], base: float) -> str:
    """The converged stretch of values about the base point (or nearest to it), and what ends it on either side."""
    good = [place for place, name in enumerate(classes) if name == "converged"]
    if not good:
        return "nowhere: " + ", ".join(dict.fromkeys(classes))
    first = last = min(good, key=lambda place: abs(place - nearest(values, base)))
    while first > 0 and classes[first - 1] == "converged":
        first -= 1
    while last < len(values) - 1 and classes[last + 1] == "converged":
        last += 1
    if first == 0 and last == len(values) - 1:
        return "all"
    words = f"{values[first]:g} to {values[last]:g}" if first < last else f"{values[first]:g}"
    if first > 0:
        words += f"; below {classes[first - 1]}"
    if last < len(values) - 1:
        words += f"; beyond {classes[last + 1]}"
    return words
