"""What the mesh does to a plate: five families, jittered and random ones, refined, with both bending energies.

Two problems with known answers, Poisson's ratio 0.3. A simply supported square plate under uniform load, against
Navier's series. A free plate held at three corners and loaded at the fourth: pure twist, whose
deflection P x y / (2 D (1 - nu)) an energy of shell theory has exactly on every mesh, as all its moments are constant.
Errors are those of the whole deflection, in the mass norm.

The order of convergence is fitted by least squares over all sizes and, on random meshes, several seeds. The error of
the supported plate depends on how many triangles have all three vertices on the edge, which happens at corners; their
number varies from one random mesh to the next, and with it the error, even in sign. Where it varies the fit is of
``e = (a + b c) / n^p``, with n cells a side and c such triangles, to the part of the error along the exact deflection,
which has a sign; elsewhere of ``e = a / n^p`` to the whole error.

Run it alone with ``modalshell reproduce --only mesh_bias``.
"""

from __future__ import annotations

import warnings
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import OptimizeWarning, curve_fit
from scipy.spatial import Delaunay
from scipy.stats import t

import modalshell as ms
from modalshell.mesh.lloyd import delaunay_faces, relax_in_rectangle
from modalshell.provenance import run_record
from modalshell.study import StudyResult, Table
from modalshell.supports import Support
from modalshell.typing import Progress
from studies.both_energies import ENERGIES, Sheet, flat_shell
from studies.pages import number
from studies.progress import counted

FIGURES = ("mesh_bias",)

SHEET: Sheet = {"young": 1e9, "poisson": 0.3, "thickness": 1e-2, "density": 1000.0}
FAMILIES = ("union-jack", "right", "equilateral", "lloyd", "delaunay")
MESHES = (*FAMILIES, "jittered", "random")
SEEDS = dict.fromkeys(("delaunay", "jittered", "random"), 8)
"""Meshes of each size of the random kinds; the others have one. All are refined, the first is in every other row."""
PROBLEMS = ("supported", "twisted")
JITTER = 0.2
"""Share of a cell by which inner vertices of the jittered mesh are moved at most along each axis."""
SMALL = 1e-5
"""Deflection that the loads are for [lengths]: linear theory holds."""


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """All meshes, sizes, energies and problems; ``quick`` leaves out the finest meshes."""
    sizes = (6, 12) if quick else (8, 12, 16, 24, 32)
    rows: list[dict[str, Any]] = []
    refined: dict[str, list[Refined]] = {}
    cases = [(name, cells) for name in MESHES for cells in sizes]
    for name, cells in counted(cases, on_step):
        mesh = square(name, cells)
        for energy in ENERGIES:
            for problem in PROBLEMS:
                error = deviation(energy, mesh, problem)
                found = {"mesh": name, "cells": cells, "vertices": len(mesh.vertices), "energy": energy}
                rows.append({**found, "problem": problem, "error": error})
        seeds = 1 if quick else SEEDS.get(name, 1)
        refined.setdefault(name, []).extend(refinement(name, cells, seed) for seed in range(seeds))
    orders = {name: dict(zip(("order", "interval"), order(found), strict=True)) for name, found in refined.items()}
    findings = {"rows": rows, "refined": {name: np.array(found) for name, found in refined.items()}, "orders": orders}
    parameters = {**SHEET, "sizes": sizes, "meshes": MESHES, "jitter": JITTER, "seeds": SEEDS}
    return StudyResult("mesh_bias", findings, {}, run_record(parameters))


def square(name: str, cells: int, seed: int = 0) -> ms.TriangleMesh:
    """A unit square of about ``cells`` cells a side."""
    if name in FAMILIES and not seed:
        columns = round(cells * 2.0 / np.sqrt(3.0)) if name == "equilateral" else cells
        return ms.sheet(length=1.0, width=1.0, cells=(columns, cells), family=name)
    random = np.random.default_rng(cells + 1000 * seed)
    regular = ms.sheet(length=1.0, width=1.0, cells=(cells, cells))
    vertices = np.array(regular.vertices)
    inner = np.ones(len(vertices), dtype=bool)
    inner[regular.boundary_vertices] = False
    if name == "delaunay":  # as the package's family, from other points
        lattice = ms.sheet(length=1.0, width=1.0, cells=(cells, cells), family="equilateral")
        first = random.uniform(size=(len(lattice.vertices) - len(lattice.boundary_vertices), 2))
        rim = vertices[~inner, :2] + (0.0, 0.5)
        relaxed = np.vstack([rim, relax_in_rectangle(first, rim, 1.0, 1.0)])
        faces = delaunay_faces(relaxed, sliver=1e-9 / cells**2)
        return ms.TriangleMesh(np.column_stack([relaxed - (0.0, 0.5), np.zeros(len(relaxed))]), faces)
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


