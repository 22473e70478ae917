"""The obstacle course of MacNeal and Harder (1985) and other linear benchmarks, with shells of shell theory.

Patch tests, the Scordelis-Lo roof, the pinched cylinder, the hemisphere with a hole and the twisted beam (the thin one
of Belytschko, Wong and Stolarski 1989); square plates, supported and clamped, under a uniform load, and the lowest
frequency of the clamped one; and the pressure at which a sphere buckles (Zoelly 1915). Loads are so small that the
answers are linear. Each problem is solved on meshes of three families; the sphere's are those of a cube with union-jack
faces, of an octahedron, and of random points relaxed.

In a patch test all vertices are put where a field of constant strain or moment has them. In plane the forces on inner
vertices must then vanish; the largest is compared with the largest one at the boundary. Moments are compared inside,
more than four edges from the free boundary, where they must vanish instead.

Moments that are constant in each triangle leave plates too soft by a constant times the square of the cell, on clamped
plates of 24 x 24 cells by 3.7, 2.4 and 3.2 % (union-jack, equilateral and random ones). Pairs of triangles take most of
it away (:mod:`modalshell.shell.triangle_pairs`): the table has 0.4 to 0.7 %.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import ConvexHull

import modalshell as ms
from modalshell.core.typing import Progress
from modalshell.files.provenance import run_record
from modalshell.files.study_result import StudyResult
from modalshell.supports import Support
from studies.both_energies import FAMILIES
from studies.mapped_sheets import near, quarter_cylinder, spread, square
from studies.pages import markdown
from studies.progress import counted
from studies.sze_liu_lo import GRADING, hemisphere

FIGURES = ("obstacle_course",)

X, Y, Z = np.eye(3)
SMALL = 1e-6
"""Displacement that loads are scaled to, in sizes of the shell."""
DEEP = 4
"""Edges from the boundary beyond which the moments of a patch are compared."""


class Answer(NamedTuple):
    """What was found on a mesh, the reference, and the error: relative, but if the reference is zero."""

    vertices: int
    found: float
    reference: float
    error: float


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """All problems and mesh families at two resolutions; ``quick`` takes the coarser one of one family."""
    families = FAMILIES[:1] if quick else FAMILIES
    cases = [
        (name, family, cells)
        for name, problem in PROBLEMS.items()
        for family in families
        for cells in (problem.cells[:1] if quick else problem.cells)
    ]
    rows: list[dict[str, Any]] = []
    for name, family, cells in counted(cases, on_step):
        problem = PROBLEMS[name]
        mesh_cells = f"{cells[0]} x {cells[1]}"
        answer = problem.solve(family, cells)
        rows.append({"problem": name, "mesh": family, "cells": mesh_cells, "bound": problem.bound, **answer._asdict()})
    return StudyResult("obstacle_course", {"rows": rows}, {}, run_record({"families": families}))


def linear(shell: ms.Shell, load: np.ndarray) -> np.ndarray:
    """Displacements (n, 3) under a load (n, 3), by linear theory."""
    model, rest = ms.DiscreteShell(shell), shell.rest_positions
    factor = 1.0
    for _ in range(8):
        moved = model.equilibrium(force=factor * load).positions - rest
        reach = float(np.abs(moved).max()) / shell.size
        if 0.1 * SMALL < reach < 10.0 * SMALL:
            break
        factor *= SMALL / reach
    return np.asarray(moved / factor)


def compared(mesh: ms.TriangleMesh, found: float, reference: float) -> Answer:
    """The answer of a problem with a reference that is not zero."""
    return Answer(len(mesh.vertices), found, reference, found / reference - 1.0)


def patch(family: str, cells: tuple[int, int]) -> ms.TriangleMesh:
    """The sheet of the patch tests, 0.24 by 0.12."""
    plain = square(family, cells)
    return ms.TriangleMesh(plain.vertices * (0.24, 0.12, 0.0), plain.faces)


def membrane_patch(family: str, cells: tuple[int, int]) -> Answer:
    """Largest force on an inner vertex over that on a boundary one, in a field of constant strain."""
    mesh = patch(family, cells)
    shell = ms.Shell(mesh, ms.Isotropic(1e6, 0.25, 1e-3, 1.0))
    strained = mesh.vertices @ (np.eye(3) + 1e-3 * np.array([[1.0, 0.5, 0.0], [0.5, 1.0, 0.0], [0.0, 0.0, 0.0]]))
    forces = np.linalg.norm(shell.force(strained), axis=1)
    inner = np.ones(len(forces), dtype=bool)
    inner[mesh.boundary_vertices] = False
    found = float(forces[inner].max() / forces.max())
    return Answer(len(forces), found, 0.0, found)


def bending_patch(family: str, cells: tuple[int, int]) -> Answer:
    """Largest error of the moments inside, over the largest exact one, in a field of constant curvature."""
    mesh = patch(family, cells)
    young, poisson, thickness = 1e6, 0.25, 1e-3
    shell = ms.Shell(mesh, ms.Isotropic(young, poisson, thickness, 1.0))
    x, y, _ = mesh.vertices.T
    bent = np.array(mesh.vertices)
    bent[:, 2] = 1e-6 * 0.5 * (x**2 + x * y + y**2)
    moments = shell.fields(bent).moment
    rigidity = young * thickness**3 / (12.0 * (1.0 - poisson**2))
    # Curvatures are positive where the normals, here upwards, spread: minus second derivatives of the deflection.
    exact = (
        -1e-6 * rigidity * np.array([[1.0 + poisson, 0.5 * (1.0 - poisson)], [0.5 * (1.0 - poisson), 1.0 + poisson]])
    )
    tangent = mesh.vertices[mesh.faces[:, 1]] - mesh.vertices[mesh.faces[:, 0]]
    tangent = tangent[:, :2] / np.linalg.norm(tangent, axis=1)[:, None]
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    wanted = np.stack(
        [np.einsum("ti,ij,tj->t", a, exact, b) for a, b in ((tangent, tangent), (normal, normal), (tangent, normal))],
        axis=1,
    )
    deep = (edges_inside(mesh) > DEEP)[mesh.faces].all(axis=1)
    found = float(np.abs(moments - wanted)[deep].max() / np.abs(exact).max())
    return Answer(len(x), found, 0.0, found)


def edges_inside(mesh: ms.TriangleMesh) -> np.ndarray:
    """Number of edges (n,) from the boundary to each vertex."""
    depth = np.full(len(mesh.vertices), len(mesh.vertices))
    depth[mesh.boundary_vertices] = 0
    while True:
        nearer = depth.copy()
        for one, other in (mesh.edges.T, mesh.edges.T[::-1]):
            np.minimum.at(nearer, one, depth[other] + 1)
        if np.array_equal(nearer, depth):
            return depth
        depth = nearer


def roof(family: str, cells: tuple[int, int]) -> Answer:
    """Scordelis-Lo roof, a quarter: how far the middle of its free edge sinks under 90 on each unit of area."""
    plain = square(family, cells)
    u, v, _ = plain.vertices.T
    angle = np.radians(40.0) * v
    points = np.column_stack([25.0 * np.sin(angle), 25.0 * u, 25.0 * np.cos(angle)])
    mesh = ms.TriangleMesh(points, plain.faces)
    supports: list[Support] = [
        ms.Symmetry(np.isclose(u, 0.0), (0.0, 1.0, 0.0)),
        ms.Symmetry(np.isclose(v, 0.0), (1.0, 0.0, 0.0)),
        ms.Diaphragm(np.isclose(u, 1.0), axis=(0.0, 1.0, 0.0)),
    ]
    shell = ms.Shell(mesh, ms.Isotropic(4.32e8, 0.0, 0.25, 1.0), supports=supports)
    moved = linear(shell, shell.gravity_force((0.0, 0.0, -90.0 / 0.25)))
    corner = int(np.flatnonzero(np.isclose(u, 0.0) & np.isclose(v, 1.0))[0])
    return compared(mesh, -float(moved[corner, 2]), 0.3024)


def pinched(family: str, cells: tuple[int, int], grading: float) -> Answer:
    """Cylinder pinched between rigid diaphragms, an eighth: how far the point under the force 1 moves."""
    mesh, u, v = quarter_cylinder(family, cells, 300.0, 300.0, grading)
    supports: list[Support] = [
        ms.Symmetry(np.isclose(u, 0.0), (0.0, 1.0, 0.0)),
        ms.Symmetry(np.isclose(v, 0.0), (0.0, 0.0, 1.0)),
        ms.Symmetry(np.isclose(v, 1.0), (1.0, 0.0, 0.0)),
        ms.Diaphragm(np.isclose(u, 1.0), axis=(0.0, 1.0, 0.0)),
    ]
    shell = ms.Shell(mesh, ms.Isotropic(3e6, 0.3, 3.0, 1.0), supports=supports)
    top = near(mesh, (0.0, 0.0, 300.0))
    force = np.zeros_like(mesh.vertices)
    force[top] = -0.25 * Z
    return compared(mesh, -float(linear(shell, force)[top, 2]), 1.8248e-5)


def pulled_hemisphere(family: str, cells: tuple[int, int]) -> Answer:
    """Hemisphere with a hole of 18 degrees, a quarter: how far the point under a force of 2 moves."""
    problem = hemisphere(family, cells)
    moved = linear(problem.shell, 0.005 * problem.force)
    found = np.mean([moved[vertex] @ direction for vertex, direction in problem.watched])
    return compared(problem.shell.mesh, float(found), 0.0940)


def twisted(family: str, cells: tuple[int, int], direction: np.ndarray, reference: float) -> Answer:
    """A strip of length 12 and width 1.1 that turns by 90 degrees, 0.0032 thick: its tip under a force of 1e-6."""
    plain = square(family, cells)
    u, v, _ = plain.vertices.T
    across, angle = 1.1 * (v - 0.5), 0.5 * np.pi * u
    mesh = ms.TriangleMesh(np.column_stack([12.0 * u, across * np.cos(angle), across * np.sin(angle)]), plain.faces)
    shell = ms.Shell(mesh, ms.Isotropic(29e6, 0.22, 0.0032, 1.0), clamped=np.isclose(u, 0.0))
    moved = linear(shell, spread(mesh, np.isclose(u, 1.0), 1e-6 * direction))
    return compared(mesh, float(moved[near(mesh, (12.0, 0.0, 0.0))] @ direction), reference)


def plate(family: str, cells: tuple[int, int]) -> ms.TriangleMesh:
    """A unit square about the origin."""
    columns = round(cells[0] * 2.0 / np.sqrt(3.0)) if family == "equilateral" else cells[0]
    mesh = ms.sheet(length=1.0, width=1.0, cells=(columns, cells[1]), family=family)
    return ms.TriangleMesh(mesh.vertices - (0.5, 0.0, 0.0), mesh.faces)


def loaded_plate(family: str, cells: tuple[int, int], clamped: bool, reference: float) -> Answer:
    """Deflection ``w D / (q a^4)`` of a square plate's middle under a uniform load."""
    mesh = plate(family, cells)
    rim = mesh.boundary_vertices
    held: list[Support] = [ms.Clamp(rim) if clamped else ms.Pin(rim)]
    shell = ms.Shell(mesh, ms.Isotropic(1e9, 0.3, 1e-3, 1.0), supports=held)
    deflection = linear(shell, shell.gravity_force((0.0, 0.0, 1.0 / 1e-3)))[:, 2]
    rigidity = 1e9 * 1e-9 / (12.0 * (1.0 - 0.3**2))
    # A square fit to the nearest vertices: there may be none in the middle.
    x, y, _ = mesh.vertices[nearest := np.argsort(np.hypot(*mesh.vertices[:, :2].T))[:13]].T
    terms = np.column_stack([np.ones(13), x, y, x * x, x * y, y * y])
    middle = np.linalg.lstsq(terms, deflection[nearest], rcond=None)[0][0]
    return compared(mesh, float(rigidity * middle), reference)


