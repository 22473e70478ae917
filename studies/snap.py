"""Load-deflection paths through snaps: folded strips, a panel, a tape spring, the hinged roof and Lee's frame.

Each path of equilibria is followed by arc length through its limit points, its stability counted at every point. Three
are compared with known results:

* Lee's frame, a narrow strip of shell theory without Poisson effect, against the elastica (:mod:`elastica_frame`).
* The hinged cylindrical roof under a load at its centre [sze2004, 3.8], with thicknesses of 12.7 and 6.35 mm: the thick
  one snaps through, the thin one also back. A quarter of it, on two meshes.
* A tape spring, half of its length and width. Bent, it folds, and the fold keeps its radius while it grows: the moment
  stays at ``(1 + nu) D alpha`` where the section opens outwards, ``(1 - nu) D alpha`` where inwards, D the bending
  stiffness and alpha the angle of the section [seffen1999]. Thick end blocks carry a couple of forces along its axis.
"""

from __future__ import annotations

from typing import Any

import numpy as np

import modalshell as ms
from modalshell.compare.path import Marks
from modalshell.core.typing import Progress
from modalshell.files.study_result import StudyResult
from studies.elastica_frame import LOADED_AT, frame_path, limit_loads
from studies.pages import at_most, counted, markdown, paragraphs, result_of
from studies.tape_spring import moments, plateau_start, tape_spring

FIGURES = ("snap",)

STIFF = ms.Material(2000.0, 2000.0, 0.05, 0.2)
ROOF = {"radius": 2540.0, "half": 254.0, "angle": 0.1, "young": 3102.75, "poisson": 0.3}
"""The roof of Sze 3.8: half of its sides, half of its angle; N and mm."""
ROOF_LOADS = {12.7: 3000.0, 6.35: 1000.0}
TAPE_POISSON = 0.3
PLATEAU = (40.0, 57.0)
"""Turns of the tape spring's end [degrees] over which the moment of its plateau is averaged."""

Case = tuple[ms.EquilibriumPath, dict[str, Any]]


def v_beam(fold: float, cells: tuple[int, int]) -> ms.Shell:
    """The V-beam of stiff membrane of ``v_beam_accuracy``, or one of another fold."""
    mesh = ms.v_beam(length=1.0, width=0.2, fold=fold, cells=cells)
    return ms.Shell(mesh, STIFF, mesh.vertices[:, 0] < 1.5 / cells[0])


def panel(cells: tuple[int, int]) -> ms.Shell:
    """A shallow panel, held along both straight edges."""
    mesh = ms.cylinder_panel(cells=cells, angle=40.0)
    across = np.abs(mesh.vertices[:, 1])
    return ms.Shell(mesh, ms.Material(200.0, 200.0, 0.05, 0.2), across > across.max() - 1e-9)


def roof(thickness: float, cells: int) -> tuple[ms.Shell, np.ndarray]:
    """A quarter of the hinged roof, and which vertex is its centre (n,)."""
    half = ROOF["half"]
    flat = ms.flat_beam(length=half, width=half, cells=(cells, cells), family="union-jack")
    x, y = flat.vertices[:, 0], flat.vertices[:, 1] - flat.vertices[:, 1].min()
    turn = y / half * ROOF["angle"]
    mesh = ms.TriangleMesh(
        np.column_stack([x, ROOF["radius"] * np.sin(turn), ROOF["radius"] * np.cos(turn)]), flat.faces
    )
    sheet = ms.Isotropic(young=ROOF["young"], poisson=ROOF["poisson"], thickness=thickness, density=1e-6)
    supports = [ms.Pin(y > half - 1e-6), ms.Symmetry(x < 1e-6, (1, 0, 0)), ms.Symmetry(y < 1e-6, (0, 1, 0))]
    return ms.Shell(mesh, sheet, supports=supports), x + y < 1e-6