class Refined(NamedTuple):
    """Cells a side, triangles with all vertices on the edge, the relative error, and its part along the answer."""

    cells: int
    corners: int
    error: float
    along: float


def refinement(name: str, cells: int, seed: int) -> Refined:
    """The supported plate of shell theory on one mesh."""
    mesh = square(name, cells, seed)
    shell, load, exact = loaded("Isotropic", mesh, "supported")
    positions = ms.DiscreteShell(shell).equilibrium(force=load).positions
    along = shell.mass @ ((positions[:, 2] - exact) * exact) / (shell.mass @ exact**2)
    corners = int(np.isin(mesh.faces, mesh.boundary_vertices).all(axis=1).sum())
    return Refined(cells, corners, difference(shell, positions, exact), float(along))


def order(refined: list[Refined]) -> tuple[float, float | None]:
    """Order of convergence p and half the width of its interval of 95 %; None from as few meshes as unknowns."""
    cells, corners, errors, along = np.array(refined).T
    columns = [np.ones_like(cells)]
    if np.ptp(corners) and len(cells) > 2:
        columns.append(corners)
        errors = along

    def scaled(n: np.ndarray, p: float, *factors: float) -> np.ndarray:
        return np.asarray(n ** (2.0 - p) * (np.array(factors) @ columns))

    start = [2.0, float(np.mean(errors * cells**2)), 0.0][: 1 + len(columns)]
    free = len(cells) - len(start)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", OptimizeWarning)  # no covariance where nothing is left free
        found, covariance = curve_fit(scaled, cells, errors * cells**2, p0=start)
    return float(found[0]), float(t.ppf(0.975, free) * np.sqrt(covariance[0, 0])) if free else None


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


def table(result: StudyResult) -> str:
    """Errors by mesh, size, problem and energy, and orders, as Markdown tables."""
    heads = [f"{problem}, {energy}" for problem in PROBLEMS for energy in ENERGIES]
    lines = ["Errors of the deflection [%]:", ""]
    lines += ["| mesh | cells | vertices | " + " | ".join(heads) + " |", "|---" * 7 + "|"]
    rows = result.findings["rows"]
    for name, cells in dict.fromkeys((row["mesh"], row["cells"]) for row in rows):
        own = {(r["problem"], r["energy"]): r for r in rows if (r["mesh"], r["cells"]) == (name, cells)}
        errors = " | ".join(f"{100.0 * own[p, e]['error']:.3g}" for p in PROBLEMS for e in ENERGIES)
        lines.append(f"| {name} | {cells} | {own[PROBLEMS[0], ENERGIES[0]]['vertices']} | {errors} |")
    lines += ["", "Order of convergence of the supported plate, Isotropic, with its interval of 95 %:", ""]
    lines += ["| mesh | meshes fitted | order | interval |", "|---|---|---|---|"]
    for name, slope in result.findings["orders"].items():
        interval = "-" if slope["interval"] is None else f"+-{slope['interval']:.2f}"
        lines.append(f"| {name} | {len(result.findings['refined'][name])} | {slope['order']:.2f} | {interval} |")
    return "\n".join(lines)


def finding(tables: list[Table]) -> str:
    """Largest errors of both energies on the finest meshes, and the orders of convergence."""
    rows, orders = tables
    finest = max(number(row["cells"]) for row in rows)
    fine = [row for row in rows if number(row["cells"]) == finest]

    def largest(head: str) -> float:
        return max(abs(number(row[head])) for row in fine)

    slopes = [number(row["order"]) for row in orders]
    return (
        f"With {finest:g} cells a side the deflection of a supported plate is at most "
        f"{largest('supported, Isotropic'):.2g} % off with Isotropic shells on {len(fine)} kinds of mesh, random ones "
        f"among them, and converges with order {min(slopes):.2f} to {max(slopes):.2f}; pure twist is exact to "
        f"{largest('twisted, Isotropic'):.1g} %. Calibrated hinges are off by up to "
        f"{largest('supported, hinges'):.2g} and {largest('twisted, hinges'):.2g} %, refined or not."
    )
