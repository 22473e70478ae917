"""Popular benchmarks of large deflections (Sze, Liu and Lo 2004, 3.1 and 3.3 to 3.5) with shells of shell theory.

A cantilever under end shear, a slit annulus lifted at its slit, a hemisphere with a hole under alternating forces, and
an open cylinder pulled apart; the last two on a quarter and an eighth, between planes of symmetry. Three mesh families
are mapped onto each surface. An error is the largest difference from the published displacements at a load, relative to
the largest of these.

Run it alone with ``modalshell reproduce --only large_deflection_benchmarks``.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import modalshell as ms
from modalshell.errors import ModalShellWarning
from modalshell.provenance import run_record
from modalshell.study import StudyResult, Table
from modalshell.supports import Support
from studies.both_energies import FAMILIES
from studies.pages import number

FIGURES = ("large_deflection_benchmarks",)

PROBLEMS = {"3.1": "cantilever", "3.3": "slit annulus", "3.4": "hemisphere", "3.5": "open cylinder"}
CELLS = {"3.1": (40, 4), "3.3": (98, 8), "3.4": (21, 18), "3.5": (16, 24)}
"""Cells along and across."""
SNAP = 0.5
"""Share of the load of 3.5 at which its wall buckles."""


def main(quick: bool = False, on_step: Callable[[int, int], None] | None = None) -> StudyResult:
    """All problems, mesh families and tabulated loads; ``quick`` takes one family, coarse meshes and few loads."""
    tables = json.loads(Path(__file__).with_name("sze_liu_lo.json").read_text(encoding="utf-8"))["problems"]
    cases = [(p, f) for p in PROBLEMS for f in (FAMILIES[:1] if quick else FAMILIES)]
    rows: list[dict[str, Any]] = []
    for done, (problem, family) in enumerate(cases, start=1):
        along, across = CELLS[problem]
        cells = (along // 2, across // 2) if quick else (along, across)
        entries = tables[problem]["rows"][4::5] if quick else tables[problem]["rows"]
        rows += [{"problem": problem, "mesh": family, **row} for row in solve(problem, family, cells, entries)]
        if on_step is not None:
            on_step(done, len(cases))
    return StudyResult("large_deflection_benchmarks", {"rows": rows}, {}, run_record({"cells": CELLS}))


def solve(problem: str, family: str, cells: tuple[int, int], entries: list[list[float]]) -> list[dict[str, Any]]:
    """Displacements at the tabulated loads, and their errors."""
    shell, force, watched = {"3.1": cantilever, "3.3": annulus, "3.4": hemisphere, "3.5": cylinder}[problem](
        family, cells
    )
    model = ms.DiscreteShell(shell)
    rows: list[dict[str, Any]] = []
    last = None
    for share, *published in entries:
        answer = model.equilibrium(force=share * force, start=last)
        last = answer.positions
        moved = last - shell.rest_positions
        found = [float(moved[vertex] @ direction) for vertex, direction in watched]
        error = max(abs(a - b) for a, b in zip(found, published, strict=True)) / max(map(abs, published))
        values = {"share": share, "found": found, "published": published, "error": error}
        rows.append({**values, "vertices": len(last), "status": answer.status})
    return rows


Problem = tuple[ms.Shell, np.ndarray, list[tuple[int, np.ndarray]]]
"""The shell, the whole load (n, 3) [N], and the watched vertices, each with a direction."""
X, Y, Z = np.eye(3)


def square(family: str, cells: tuple[int, int]) -> ms.TriangleMesh:
    """A mesh of the unit square with coordinates from 0 to 1."""
    if family == "equilateral":
        cells = (round(cells[0] * np.sqrt(3.0) / 2.0), cells[1])
    # Near-equilateral or square cells of the long sheet, which is then brought to the unit square.
    flat = ms.flat_beam(length=cells[0] / cells[1], width=1.0, cells=cells, family=family)
    points = np.array(flat.vertices)
    points[:, 0] /= cells[0] / cells[1]
    points[:, 1] += 0.5
    return ms.TriangleMesh(points, flat.faces)


def near(mesh: ms.TriangleMesh, point: tuple[float, float, float]) -> int:
    """The vertex at a point."""
    distances = np.linalg.norm(mesh.vertices - point, axis=1)
    return int(distances.argmin())


def spread(mesh: ms.TriangleMesh, line: np.ndarray, total: np.ndarray) -> np.ndarray:
    """A line load (n, 3) of ``total`` over the edges between the vertices ``line`` (bool), by their lengths."""
    edges = mesh.edges[line[mesh.edges].all(axis=1)]
    lengths = np.linalg.norm(mesh.vertices[edges[:, 1]] - mesh.vertices[edges[:, 0]], axis=1)
    weight = np.zeros(len(mesh.vertices))
    np.add.at(weight, edges, 0.5 * lengths[:, None] / lengths.sum())
    return np.outer(weight, total)


def cantilever(family: str, cells: tuple[int, int]) -> Problem:
    """3.1: length 10, width 1, thickness 0.1; the shear at its end is 4."""
    plain = square(family, cells)
    mesh = ms.TriangleMesh(plain.vertices * (10.0, 1.0, 1.0), plain.faces)
    x = mesh.vertices[:, 0]
    shell = ms.Shell(mesh, ms.Isotropic(1.2e6, 0.0, 0.1, 1.0), clamped=x < 1e-9)
    tip = near(mesh, (10.0, 0.5, 0.0))
    return shell, spread(mesh, np.isclose(x, 10.0), 4.0 * Z), [(tip, -X), (tip, Z)]


def annulus(family: str, cells: tuple[int, int]) -> Problem:
    """3.3: radii 6 and 10, thickness 0.03; one side of the slit is clamped, the other lifted by 0.8 a length."""
    plain = square(family, cells)
    u, v, _ = plain.vertices.T
    radius, angle = 6.0 * (10.0 / 6.0) ** v, 2.0 * np.pi * u
    points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), 0.0 * u])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModalShellWarning)  # the slit is meant
        mesh = ms.TriangleMesh(points, plain.faces[:, ::-1])
    shell = ms.Shell(mesh, ms.Isotropic(21e6, 0.0, 0.03, 1.0), clamped=u < 1e-9)
    end = np.isclose(u, 1.0)
    inner, outer = (int(np.flatnonzero(end)[pick(radius[end])]) for pick in (np.argmin, np.argmax))
    return shell, spread(mesh, end, 3.2 * Z), [(inner, Z), (outer, Z)]


def hemisphere(family: str, cells: tuple[int, int]) -> Problem:
    """3.4: a quarter of radius 10 and thickness 0.04 with a hole of 18 degrees; 400 pulls at A and pushes at B."""
    plain = square(family, cells)
    u, v, _ = plain.vertices.T
    low = np.log(np.tan(np.radians(9.0)))
    polar, angle = 2.0 * np.arctan(np.exp(low * (1.0 - u))), 0.5 * np.pi * v  # angles are kept
    points = 10.0 * np.column_stack([np.sin(polar) * np.cos(angle), np.sin(polar) * np.sin(angle), np.cos(polar)])
    mesh = ms.TriangleMesh(points, plain.faces)
    pulled, pushed = near(mesh, (0.0, 10.0, 0.0)), near(mesh, (10.0, 0.0, 0.0))
    supports: list[Support] = [
        ms.Symmetry(np.isclose(v, 1.0), (1.0, 0.0, 0.0)),
        ms.Symmetry(np.isclose(v, 0.0), (0.0, 1.0, 0.0)),
        ms.Fix([near(mesh, tuple(points[np.isclose(u, 0.0)][0]))], axes="z"),
    ]
    shell = ms.Shell(mesh, ms.Isotropic(6.825e7, 0.3, 0.04, 1.0), supports=supports)
    force = np.zeros_like(points)
    force[pulled], force[pushed] = 200.0 * Y, -200.0 * X  # halves: both lie in a plane of symmetry
    return shell, force, [(pulled, Y), (pushed, -X)]


def cylinder(family: str, cells: tuple[int, int]) -> Problem:
    """3.5: an eighth of radius 4.953, length 10.35 and thickness 0.094; 40,000 pull at its middle."""
    plain = square(family, cells)
    u, v, _ = plain.vertices.T
    angle = 0.5 * np.pi * v
    points = np.column_stack([4.953 * np.cos(angle), 5.175 * u, 4.953 * np.sin(angle)])
    mesh = ms.TriangleMesh(points, plain.faces)
    supports: list[Support] = [
        ms.Symmetry(np.isclose(u, 0.0), (0.0, 1.0, 0.0)),
        ms.Symmetry(np.isclose(v, 0.0), (0.0, 0.0, 1.0)),
        ms.Symmetry(np.isclose(v, 1.0), (1.0, 0.0, 0.0)),
    ]
    shell = ms.Shell(mesh, ms.Isotropic(10.5e6, 0.3125, 0.094, 1.0), supports=supports)
    pulled = near(mesh, (0.0, 0.0, 4.953))
    force = np.zeros_like(points)
    force[pulled] = 10000.0 * Z
    beside, end = near(mesh, (4.953, 0.0, 0.0)), near(mesh, (4.953, 5.175, 0.0))
    return shell, force, [(pulled, Z), (beside, -X), (end, -X)]


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
            before, beyond = ([r for r in own if (r["share"] > SNAP) == past] for past in (False, True))
            parts = [(", up to its snap", before), (", beyond", beyond)]
        for name, chosen in parts:
            worst = max(chosen, key=lambda row: row["error"])
            wrong = sum(row["status"] != "converged" for row in chosen)
            lines.append(
                f"| {problem} {PROBLEMS[problem]}{name} | {family} | {worst['vertices']} | {100 * worst['error']:.2f} "
                f"| {worst['share']:g} | {wrong} |"
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
    return f"Largest errors over all loads and three mesh families against Sze, Liu and Lo: {words}."
