"""Popular benchmarks of large deflections (Sze, Liu and Lo 2004) with shells of shell theory.

A cantilever under end shear and under an end moment, a slit annulus lifted at its slit, a hemisphere with a hole under
alternating forces, an open cylinder pulled apart, a cylinder pinched between diaphragms, and a pinched half of one; the
last four on a quarter, an eighth or a half, between planes of symmetry. Three mesh families are mapped onto each
surface. An error is the largest difference from the published displacements at a load, relative to the largest of
these. The published ones are of finite elements, those of 3.2 of the closed form. Where the wall of 3.5 buckles, loads
are compared at the published displacement, too, on the path of equilibria. The wall of 3.6 buckles at many loads, each
time to one of several states; it is solved on one family.

Run it alone with ``modalshell reproduce --only large_deflection_benchmarks``.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import modalshell as ms
from modalshell.provenance import run_record
from modalshell.study import StudyResult, Table
from studies.both_energies import FAMILIES
from studies.pages import number
from studies.sze_liu_lo import PROBLEMS, Problem

FIGURES = ("large_deflection_benchmarks",)

NAMES = {
    "3.1": "cantilever, end shear",
    "3.2": "cantilever, end moment",
    "3.3": "slit annulus",
    "3.4": "hemisphere",
    "3.5": "open cylinder",
    "3.6": "pinched cylinder",
    "3.7": "pinched semi-cylinder",
}
CELLS = {
    "3.1": (40, 4),
    "3.2": (60, 5),
    "3.3": (98, 8),
    "3.4": (28, 24),
    "3.5": (24, 36),
    "3.6": (28, 28),
    "3.7": (48, 48),
}
"""Cells along and across."""
FEWER = {"3.6": FAMILIES[:1]}
"""Problems on fewer mesh families: the wall of 3.6 buckles many times, which takes a quarter of an hour."""
QUICK = ("3.1", "3.2", "3.3", "3.4", "3.5")
SNAP, STEEP = 0.5, 0.525
"""Share of the load of 3.5 at which its wall buckles, and the tabulated one while it does."""
STEEPEST = 1
"""The displacement of 3.5 that changes most there."""
PATH = (0.45, 0.57)
"""Shares of the load between which the path of 3.5 is followed."""


def main(quick: bool = False, on_step: Callable[[int, int], None] | None = None) -> StudyResult:
    """All problems, mesh families and tabulated loads; ``quick`` takes one family, coarse meshes and few loads."""
    tables = json.loads(Path(__file__).with_name("sze_liu_lo.json").read_text(encoding="utf-8"))["problems"]
    families = FAMILIES[:1] if quick else FAMILIES
    cases = [(p, f) for p in (QUICK if quick else PROBLEMS) for f in FEWER.get(p, families)]
    rows: list[dict[str, Any]] = []
    steep = []
    for done, (name, family) in enumerate(cases, start=1):
        along, across = CELLS[name]
        problem = PROBLEMS[name](family, (along // 2, across // 2) if quick else (along, across))
        entries = tables[name]["rows"][4::5] if quick else tables[name]["rows"]
        rows += [{"problem": name, "mesh": family, **row} for row in solve(problem, entries)]
        if name == "3.5" and not quick:
            published = next(entry[1:] for entry in entries if entry[0] == STEEP)
            steep.append({"mesh": family, **at_displacement(problem, published)})
        if on_step is not None:
            on_step(done, len(cases))
    record = run_record({"cells": CELLS, "path": PATH})
    return StudyResult("large_deflection_benchmarks", {"rows": rows, "steep": steep}, {}, record)


def solve(problem: Problem, entries: list[list[float]]) -> list[dict[str, Any]]:
    """Displacements at the tabulated loads, and their errors."""
    shell = problem.shell
    model = ms.DiscreteShell(shell)
    rows: list[dict[str, Any]] = []
    last = None
    for share, *published in entries:
        moments = []
        if problem.moment is not None:
            end, most = problem.moment
            moments = [ms.EdgeMoment(end, share * most)]
        answer = model.equilibrium(force=share * problem.force, loads=moments, start=last)
        last = answer.positions
        found = displacements(problem, last)
        error = max(abs(a - b) for a, b in zip(found, published, strict=True)) / max(map(abs, published))
        values = {"share": share, "found": found, "published": published, "error": error}
        rows.append({**values, "vertices": len(last), "status": answer.status})
    return rows


def displacements(problem: Problem, positions: np.ndarray) -> list[float]:
    """What the watched vertices have moved by, each along its direction."""
    moved = positions - problem.shell.rest_positions
    return [float(moved[vertex] @ direction) for vertex, direction in problem.watched]


def at_displacement(problem: Problem, published: list[float]) -> dict[str, float]:
    """Share of the load at which the path reaches the ``published`` displacement that changes most, and its error."""
    begin, until = PATH
    path = ms.equilibrium_path(problem.shell, force=problem.force, begin=begin, until=until, steps=10)
    values = np.array([displacements(problem, positions)[STEEPEST] for positions in path.positions])
    above = values > published[STEEPEST]
    if above[0] or not above.any():
        return {"share": STEEP, "found": np.nan, "error": np.inf}
    k = int(np.argmax(above)) - 1
    part = (published[STEEPEST] - values[k]) / (values[k + 1] - values[k])
    found = float(path.factors[k] + part * (path.factors[k + 1] - path.factors[k]))
    return {"share": STEEP, "found": found, "error": abs(found / STEEP - 1.0)}


def table(result: StudyResult) -> str:
    """The largest error of each problem and mesh, and every displacement, as Markdown tables."""
    rows = result.findings["rows"]
    lines = [
        "| problem | mesh | vertices | largest error [%] | at share of the load | not converged |",
        "|---" * 6 + "|",
    ]
    for problem, family in dict.fromkeys((row["problem"], row["mesh"]) for row in rows):
        own = [r for r in rows if (r["problem"], r["mesh"]) == (problem, family)]
        parts = [("", own)]
        if problem == "3.5":
            before = [r for r in own if r["share"] <= SNAP]
            parts = [(", up to its snap", before), (", beyond", [r for r in own if r["share"] > STEEP])]
        for name, chosen in parts:
            worst = max(chosen, key=lambda row: row["error"])
            wrong = sum(row["status"] != "converged" for row in chosen)
            lines.append(
                f"| {problem} {NAMES[problem]}{name} | {family} | {worst['vertices']} | {100 * worst['error']:.2f} "
                f"| {worst['share']:g} | {wrong} |"
            )
    for row in result.findings["steep"]:
        lines.append(
            f"| 3.5 open cylinder, its snap: load at the displacement | {row['mesh']} | - | {100 * row['error']:.2f} "
            f"| {row['share']:g} | 0 |"
        )
    lines += ["", "| problem | mesh | share | found | published | error [%] |", "|---" * 6 + "|"]
    for row in rows:
        found, published = (", ".join(f"{value:.3f}" for value in row[key]) for key in ("found", "published"))
        where = f"| {row['problem']} | {row['mesh']} | {row['share']:g} "
        lines.append(f"{where}| {found} | {published} | {100 * row['error']:.2f} |")
    return "\n".join(lines)


def finding(tables: list[Table]) -> str:
    """The largest error of each problem over all meshes."""
    largest: dict[str, float] = {}
    for row in tables[0]:
        name = row["problem"]
        largest[name] = max(largest.get(name, 0.0), number(row["largest error [%]"]))
    words = "; ".join(f"{name} {value:.2g} %" for name, value in largest.items())
    return f"Largest errors over all loads and three mesh families (3.6: one) against Sze, Liu and Lo: {words}."
