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
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import modalshell as ms
from modalshell.core.typing import Progress
from modalshell.files.study_result import StudyResult
from modalshell.supports import Support
from studies.pages import at_most, markdown, paragraphs, result_of
from studies.shell_theory import FAMILIES, crossed, near, quarter_cylinder, rows_of, spread, square

FIGURES = ("large_deflection_benchmarks",)

X, Y, Z = np.eye(3)
GRADING = 1.3
"""Power that draws the cells of a pinched cylinder together where it is pinched."""
QUICK = ("3.1", "3.2", "3.3", "3.4", "3.5")


class Steep(NamedTuple):
    """Where a wall buckles: tabulated shares of the load, the displacement that changes most, and shares around."""

    shares: tuple[float, ...]
    column: int
    path: tuple[float, float]


STEEP = {"3.5": Steep((0.525,), 1, (0.45, 0.57)), "3.6": Steep((0.15, 0.175), 0, (0.12, 0.18))}


class Problem(NamedTuple):
    """A shell, its whole load, forces (n, 3) [N] and others, and the watched vertices, each with a direction."""

    shell: ms.Shell
    force: np.ndarray
    watched: list[tuple[int, np.ndarray]]
    moment: tuple[np.ndarray, float] | None = None


def strip(family: str, cells: tuple[int, int], length: float) -> tuple[ms.Shell, np.ndarray, int]:
    """A cantilever of width 1 and thickness 0.1; which vertices are its end, and the one in their middle."""
    plain = square(family, cells)
    mesh = ms.TriangleMesh(plain.vertices * (length, 1.0, 1.0), plain.faces)
    x = mesh.vertices[:, 0]
    shell = ms.Shell(mesh, ms.Isotropic(1.2e6, 0.0, 0.1, 1.0), clamped=x < 1e-9)
    return shell, np.isclose(x, length), near(mesh, (length, 0.5, 0.0))


def eighth_of_cylinder(u: np.ndarray, v: np.ndarray, diaphragm: bool) -> list[Support]:
    """Planes of symmetry of an eighth of a cylinder, and a rigid diaphragm at its end."""
    planes: list[Support] = [
        ms.Symmetry(np.isclose(u, 0.0), (0.0, 1.0, 0.0)),
        ms.Symmetry(np.isclose(v, 0.0), (0.0, 0.0, 1.0)),
        ms.Symmetry(np.isclose(v, 1.0), (1.0, 0.0, 0.0)),
    ]
    return [*planes, ms.Diaphragm(np.isclose(u, 1.0), axis=(0.0, 1.0, 0.0))] if diaphragm else planes


def cantilever(family: str, cells: tuple[int, int]) -> Problem:
    """3.1: length 10, width 1, thickness 0.1; the shear at its end is 4."""
    shell, end, tip = strip(family, cells, 10.0)
    return Problem(shell, spread(shell.mesh, end, 4.0 * Z), [(tip, -X), (tip, Z)])


def ring(family: str, cells: tuple[int, int]) -> Problem:
    """3.2: length 12, width 1, thickness 0.1; the moment at its end is 50 pi / 3, which bends it to a full ring."""
    shell, end, tip = strip(family, cells, 12.0)
    return Problem(shell, np.zeros_like(shell.rest_positions), [(tip, -X), (tip, Z)], (end, 50.0 * np.pi / 3.0))


def annulus(family: str, cells: tuple[int, int]) -> Problem:
    """3.3: radii 6 and 10, thickness 0.03; one side of the slit is clamped, the other lifted by 0.8 a length."""
    plain = square(family, cells)
    u, v, _ = plain.vertices.T
    radius, angle = 6.0 * (10.0 / 6.0) ** v, 2.0 * np.pi * u
    points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), 0.0 * u])
    with warnings.catch_warnings(action="ignore", category=ms.ModalShellWarning):  # the slit is meant
        mesh = ms.TriangleMesh(points, plain.faces[:, ::-1])
    shell = ms.Shell(mesh, ms.Isotropic(21e6, 0.0, 0.03, 1.0), clamped=u < 1e-9)
    end = np.isclose(u, 1.0)
    inner, outer = (int(np.flatnonzero(end)[pick(radius[end])]) for pick in (np.argmin, np.argmax))
    return Problem(shell, spread(mesh, end, 3.2 * Z), [(inner, Z), (outer, Z)])


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
    return Problem(shell, force, [(pulled, Y), (pushed, -X)])


def cylinder(family: str, cells: tuple[int, int]) -> Problem:
    """3.5: an eighth of radius 4.953, length 10.35 and thickness 0.094; 40,000 pull at its middle."""
    mesh, u, v = quarter_cylinder(family, cells, 4.953, 5.175)
    supports = eighth_of_cylinder(u, v, diaphragm=False)
    shell = ms.Shell(mesh, ms.Isotropic(10.5e6, 0.3125, 0.094, 1.0), supports=supports)
    pulled = near(mesh, (0.0, 0.0, 4.953))
    force = np.zeros_like(mesh.vertices)
    force[pulled] = 10000.0 * Z
    beside, end = near(mesh, (4.953, 0.0, 0.0)), near(mesh, (4.953, 5.175, 0.0))
    return Problem(shell, force, [(pulled, Z), (beside, -X), (end, -X)])


