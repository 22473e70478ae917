"""What the mesh does to a plate: five families, jittered and random ones, refined, with both bending energies.

Two problems with known answers, Poisson's ratio 0.3. A simply supported square plate under uniform load, against
Navier's series. A free plate held at three corners and loaded at the fourth: pure twist, whose
deflection P x y / (2 D (1 - nu)) an energy of shell theory has exactly on every mesh, as all its moments are constant.
Errors are those of the whole deflection, in the mass norm.

Run it alone with ``modalshell reproduce --only mesh_bias``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial import Delaunay

import modalshell as ms
from modalshell.provenance import run_record
from modalshell.study import StudyResult, Table
from modalshell.supports import Support
from studies.both_energies import ENERGIES, Sheet, flat_shell
from studies.pages import number

FIGURES = ("mesh_bias",)

SHEET: Sheet = {"young": 1e9, "poisson": 0.3, "thickness": 1e-2, "density": 1000.0}
FAMILIES = ("union-jack", "right", "equilateral", "lloyd", "delaunay")
MESHES = (*FAMILIES, "jittered", "random")
PROBLEMS = ("supported", "twisted")
JITTER = 0.2
"""Share of a cell by which inner vertices of the jittered mesh are moved at most along each axis."""
SMALL = 1e-5
"""Deflection that the loads are for [lengths]: linear theory holds."""


def main(quick: bool = False, on_step: Callable[[int, int], None] | None = None) -> StudyResult:
    """All meshes, sizes, energies and problems; ``quick`` leaves out the finest meshes."""
    sizes = (6, 12) if quick else (8, 16, 32)
    rows: list[dict[str, Any]] = []
    cases = [(name, cells) for name in MESHES for cells in sizes]
    for done, (name, cells) in enumerate(cases, start=1):
        mesh = square(name, cells)
        for energy in ENERGIES:
            for problem in PROBLEMS:
                error = deviation(energy, mesh, problem)
                found = {"mesh": name, "cells": cells, "vertices": len(mesh.vertices), "energy": energy}
                rows.append({**found, "problem": problem, "error": error})
        if on_step is not None:
            on_step(done, len(cases))
    parameters = {**SHEET, "sizes": sizes, "meshes": MESHES, "jitter": JITTER}
    return StudyResult("mesh_bias", {"rows": rows, "orders": orders(rows)}, {}, run_record(parameters))


def square(name: str, cells: int) -> ms.TriangleMesh:
    """A unit square of about ``cells`` cells a side."""
    if name in FAMILIES:
        columns = round(cells * 2.0 / np.sqrt(3.0)) if name == "equilateral" else cells
        return ms.sheet(length=1.0, width=1.0, cells=(columns, cells), family=name)
    random = np.random.default_rng(cells)
    regular = ms.sheet(length=1.0, width=1.0, cells=(cells, cells))
    vertices = np.array(regular.vertices)
    inner = np.ones(len(vertices), dtype=bool)
    inner[regular.boundary_vertices] = False
    if name == "jittered":
        vertices[inner, :2] += random.uniform(-JITTER, JITTER, (np.count_nonzero(inner), 2)) / cells
        return ms.TriangleMesh(vertices, regular.faces)
    # As many points anywhere, but no nearer the edge or each other than a third of a cell.
    points = list(vertices[~inner, :2])
    while len(points) < len(vertices):
        point = random.uniform((0.0, -0.5), (1.0, 0.5))
        if np.linalg.norm(np.array(points) - point, axis=1).min() > 1.0 / (3.0 * cells):
            points.append(point)
    corners = Delaunay(np.array(points)).simplices
    return ms.TriangleMesh(np.column_stack([points, np.zeros(len(points))]), corners)


def deviation(energy: str, mesh: ms.TriangleMesh, problem: str) -> float:
    """Mass norm of the deflection less that of Kirchhoff's plate, over the norm of the latter."""
    shell, load, exact = loaded(energy, mesh, problem)
    return difference(shell, ms.DiscreteShell(shell).equilibrium(force=load).positions, exact)


def difference(shell: ms.Shell, positions: np.ndarray, exact: np.ndarray) -> float:
    """Mass norm of the deflection less the ``exact`` one (n,), over the norm of the latter."""
    return float(np.sqrt((shell.mass @ (positions[:, 2] - exact) ** 2) / (shell.mass @ exact**2)))


