"""The page of the study ``stability_atlas``: explanation of its maps and limits."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from modalshell.files.study_result import StudyResult
from studies.stability_models import ROWS

LIMIT = ("theory", "measured")
RIGHT = ("converged", "agrees with half the step")
ADVICE = """Before choosing a step:

* Explicit Euler and Verlet: stay below `stable_step(damping)` of `DiscreteShell` or `SpringSheet`{steps}. A stiffer
  membrane and needles shorten it; so do springs across hinges. It is a limit of small motion about rest: under very
  large loads even half of it may fail. The classical grid has its own, `SheetGrid.stable_step()`.
* Implicit Euler is stable at any step as such, but adds less than 5 % of damping to the first mode only below 0.1 / ω₁.
  The midpoint rule shifts that mode's frequency by less than 5 % up to 0.79 / ω₁, and rings on at long steps.
* Linearised implicit Euler solves once a step, and gives up less often than the Newton of implicit Euler; but nothing
  says that one solution was enough: take half the step and compare.
* MWTS and RSW take their modal force from the step before, or from a predicted middle. Long steps lose the equilibrium
  by that, the sooner the larger the load: where `studies.modal_steps.step_radius` passes one.
* MWTS loses its equilibrium under large loads at any step, by flutter; damping puts it off. RSW does not.
* Needles of an aspect of 1e5 have modes refused and DS not converged, MD-ROM and springs sooner; no step avoids that, a
  better mesh does.
* A flat sheet of springs has no bending stiffness at small angles and hangs as cloth does: the maps call that
  inaccurate whatever the step, and right only where the load outweighs the bending.
"""


def page(result: StudyResult) -> str:
    """Where each row works and what ends it, as text; then every limit that has a theory, with its measurement."""
    found = result.findings
    planes = {key: SimpleNamespace(**plane) for key, plane in found["slices"].items()}
    base, cells = (result.record["parameters"][key] for key in ("base", "cells"))
    lines = [
        "[The poster](../paper_figures/stability_atlas_poster.png) shows every map; the summary, the share of each "
        "outcome.",
        "",
        f"A strip clamped at one end, {cells[0]} x {cells[1]} cells, at the base point: step 1/30 s (explicit: half "
        f"its limit), membrane over bending stiffness {base['ratio']:g}, Γ = {base['gamma']:g}, damping ratio "
        f"{base['damping']:g} of mode 1. Each column leaves it along one line; Γ and the damping ratio cross at "
        "Γ = 1 and a damping ratio of 1. A cell is right if the tip is within "
        f"{100.0 * result.record['parameters']['tolerance']:g} % of the truth: DS statics where the run of 40 to 80 "
        "steps settles, else the same model at half the step. So short a run says little of slow growth: there the "
        "theory's lines count; one at the left edge of a map calls all of its row unstable up to the next line.",
        "",
        "| model | longest stable step [s]: theory, measured | step [s] | stiffness ratio | Γ | damping ratio "
        "| needles, aspect | fold [°] |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name, maps in found["rows"].items():
        base = result.record["parameters"]["base"] | {"step": found["steps"][name]}
        words = [
            longest_step(found["limits"], name),
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
    return "\n".join([ADVICE.format(steps=shown_steps(found["limits"])), *lines])


def shown_steps(limits: list[dict[str, Any]]) -> str:
    """The longest steps of Verlet at the base point, as an aside."""
    steps = {
        limit["model"]: f"{1e3 * limit['theory']:.2g} ms for {limit['model']}"
        for limit in limits
        if limit["rule"] == "Verlet" and limit["what"] == "longest step at rest (undamped)"
    }
    return f" (here, undamped, {steps['DS']} and {steps['springs']})"


def longest_step(limits: list[dict[str, Any]], name: str) -> str:
    """The first limit of the step of one row, and at what it holds."""
    row = next(row for row in ROWS if row.name == name)
    if row.coordinates:
        return f"as {row.coordinates.partition(', ')[0]}: the coordinates are the same"
    for limit in limits:
        if limit["row"] == name and limit["what"].startswith("longest step"):
            theory, measured = ("none found" if limit[key] is None else f"{limit[key]:.4g}" for key in LIMIT)
            return f"{theory}, {measured} {limit['what'].removeprefix('longest step ')}"
    return "any" if row.kind == "linear" else "any, about rest"


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
    """The stretch of values that are right about the base point (or nearest to it), and what ends it on either side."""
    right = [name in RIGHT for name in classes]
    good = [place for place, name in enumerate(right) if name]
    if not good:
        return "nowhere: " + ", ".join(dict.fromkeys(classes))
    first = last = min(good, key=lambda place: abs(place - nearest(values, base)))
    while first > 0 and right[first - 1]:
        first -= 1
    while last < len(values) - 1 and right[last + 1]:
        last += 1
    if first == 0 and last == len(values) - 1:
        return "all"
    words = f"{values[first]:g} to {values[last]:g}" if first < last else f"{values[first]:g}"
    if first > 0:
        words += f"; below {classes[first - 1]}"
    if last < len(values) - 1:
        words += f"; beyond {classes[last + 1]}"
    return words