def lee_frame(cells: tuple[int, int]) -> tuple[ms.Shell, np.ndarray, float]:
    """Lee's frame as a strip bent at a right angle; the loaded row of vertices (n,), and EI over the width [N m]."""
    width, thickness, young = 0.05, 1e-3, 1e9
    flat = ms.flat_beam(length=2.0, width=width, cells=cells, family="union-jack")
    s, y = flat.vertices[:, 0], flat.vertices[:, 1]
    mesh = ms.TriangleMesh(np.column_stack([np.maximum(s - 1.0, 0.0), y, np.minimum(s, 1.0)]), flat.faces)
    sheet = ms.Isotropic(young=young, poisson=0.0, thickness=thickness, density=1e3)
    shell = ms.Shell(mesh, sheet, supports=[ms.Pin(s < 1e-9), ms.Pin(s > 2.0 - 1e-9)])
    return shell, np.abs(s - 1.0 - LOADED_AT) < 1e-9, young * thickness**3 / 12.0


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """Follow every path; ``quick`` takes coarser meshes."""
    found: dict[str, Any] = {"curves": [], "checks": []}
    arrays: dict[str, np.ndarray] = {}
    tasks = [
        *(lambda fold=fold: folded(fold, (20, 4) if quick else (40, 8)) for fold in (150.0, 160.0)),
        lambda: pushed((6, 8) if quick else (12, 16)),
        *(lambda h=h: snapped_roof(h, (8, 12) if quick else (16, 24)) for h in ROOF_LOADS),
        lambda: framed((40, 2), 0.1) if quick else framed((80, 4), 0.05),
        lambda: taped((24, 4) if quick else (48, 8)),
        *(lambda sense=sense: folded_tape(sense, (40, 10) if quick else (64, 12)) for sense in (1.0, -1.0)),
    ]
    for task in counted(tasks, on_step):
        curves, checks = task()
        for path, told in curves:
            found["curves"].append(told | numbers_of(path))
            if told.get("pictured") and path.mesh is not None:
                chosen = [0, *(event[1] for event in path.events if event.kind == "limit"), len(path.factors) - 1]
                arrays[f"{told['case']}_positions"] = path.positions[chosen]
                arrays[f"{told['case']}_faces"] = np.asarray(path.mesh.faces)
        found["checks"] += checks
    return result_of("snap", found, arrays, quick=quick)


def numbers_of(path: ms.EquilibriumPath) -> dict[str, Any]:
    """The reported data of a path: its curve, events and marks."""
    marks = Marks.of(path)
    return {
        "factors": path.factors,
        "displacements": path.displacements,
        "stable": path.stable,
        "events": [tuple(event) for event in path.events],
        "converged": path.converged,
        "bifurcation": marks.bifurcation,
        "snap": marks.snap,
        "stable_again": marks.stable_again,
        "points": len(path.factors),
    }


def folded(fold: float, cells: tuple[int, int]) -> tuple[list[Case], list[dict[str, Any]]]:
    """A folded strip under gravity: DS with its twisted branch, RSW and MD-ROM."""
    shell, name = v_beam(fold, cells), f"V {fold:.0f}°"
    until = 70.0
    models = {"DS": ms.DiscreteShell(shell), "RSW 8": ms.RotationStrain(ms.solve_modes(shell, 8))}
    models["MD-ROM 8"] = ms.ModalDerivatives(shell, 8)
    curves: list[Case] = []
    for label, model in models.items():
        path = ms.equilibrium_path(model, gravity=(0, 0, -1), until=until, branches=1)
        curves.append((path, {"case": name, "model": label, "pictured": label == "DS"}))
        curves += [(branch, {"case": name, "model": f"{label}, twisted"}) for branch in path.branches[:1]]
    return curves, []


def pushed(cells: tuple[int, int]) -> tuple[list[Case], list[dict[str, Any]]]:
    """A panel pushed through by gravity: DS and MD-ROM."""
    shell = panel(cells)
    curves: list[Case] = []
    for label, model in (("DS", ms.DiscreteShell(shell)), ("MD-ROM 8", ms.ModalDerivatives(shell, 8))):
        path = ms.equilibrium_path(model, gravity=(0, 0, -1), until=600.0, steps=30, branches=1)
        curves.append((path, {"case": "panel", "model": label, "pictured": label == "DS"}))
    return curves, []


def snapped_roof(thickness: float, meshes: tuple[int, int]) -> tuple[list[Case], list[dict[str, Any]]]:
    """The hinged roof on two meshes; their limit loads against each other."""
    most = ROOF_LOADS[thickness]
    name, curves, limits = f"roof {thickness:g} mm", [], []
    for cells in meshes:
        shell, centre = roof(thickness, cells)
        load = ms.PointForce(centre, (0, 0, -0.25))
        path = ms.equilibrium_path(shell, loads=[load], until=most, watch=(centre, (0, 0, -1)))
        curves.append((path, {"case": name, "model": f"Isotropic {cells}x{cells}"}))
        limits.append([event.factor for event in path.events if event.kind == "limit"][:2])
    checks = [
        check(name, f"{which} limit load, N, on {meshes[1]} cells against {meshes[0]}", fine, coarse)
        for which, coarse, fine in zip(("first", "second"), *limits, strict=True)
    ]
    return curves, checks


