"""Sheets that meet at edges of three and more triangles: frames, a box and a plate with a rib against beam theory.

Strips of length 1 and width 0.2 form a T and a cross, all ends but one clamped, under a force at that one: a plane
frame. A square tube with two webs, clamped at an end, is twisted by a uniform shear flow on its walls at the other: by
symmetry the webs carry none of it, and the tube has Bredt's torsion constant and does not warp. A plate of 1.6 x 0.2 m
with a rib of 0.1 m under its middle line sags under its weight as a cantilever of T section, with the shear of its rib.
Without the joint, the rib being cut off, the plate alone carries the weight of both.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import modalshell as ms
from modalshell.core.typing import Progress
from modalshell.files.study_result import StudyResult
from studies.frame_meshes import Place, cellular_box, frame, joined, strip
from studies.pages import at_most, markdown, result_of
from studies.shell_theory import crossed, rows_of

FIGURES = ("stiffened_panel",)
FRAMES: dict[str, tuple[list[Place], float]] = {
    "T": ([(-1.0, 0.0), (1.0, 0.0), (0.0, 1.0)], 1 / 3 + 1 / 8),
    "cross": ([(-1.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.0, 1.0)], 1 / 3 + 1 / 12),
}
"""Ends of the strips, the last one loaded, and its deflection over P L^3 / EI."""
MESHES = ("alternating", "one-way", "jittered")
CELLS = (4, 8, 16, 32)
SIDE, TUBE = 0.2, 1.0
"""Side and length of the tube [m]."""
WIDTH, HEIGHT, PANEL = 0.2, 0.1, 1.6
"""Width of the plate, height of its rib, and their length [m]."""
SHEET = {"young": 1e9, "poisson": 0.0, "thickness": 1e-3, "density": 1000.0}
STEEL = {"young": 2e11, "poisson": 0.0, "thickness": 2e-3, "density": 7800.0}
GRAVITY = 9.81
WORDS = (
    "Cells are those along each strip of a frame; a quarter of them are across half of a wall of the tube, and over "
    "the height of the rib. What was found is over what theory says: the deflection of the frame's loaded end, the "
    "twist of the tube, and the sag of the rib's end.\n\n"
)


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """All shapes, meshes and numbers of cells; ``quick`` takes one mesh and the coarser two."""
    meshes, cells = (MESHES[2:], CELLS[:2]) if quick else (MESHES, CELLS)
    shapes = [*FRAMES, "tube with webs", "plate with a rib"]
    rows = rows_of(_answer, crossed(shape=shapes, mesh=meshes, cells=cells), on_step)
    return result_of("stiffened_panel", {"rows": rows, "cut": cut_off()}, quick=quick)


def _answer(shape: str, mesh: str, cells: int) -> dict[str, Any]:
    """What is found over what theory says, and how many vertices and junction edges the mesh has."""
    if shape in FRAMES:
        ends, exact = FRAMES[shape]
        surface = frame(ends, cells=(cells, max(cells // 4, 1)), family=mesh)
        found = deflection(surface, ends) / exact
    elif shape == "tube with webs":
        surface = cellular_box(SIDE, TUBE, (max(cells // 4, 1), 2 * cells), mesh)
        found = twist(surface)
    else:
        rows = max(cells // 4, 1)
        surface = ribbed(rows, mesh)
        found = sag(surface) / beam_sag()
    return {"found": found, "vertices": len(surface.vertices), "junctions": len(surface.junctions)}


def at(mesh: ms.TriangleMesh, place: Place) -> NDArray[np.bool_]:
    """Vertices (n,) at a point of the cross-section."""
    return np.asarray(np.hypot(mesh.vertices[:, 0] - place[0], mesh.vertices[:, 2] - place[1]) < 1e-9)


def deflection(mesh: ms.TriangleMesh, ends: list[Place]) -> float:
    """Deflection of the last end of a frame over P L^3 / EI."""
    held = np.any([at(mesh, end) for end in ends[:-1]], axis=0)
    shell = ms.Shell(mesh, ms.Isotropic(**SHEET), clamped=held)
    force = 1e-3 * SHEET["young"] * SHEET["thickness"] ** 3 / 12.0
    tip = np.flatnonzero(at(mesh, ends[-1]))
    width = np.ptp(mesh.vertices[tip, 1])
    load = ms.LineForce(tip, (force, 0.0, 0.0))
    state = solved(ms.DiscreteShell(shell).equilibrium(loads=[load]))
    moved = (state.positions - mesh.vertices)[tip, 0]
    order = np.argsort(mesh.vertices[tip, 1])
    return float(np.trapezoid(moved[order], mesh.vertices[tip[order], 1]) / width / 1e-3)


def twist(mesh: ms.TriangleMesh) -> float:
    """Twist of the tube over Bredt's, under a shear flow at its end."""
    x, y, z = mesh.vertices.T
    shell = ms.Shell(mesh, ms.Isotropic(**SHEET), clamped=y < -TUBE / 2 + 1e-9)
    walls = np.maximum(np.abs(x), np.abs(z)) > SIDE / 2 - 1e-9
    rim = mesh.edges[(walls & (y > TUBE / 2 - 1e-9))[mesh.edges].all(axis=1)]
    flow, force = 1e-2, np.zeros_like(mesh.vertices)
    along = mesh.vertices[rim[:, 1]] - mesh.vertices[rim[:, 0]]
    middles = mesh.vertices[rim].mean(axis=1)
    along *= np.sign(middles[:, 2] * along[:, 0] - middles[:, 0] * along[:, 2])[:, None]
    for end in (0, 1):
        np.add.at(force, rim[:, end], 0.5 * flow * along)
    state = solved(ms.DiscreteShell(shell).equilibrium(force=force))
    corner = np.flatnonzero((x > SIDE / 2 - 1e-9) & (z > SIDE / 2 - 1e-9) & (y > TUBE / 2 - 1e-9))[0]
    moved = (state.positions - mesh.vertices)[corner]
    shear = SHEET["young"] / 2.0
    exact = 2.0 * flow * SIDE**2 * TUBE / (shear * SIDE**3 * SHEET["thickness"])
    return float((moved[0] - moved[2]) / SIDE / exact)