def clamped_frequency(family: str, cells: tuple[int, int]) -> Answer:
    """Lowest frequency number ``omega a^2 sqrt(rho h / D)`` of the clamped square plate."""
    mesh = plate(family, cells)
    basis = ms.solve_modes(ms.Shell(mesh, ms.Isotropic(1e9, 0.3, 1e-3, 1000.0), clamped=mesh.boundary_vertices), 1)
    unit = np.sqrt(1e9 * 1e-6 / (12.0 * (1.0 - 0.3**2) * 1000.0))
    return compared(mesh, float(np.sqrt(basis.eigenvalues[0]) / unit), 35.985)


def octant(family: str, cells: int) -> ms.TriangleMesh:
    """An eighth of the unit sphere: of a cube with union-jack faces, of an octahedron, or of random points relaxed."""
    if family == "union-jack":
        plain = square("union-jack", (cells, cells))
        # Equal angles from the corner of a face of the cube that is nearest to an axis.
        a, b = np.tan(0.25 * np.pi * plain.vertices[:, :2].T)
        corner = np.column_stack([np.ones_like(a), a, b])
        corners = np.concatenate([np.roll(corner, turn, axis=1) for turn in range(3)])
        _, first, same = np.unique(np.round(corners, 9), axis=0, return_index=True, return_inverse=True)
        vertices = corners[first]
        triangles = same.ravel()[np.concatenate([plain.faces + turn * len(a) for turn in range(3)])]
    else:
        cells *= 2  # an edge of an octahedron takes in two of the cube's
        steps = np.array([(i, j, cells - i - j) for i in range(cells + 1) for j in range(cells + 1 - i)])
        # Equal angles along the edges, and nearly equal triangles.
        vertices = np.sin(0.5 * np.pi * steps / cells)
        rim = (steps == 0).any(axis=1)
        vertices[rim] = np.where(steps[rim] == 0, 0.0, vertices[rim])
        if family == "delaunay":
            random = np.random.default_rng(0)
            vertices[~rim] = np.abs(random.standard_normal((np.count_nonzero(~rim), 3)))
            for _ in range(40):
                vertices[~rim] = _relaxed(vertices)[~rim]
        triangles = _triangles(vertices)
    vertices = vertices / np.linalg.norm(vertices, axis=1)[:, None]
    x = vertices[triangles]
    inwards = np.einsum("ti,ti->t", np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), x.sum(axis=1)) < 0.0
    triangles[inwards] = triangles[inwards][:, ::-1]
    return ms.TriangleMesh(vertices, triangles)