def framed(cells: tuple[int, int], step: float) -> tuple[list[Case], list[dict[str, Any]]]:
    """Lee's frame, its limit loads against those of the elastica."""
    shell, row, stiffness = lee_frame(cells)
    path = ms.equilibrium_path(
        shell, loads=[ms.LineForce(row, (0, 0, -stiffness))], until=40.0, steps=30, watch=(row, (0, 0, -1))
    )
    loads, drops = frame_path(step=step)
    limits = [event.factor for event in path.events if event.kind == "limit"]
    checks = [
        check("Lee's frame", f"{which} limit load, EI/L²", one, exact)
        for which, one, exact in zip(("first", "second"), limits, limit_loads(loads)[:2], strict=True)
    ]
    exact = {"elastica_loads": loads, "elastica_drops": drops}
    return [(path, {"case": "Lee's frame", "model": "Isotropic", "pictured": True, **exact})], checks


def taped(cells: tuple[int, int]) -> tuple[list[Case], list[dict[str, Any]]]:
    """A short, thick tape spring from rest over its peak into its fold."""
    tape = tape_spring(angle=1.0, thickness=0.02, cells=cells, poisson=TAPE_POISSON)
    path = ms.equilibrium_path(tape.shell, force=tape.couple, until=6.0, steps=24, watch=tape.watch)
    return [(path, {"case": "tape spring", "model": "Isotropic", "pictured": True})], []


def folded_tape(sense: float, cells: tuple[int, int]) -> tuple[list[Case], list[dict[str, Any]]]:
    """A thin tape spring with a fold, bent back: its moment against that of the plateau."""
    tape = tape_spring(angle=2.0, thickness=0.01, cells=cells, poisson=TAPE_POISSON)
    exact = 1.0 + sense * TAPE_POISSON
    turn = np.radians(60.0)
    start = plateau_start(tape, sense, turn)
    begin = exact / np.cos(turn)
    answer = ms.DiscreteShell(tape.shell).equilibrium(force=sense * begin * tape.couple, start=start)
    path = ms.equilibrium_path(
        tape.shell,
        force=sense * tape.couple,
        begin=begin,
        until=1.25 * exact,
        start=answer.positions,
        steps=15,
        watch=tape.watch,
    )
    moment, turns = moments(tape, path)
    inside = (np.abs(turns) >= PLATEAU[0]) & (np.abs(turns) <= PLATEAU[1]) & path.stable
    name = "tape spring, opposite sense" if sense > 0.0 else "tape spring, equal sense"
    mean = float(np.abs(moment[inside]).mean())
    told = {"case": "tape plateau", "model": name.partition(", ")[2], "moment": np.abs(moment), "turn": np.abs(turns)}
    worst = np.abs(np.abs(moment[inside]) / exact - 1.0).max()
    return [(path, told)], [check(name, "plateau moment over D alpha", mean, exact) | {"worst": float(worst)}]


def check(case: str, what: str, value: float, exact: float) -> dict[str, Any]:
    """One number against what it should be."""
    return {"case": case, "what": what, "value": value, "reference": exact, "off": abs(value / exact - 1.0)}


def table(result: StudyResult) -> str:
    """The marks of every path, and the checks, as Markdown tables."""
    paths = []
    for one in result.findings["curves"]:
        kinds = [event[0] for event in one["events"]]
        paths.append({**one, "counts": [kinds.count(kind) for kind in ("limit", "bifurcation")]})
    return paragraphs(
        markdown(
            "case | model | bifurcation | snap | stable again | limit points | bifurcations | points",
            "{case} | {model} | {bifurcation:.4g|–} | {snap:.4g|–} | {stable_again:.4g|–} | {counts} | {points}",
            paths,
        ),
        "Loads are gravity [m/s²] of the V-beams and the panel, N of the roof, EI/L² of the frame, and the couple "
        "of the tape spring at rest over D alpha.",
        markdown(
            "case | quantity | here | reference | off",
            "{case} | {what} | {value:.5g} | {reference:.5g} | {off:100*.2f} %",
            result.findings["checks"],
        ),
    )


def finding(result: StudyResult) -> str:
    """What holds of the references, and what the rungs on rest modes see of the snap."""
    found = result.findings

    def worst(name: str) -> str:
        return f"{at_most(100 * max(one['off'] for one in found['checks'] if one['case'].startswith(name)))} %"

    strip = {one["model"]: one for one in found["curves"] if one["case"] == "V 150°"}
    blind = [name.split()[0] for name, one in strip.items() if "twisted" not in name and one["snap"] is None]
    return (
        f"Limit loads of Lee's frame are within {worst('Lee')} of the elastica's, those of the hinged roof change by "
        f"{worst('roof')} between the two finest meshes, and the tape spring's moment is within {worst('tape')} of its "
        f"plateau's. The stiff V snaps at a gravity of {strip['DS']['snap']:.4g} and is stable again, flattened, from "
        f"{strip['DS']['stable_again']:.4g} on; on rest modes, {' and '.join(blind)} shows neither."
    )