def pinched_cylinder(family: str, cells: tuple[int, int]) -> Problem:
    """3.6: an eighth of radius 100, length 200 and thickness 1 between rigid diaphragms; 12,000 push at its middle.

    Cells are smaller towards the force: equal ones leave its dent twice as far off.
    """
    mesh, u, v = quarter_cylinder(family, cells, 100.0, 100.0, GRADING)
    supports = eighth_of_cylinder(u, v, diaphragm=True)
    shell = ms.Shell(mesh, ms.Isotropic(30e3, 0.3, 1.0, 1.0), supports=supports)
    pushed, beside = near(mesh, (0.0, 0.0, 100.0)), near(mesh, (100.0, 0.0, 0.0))
    force = np.zeros_like(mesh.vertices)
    force[pushed] = -3000.0 * Z
    return Problem(shell, force, [(pushed, -Z), (beside, X)])


def semi_cylinder(family: str, cells: tuple[int, int]) -> Problem:
    """3.7: a half of radius 1.016, length 3.048 and thickness 0.03, clamped at one end; 2,000 push at the other.

    Its straight edges keep their height and do not turn: they lie in a plane of symmetry.
    """
    mesh, u, v = quarter_cylinder(family, cells, 1.016, 3.048)
    supports: list[Support] = [
        ms.Clamp(np.isclose(u, 0.0)),
        ms.Symmetry(np.isclose(v, 0.0), (0.0, 0.0, 1.0)),
        ms.Symmetry(np.isclose(v, 1.0), (1.0, 0.0, 0.0)),
    ]
    shell = ms.Shell(mesh, ms.Isotropic(20.685e6, 0.3, 0.03, 1.0), supports=supports)
    pushed = near(mesh, (0.0, 3.048, 1.016))
    force = np.zeros_like(mesh.vertices)
    force[pushed] = -1000.0 * Z
    return Problem(shell, force, [(pushed, -100.0 * Z)])  # the table's unit is a hundredth


class Benchmark(NamedTuple):
    """A problem: how it is built of a mesh family and the cells of a unit square, and how many along and across."""

    name: str
    build: Callable[[str, tuple[int, int]], Problem]
    cells: tuple[int, int]


PROBLEMS = {
    "3.1": Benchmark("cantilever, end shear", cantilever, (40, 4)),
    "3.2": Benchmark("cantilever, end moment", ring, (60, 5)),
    "3.3": Benchmark("slit annulus", annulus, (98, 8)),
    "3.4": Benchmark("hemisphere", hemisphere, (28, 24)),
    "3.5": Benchmark("open cylinder", cylinder, (24, 36)),
    "3.6": Benchmark("pinched cylinder", pinched_cylinder, (42, 66)),
    "3.7": Benchmark("pinched semi-cylinder", semi_cylinder, (48, 48)),
}
"""The problems by their sections."""


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """All problems, mesh families and tabulated loads; ``quick`` takes one family, coarse meshes and few loads."""
    tables = json.loads(Path(__file__).with_name("sze_liu_lo.json").read_text(encoding="utf-8"))["problems"]
    steep: list[dict[str, Any]] = []

    def answers(problem: str, mesh: str) -> list[dict[str, Any]]:
        along, across = PROBLEMS[problem].cells
        built = PROBLEMS[problem].build(mesh, (along // 2, across // 2) if quick else (along, across))
        entries = tables[problem]["rows"][4::5] if quick else tables[problem]["rows"]
        found = solve(built, entries)
        if problem in STEEP and not quick:
            at_snap = at_displacements(built, entries, STEEP[problem])
            steep.extend({"problem": problem, "mesh": mesh, **row} for row in at_snap)
        return found

    cases = crossed(problem=QUICK if quick else PROBLEMS, mesh=FAMILIES[:1] if quick else FAMILIES)
    rows = rows_of(answers, cases, on_step)
    names = {key: problem.name for key, problem in PROBLEMS.items()}
    return result_of("large_deflection_benchmarks", {"names": names, "rows": rows, "steep": steep}, quick=quick)


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
            named = {"name": f"{problem} {PROBLEMS[problem].name}{words}", "wrong": wrong}
            worst.append(max(own, key=lambda row: row["error"]) | named)
    for row in found["steep"]:
        name = f"{row['problem']} {PROBLEMS[row['problem']].name}, its snap: load at the displacement"
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
    words = (
        "Displacements are in the units of the publication. An error is the largest difference at a load over the "
        "largest displacement of that path: at small loads the share of the displacement there may be larger."
    )
    return paragraphs(words, largest, every)


def finding(result: StudyResult) -> str:
    """The largest error of each problem over all meshes."""
    largest: dict[str, float] = {}
    for row in largest_errors(result.findings):
        largest[row["name"]] = max(largest.get(row["name"], 0.0), row["error"] or 0.0)
    snaps = {name: value for name, value in largest.items() if "its snap: load" in name}
    beyond = {name: value for name, value in largest.items() if name.endswith(", beyond")}
    before = {name: value for name, value in largest.items() if name not in snaps and name not in beyond}
    worst, size = max(before.items(), key=lambda pair: pair[1])
    told = (
        f"On the benchmarks of Sze, Liu and Lo, three mesh families each, Isotropic shells are within "
        f"{at_most(100 * size)} % at all loads up to a snap (largest: {worst.removesuffix(', up to its snap')})"
    )
    if beyond:
        told += f", and within {at_most(100 * max(beyond.values()))} % beyond it"
    return told + (f"; loads of snaps are met within {at_most(100 * max(snaps.values()))} %." if snaps else ".")