def _triangles(vertices: np.ndarray) -> np.ndarray:
    """Delaunay's triangles of points on an eighth of a sphere."""
    vertices = vertices / np.linalg.norm(vertices, axis=1)[:, None]
    corners = ConvexHull(np.vstack([vertices, np.zeros(3)])).simplices
    outer = (corners < len(vertices)).all(axis=1) & ~(np.abs(vertices[corners % len(vertices)]) < 1e-12).all(
        axis=1
    ).any(axis=1)
    return np.asarray(corners[outer])


def _relaxed(vertices: np.ndarray) -> np.ndarray:
    """Every vertex in the middle of its triangles, by area (a Lloyd pass)."""
    vertices = vertices / np.linalg.norm(vertices, axis=1)[:, None]
    corners = _triangles(vertices)
    x = vertices[corners]
    areas = np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)
    sums = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(sums, corners[:, k], areas[:, None] * x.mean(axis=1))
    return sums


def buckled_sphere(family: str, cells: tuple[int, int]) -> Answer:
    """Critical pressure of a sphere, its radius 30 thicknesses, over ``2 E (h / R)^2``: linear buckling of an eighth.

    Planes of symmetry keep the sphere from turning, which supports at points would resist by a dent only.
    """
    mesh = octant(family, cells[0])
    thickness, poisson = 1.0 / 30.0, 0.3
    planes: list[Support] = [
        ms.Symmetry(np.abs(mesh.vertices[:, axis]) < 1e-9, tuple(np.eye(3)[axis])) for axis in range(3)
    ]
    shell = ms.Shell(mesh, ms.Isotropic(1.0, poisson, thickness, 1.0), supports=planes)
    factors = ms.buckling_factors(shell, 1, loads=[ms.Pressure(-2.0 * thickness**2)]).factors
    return compared(mesh, float(factors[0]), 1.0 / float(np.sqrt(3.0 * (1.0 - poisson**2))))


