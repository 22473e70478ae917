"""Popular benchmarks of large deflections (Sze, Liu and Lo 2004) with shells of shell theory.

A cantilever under end shear and under an end moment, a slit annulus lifted at its slit, a hemisphere with a hole under
alternating forces, an open cylinder pulled apart, a cylinder pinched between diaphragms, and a pinched half of one; the
last four on a quarter, an eighth or a half, between planes of symmetry. Three mesh families are mapped onto each
surface. An error is the largest difference from the published displacements at a load, relative to the largest of
these. The published ones are of finite elements, those of 3.2 of the closed form. Where the walls of 3.5 and 3.6
buckle, loads are compared at the published displacement, too, on the path of equilibria. The wall of 3.6 buckles at
many loads, each time to one of several states; its meshes are graded towards the force.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import modalshell as ms
from modalshell.core.typing import Progress
from modalshell.files.provenance import run_record
from modalshell.files.study_result import StudyResult
from studies.pages import markdown
from studies.shell_theory import FAMILIES, crossed, rows_of
from studies.sze_liu_lo import GRADING, PROBLEMS, Problem

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
    "3.6": (42, 66),
    "3.7": (48, 48),
}
"""Cells along and across."""
QUICK = ("3.1", "3.2", "3.3", "3.4", "3.5")


class Steep(NamedTuple):
    """Where a wall buckles: tabulated shares of the load, the displacement that changes most, and shares around."""

    shares: tuple[float, ...]
    column: int
    path: tuple[float, float]


STEEP = {"3.5": Steep((0.525,), 1, (0.45, 0.57)), "3.6": Steep((0.15, 0.175), 0, (0.12, 0.18))}


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """All problems, mesh families and tabulated loads; ``quick`` takes one family, coarse meshes and few loads."""
    tables = json.loads(Path(__file__).with_name("sze_liu_lo.json").read_text(encoding="utf-8"))["problems"]
    steep: list[dict[str, Any]] = []

    def answers(problem: str, mesh: str) -> list[dict[str, Any]]:
        along, across = CELLS[problem]
        built = PROBLEMS[problem](mesh, (along // 2, across // 2) if quick else (along, across))
        entries = tables[problem]["rows"][4::5] if quick else tables[problem]["rows"]
        found = solve(built, entries)
        if problem in STEEP and not quick:
            at_snap = at_displacements(built, entries, STEEP[problem])
            steep.extend({"problem": problem, "mesh": mesh, **row} for row in at_snap)
        return found

    cases = crossed(problem=QUICK if quick else PROBLEMS, mesh=FAMILIES[:1] if quick else FAMILIES)
    rows = rows_of(answers, cases, on_step)
    record = run_record({"cells": CELLS, "steep": STEEP, "grading of 3.6": GRADING})
    return StudyResult("large_deflection_benchmarks", {"names": NAMES, "rows": rows, "steep": steep}, {}, record)


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


def at_displacements(problem: Problem, entries: list[list[float]], steep: Steep) -> list[dict[str, Any]]:
    """Shares of the load at which the path reaches published displacements where it is ``steep``, and their errors.

    None for a displacement that the path does not reach.
    """
    begin, until = steep.path
    # Between its points the load is interpolated, so they are close.
    path = ms.equilibrium_path(problem.shell, force=problem.force, begin=begin, until=until, steps=100)
    values = np.array([displacements(problem, positions)[steep.column] for positions in path.positions])
    rows: list[dict[str, Any]] = []
    for share, *published in (entry for entry in entries if entry[0] in steep.shares):
        above = values > published[steep.column]
        if above[0] or not above.any():
            rows.append({"share": share, "found": None, "error": None})
            continue
        k = int(np.argmax(above)) - 1
        part = (published[steep.column] - values[k]) / (values[k + 1] - values[k])
        found = float(path.factors[k] + part * (path.factors[k + 1] - path.factors[k]))
        rows.append({"share": share, "found": found, "error": abs(found / share - 1.0)})
    return rows


def largest_errors(found: dict[str, Any]) -> list[dict[str, Any]]:
    """The worst row of each problem on each mesh, before and beyond its snap, and those at its snap."""
    worst = []
    for problem, family in dict.fromkeys((row["problem"], row["mesh"]) for row in found["rows"]):
        parts = {"": (-np.inf, np.inf)}
        if problem in STEEP:
            shares = STEEP[problem].shares
            parts = {", up to its snap": (-np.inf, shares[0]), ", beyond": (shares[-1], np.inf)}
        for words, (low, high) in parts.items():
            own = [row for row in found["rows"] if (row["problem"], row["mesh"]) == (problem, family)]
            own = [row for row in own if low < row["share"] < high]
            wrong = sum(row["status"] != "converged" for row in own)
            named = {"name": f"{problem} {NAMES[problem]}{words}", "wrong": wrong}
            worst.append(max(own, key=lambda row: row["error"]) | named)
    for row in found["steep"]:
        name = f"{row['problem']} {NAMES[row['problem']]}, its snap: load at the displacement"
        worst.append({**row, "name": name, "vertices": None, "wrong": 0})
    return worst


def table(result: StudyResult) -> str:
    """The largest error of each problem and mesh, and every displacement, as Markdown tables."""
    rows = [
        row | {key: ", ".join(f"{value:.3f}" for value in row[key]) for key in ("found", "published")}
        for row in result.findings["rows"]
    ]
    largest = markdown(
        "problem | mesh | vertices | largest error [%] | at share of the load | not converged",
        "{name} | {mesh} | {vertices:} | {error:100*.2f} | {share:g} | {wrong}",
        largest_errors(result.findings),
    )
    every = markdown(
        "problem | mesh | share | found | published | error [%]",
        "{problem} | {mesh} | {share:g} | {found} | {published} | {error:100*.2f}",
        rows,
    )
    return f"{largest}\n\n{every}"


def finding(result: StudyResult) -> str:
    """The largest error of each problem over all meshes."""
    largest: dict[str, float] = {}
    for row in largest_errors(result.findings):
        largest[row["name"]] = max(largest.get(row["name"], 0.0), row["error"] or 0.0)
    words = "; ".join(f"{name} {100 * value:.2g} %" for name, value in largest.items())
    return f"Largest errors over all loads and three mesh families against Sze, Liu and Lo: {words}."