def loaded(energy: str, mesh: ms.TriangleMesh, problem: str) -> tuple[ms.Shell, np.ndarray, np.ndarray]:
    """The plate of a problem, its load (n, 3) [N], and Kirchhoff's deflection (n,) [m]."""
    x, y, _ = mesh.vertices.T
    rigidity = SHEET["young"] * SHEET["thickness"] ** 3 / (12.0 * (1.0 - SHEET["poisson"] ** 2))
    if problem == "supported":
        supports: list[Support] = [ms.Pin(mesh.boundary_vertices)]
        shape = navier(x, y + 0.5)
    else:
        corners = ((0.0, -0.5), (1.0, -0.5), (0.0, 0.5), (1.0, 0.5))
        first, second, third, loaded = (int(np.argmin(np.hypot(x - a, y - b))) for a, b in corners)
        supports = [ms.Pin([first]), ms.Fix([second], axes="yz"), ms.Fix([third], axes="z")]
        shape = x * (y + 0.5) / (2.0 * (1.0 - SHEET["poisson"]))
    shell = flat_shell(energy, mesh, SHEET, supports=supports)
    load = np.zeros((len(x), 3))
    force = SMALL * rigidity / shape.max()
    if problem == "supported":
        load[:, 2] = force * shell.mass / shell.mass.sum()
    else:
        load[loaded, 2] = force
    return shell, load, SMALL / shape.max() * shape


def navier(x: np.ndarray, y: np.ndarray, terms: int = 61) -> np.ndarray:
    """Deflection of the supported unit square with D = 1 under a total load of 1, at coordinates in [0, 1]."""
    waves = np.arange(1, terms, 2)
    m, n = waves[:, None], waves[None, :]
    weights = 16.0 / (np.pi**6 * m * n * (m**2 + n**2) ** 2)
    along, across = (np.sin(np.pi * np.outer(coordinates, waves)) for coordinates in (x, y))
    return np.asarray(np.einsum("im,mn,in->i", along, weights, across))


def orders(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Order of convergence of the supported plate on each mesh: the slope of its error over the size of cells."""
    found = {}
    for name in MESHES:
        own = [r for r in rows if (r["mesh"], r["energy"], r["problem"]) == (name, "Isotropic", "supported")]
        sizes, errors = ([np.log(float(row[key])) for row in own] for key in ("cells", "error"))
        found[name] = float(-np.polyfit(sizes, errors, 1)[0])
    return found


def table(result: StudyResult) -> str:
    """Errors by mesh, size, problem and energy, and orders, as a Markdown table."""
    heads = [f"{problem}, {energy}" for problem in PROBLEMS for energy in ENERGIES]
    lines = ["Errors of the deflection [%], and the order of convergence of the supported plate, Isotropic:", ""]
    lines += ["| mesh | cells | vertices | " + " | ".join(heads) + " | order |", "|---" * 8 + "|"]
    rows = result.findings["rows"]
    for name, cells in dict.fromkeys((row["mesh"], row["cells"]) for row in rows):
        own = {(r["problem"], r["energy"]): r for r in rows if (r["mesh"], r["cells"]) == (name, cells)}
        errors = " | ".join(f"{100.0 * own[p, e]['error']:.3g}" for p in PROBLEMS for e in ENERGIES)
        vertices = own[PROBLEMS[0], ENERGIES[0]]["vertices"]
        lines.append(f"| {name} | {cells} | {vertices} | {errors} | {result.findings['orders'][name]:.2f} |")
    return "\n".join(lines)


def finding(tables: list[Table]) -> str:
    """Largest errors of both energies on the finest meshes, and the orders of convergence."""
    (rows,) = tables
    finest = max(number(row["cells"]) for row in rows)
    fine = [row for row in rows if number(row["cells"]) == finest]

    def largest(head: str) -> float:
        return max(abs(number(row[head])) for row in fine)

    slopes = [number(row["order"]) for row in fine]
    return (
        f"With {finest:g} cells a side the deflection of a supported plate is at most "
        f"{largest('supported, Isotropic'):.2g} % off with Isotropic shells on {len(fine)} kinds of mesh, random ones "
        f"among them, and converges with order {min(slopes):.1f} to {max(slopes):.1f}; pure twist is exact to "
        f"{largest('twisted, Isotropic'):.1g} %. Calibrated hinges are off by up to "
        f"{largest('supported, hinges'):.2g} and {largest('twisted, hinges'):.2g} %, refined or not."
    )