def ribbed(rows: int, mesh: str) -> ms.TriangleMesh:
    """The plate with its rib, ``rows`` of cells over the rib's height."""
    along = round(rows * PANEL / HEIGHT)
    sides = [strip((0.0, 0.0), (side * WIDTH / 2, 0.0), PANEL, (rows, along), mesh) for side in (-1.0, 1.0)]
    return joined(*sides, strip((0.0, 0.0), (0.0, -HEIGHT), PANEL, (rows, along), mesh))


def sag(mesh: ms.TriangleMesh) -> float:
    """Sag [m] of the rib's end, the other one clamped."""
    y = mesh.vertices[:, 1]
    shell = ms.Shell(mesh, ms.Isotropic(**STEEL), clamped=y < -PANEL / 2 + 1e-9)
    state = solved(ms.DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -GRAVITY)))
    return float(-(state.positions - mesh.vertices)[at(mesh, (0.0, 0.0)) & (y > PANEL / 2 - 1e-9), 2].mean())


def beam_sag() -> float:
    """Sag [m] of a cantilever of T section under its weight, with the shear of its rib."""
    thickness, young = STEEL["thickness"], STEEL["young"]
    area = (WIDTH + HEIGHT) * thickness
    centre = HEIGHT**2 / 2.0 * thickness / area
    second = thickness * HEIGHT * (HEIGHT**2 / 12.0 + (HEIGHT / 2.0 - centre) ** 2) + WIDTH * thickness * centre**2
    load = GRAVITY * STEEL["density"] * area
    shear = young / 2.0 * HEIGHT * thickness * 5.0 / 6.0
    return load * PANEL**4 / (8.0 * young * second) + load * PANEL**2 / (2.0 * shear)


def cut_off() -> float:
    """Sag by linear theory of the plate alone under the weight of both, over that with the rib."""
    load = GRAVITY * STEEL["density"] * (WIDTH + HEIGHT) * STEEL["thickness"]
    rigidity = STEEL["young"] * WIDTH * STEEL["thickness"] ** 3 / 12.0
    return load * PANEL**4 / (8.0 * rigidity) / beam_sag()


def solved(state: ms.Equilibrium) -> ms.Equilibrium:
    """The state; SolverError where it is none."""
    if not state.converged:
        raise ms.SolverError(f"no equilibrium was found: {state.message}")
    return state


def table(result: StudyResult) -> str:
    """One row per shape, mesh and number of cells, as a Markdown table."""
    rows = [{**row, "off": row["found"] - 1.0} for row in result.findings["rows"]]
    return WORDS + markdown(
        "shape | mesh | cells | vertices | junction edges | found | off [%]",
        "{shape} | {mesh} | {cells} | {vertices} | {junctions} | {found:.5f} | {off:100*+.3f}",
        rows,
    )


def finding(result: StudyResult) -> str:
    """Largest errors of the finest and of middling meshes."""
    rows = result.findings["rows"]

    def largest(cells: int, *shapes: str) -> str:
        own = [abs(row["found"] - 1.0) for row in rows if row["cells"] == cells and row["shape"] in shapes]
        return f"{at_most(100 * max(own))} %" if own else "-"

    finest = max(row["cells"] for row in rows)
    middle = min(16, finest)
    return (
        f"T and cross frames are within {largest(middle, *FRAMES)} of the plane frame at {middle} cells a strip, "
        f"{largest(finest, *FRAMES)} at {finest}, on {len({row['mesh'] for row in rows})} mesh families; a tube with "
        f"webs twists within {largest(finest, 'tube with webs')} of Bredt's formula, and a plate with a rib sags "
        f"within {largest(finest, 'plate with a rib')} of a beam of T section. Cut off its rib the plate would sag "
        f"{result.findings['cut']:,.0f} times as much."
    )