class Problem(NamedTuple):
    """How to solve a problem, on which cells, and the error that shell theory should keep below."""

    solve: Callable[[str, tuple[int, int]], Answer]
    cells: tuple[tuple[int, int], ...]
    bound: float


PROBLEMS = {
    "patch test, constant strain": Problem(membrane_patch, ((8, 4), (24, 12)), 1e-9),
    "patch test, constant moments": Problem(bending_patch, ((24, 12), (48, 24)), 0.02),
    "Scordelis-Lo roof": Problem(roof, ((17, 12), (34, 24)), 0.02),
    "pinched cylinder, equal cells": Problem(lambda f, c: pinched(f, c, 1.0), ((24, 24), (48, 48)), 0.03),
    "pinched cylinder, finer at the force": Problem(lambda f, c: pinched(f, c, GRADING), ((24, 24), (48, 48)), 0.03),
    "hemisphere with a hole": Problem(pulled_hemisphere, ((21, 18), (42, 36)), 0.02),
    "twisted beam, thin, in plane": Problem(lambda f, c: twisted(f, c, Z, 5.256e-3), ((66, 6), (132, 12)), 0.02),
    "twisted beam, thin, out of plane": Problem(lambda f, c: twisted(f, c, Y, 1.294e-3), ((66, 6), (132, 12)), 0.02),
    "plate, supported, 24 cells": Problem(
        lambda f, c: loaded_plate(f, c, False, 4.0624e-3), ((12, 12), (24, 24)), 0.01
    ),
    "plate, clamped, 24 cells": Problem(lambda f, c: loaded_plate(f, c, True, 1.2653e-3), ((12, 12), (24, 24)), 0.01),
    "plate, clamped, 48 cells": Problem(lambda f, c: loaded_plate(f, c, True, 1.2653e-3), ((24, 24), (48, 48)), 0.01),
    "plate, clamped, frequency": Problem(clamped_frequency, ((12, 12), (24, 24)), 0.02),
    "sphere under pressure": Problem(buckled_sphere, ((10, 10), (24, 24)), 0.05),
}


def table(result: StudyResult) -> str:
    """One row per problem, mesh and resolution, as a Markdown table."""
    return markdown(
        "problem | mesh | cells | vertices | found | reference | error [%] | aim [%]",
        "{problem} | {mesh} | {cells} | {vertices} | {found:.5g} | {reference:.5g} | {error:100*+.3g} | {bound:100*g}",
        result.findings["rows"],
    )


def finding(result: StudyResult) -> str:
    """The largest error of each problem on the finer meshes, and which aims are missed."""
    rows = result.findings["rows"]
    largest: dict[str, float] = {}
    for name in PROBLEMS:
        own = [row for row in rows if row["problem"] == name]
        finest = max(row["vertices"] for row in own)
        largest[name] = max(abs(row["error"]) for row in own if row["vertices"] > 0.6 * finest)
    told = "; ".join(f"{name} {100 * value:.2g} %" for name, value in largest.items() if not name.startswith("patch"))
    missed = [name for name, value in largest.items() if value > PROBLEMS[name].bound]
    words = f"aims are missed by: {', '.join(missed)}" if missed else "every aim is met"
    return f"Largest errors on three mesh families, finer meshes: {told}; {words}."
