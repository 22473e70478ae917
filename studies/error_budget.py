"""What the error of modal warping is made of: the hinges, the modes, the warp and the mesh, against shell theory.

The method of 2007 takes modes of discrete shells (hinges) and warps them; its error was measured against the discrete
shells themselves. Here the truth is shell theory (Isotropic) on the same mesh, and an answer's error is parted: *hinges* is what
calibrated discrete shells are off shell theory; *modes and warp* is what MWTS with its modes is off the discrete
shells. Beside it stand MWTS on modes of shell theory, which has the second part alone, and what the mesh itself leaves
of shell theory's answer (against a mesh of half the size). All are displacements in the mass norm, relative to that of
the truth, at loads under which the truth drops by 0.1, 0.2 and 0.4 lengths.

Run it alone with ``modalshell reproduce --only error_budget``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import modalshell as ms
from modalshell.provenance import run_record
from modalshell.study import StudyResult, Table
from studies.both_energies import Sheet, displacements_at, flat_shell
from studies.pages import number

FIGURES = ("error_budget",)

LENGTH = 0.3
DROPS = (0.1, 0.2, 0.4)
"""Drops of the truth's tip at which everything is compared [lengths]."""
MODES = 16
FAMILIES = ("union-jack", "equilateral")
SHAPES: dict[str, tuple[str, float, str]] = {
    "strip, one way": ("flat", 0.0, "weight"),
    "plate": ("wide", 0.3, "weight"),
    "swept plate": ("swept", 0.3, "weight"),
    "twisted strip": ("flat", 0.3, "couple"),
    "curved panel": ("panel", 0.3, "weight"),
    "V-beam": ("v", 0.3, "weight"),
}
"""Shape, Poisson's ratio and load of each case."""


def main(quick: bool = False, on_step: Callable[[int, int], None] | None = None) -> StudyResult:
    """All shapes on both mesh families; ``quick`` takes coarser meshes and three shapes."""
    across = 4 if quick else 8
    names = list(SHAPES)[::2] if quick else list(SHAPES)
    rows: list[dict[str, Any]] = []
    arrays: dict[str, np.ndarray] = {}
    cases = [(name, family) for name in names for family in FAMILIES]
    for done, (name, family) in enumerate(cases, start=1):
        rows += budget(name, family, across, arrays)
        if on_step is not None:
            on_step(done, len(cases))
    parameters = {"length": LENGTH, "drops": DROPS, "modes": MODES, "across": across, "shapes": SHAPES}
    return StudyResult("error_budget", {"rows": rows}, arrays, run_record(parameters))


def shape(kind: str, family: str, across: int) -> ms.TriangleMesh:
    """A mesh of ``across`` cells across, clamped at x = 0; cells near equilateral or square."""
    stretch = 2.0 / np.sqrt(3.0) if family == "equilateral" else 1.0
    width = {"flat": 0.06, "wide": 0.2, "swept": 0.1, "panel": 0.15, "v": 0.04}[kind]
    cells = (round(LENGTH / width * across / stretch), across)
    if kind == "panel":
        return ms.cylinder_panel(length=LENGTH, radius=LENGTH, angle=np.degrees(0.5), cells=cells, family=family)
    if kind == "v":
        return ms.v_beam(length=LENGTH, width=width, fold=150.0, cells=cells, family=family)
    flat = ms.flat_beam(length=LENGTH, width=width, cells=cells, family=family)
    if kind != "swept":
        return flat
    sheared = np.array(flat.vertices)
    sheared[:, 1] += np.tan(np.radians(30.0)) * sheared[:, 0]
    return ms.TriangleMesh(sheared, flat.faces)


def sheet(kind: str, poisson: float) -> Sheet:
    """The sheet: 1 mm thick, the V-beam's 2 mm, so that its fold does not flatten at these loads."""
    return {"young": 1e9, "poisson": poisson, "thickness": 2e-3 if kind == "v" else 1e-3, "density": 1000.0}


def load_of(shell: ms.Shell, how: str) -> np.ndarray:
    """The load (n, 3) [N] of size 1: weight, with a couple of opposite forces at the tip's corners to twist."""
    weight = shell.gravity_force((0.0, 0.0, -1.0))
    if how == "couple":
        rest = shell.rest_positions
        far = np.flatnonzero(np.isclose(rest[:, 0], rest[:, 0].max(), atol=1e-6))
        total = np.linalg.norm(weight.sum(axis=0))
        for corner, sign in ((far[rest[far, 1].argmin()], 1.0), (far[rest[far, 1].argmax()], -1.0)):
            weight[corner, 2] += 3.0 * sign * total
    return weight


def budget(name: str, family: str, across: int, arrays: dict[str, np.ndarray]) -> list[dict[str, Any]]:
    """Errors of one shape on one mesh family, one row a drop."""
    kind, poisson, how = SHAPES[name]
    mesh = shape(kind, family, across)
    stuff = sheet(kind, poisson)
    held = mesh.vertices[:, 0] < 1e-9
    theory, hinges = (flat_shell(energy, mesh, stuff, held) for energy in ("Isotropic", "hinges"))
    fine_mesh = shape(kind, family, 2 * across)
    fine = flat_shell("Isotropic", fine_mesh, stuff, fine_mesh.vertices[:, 0] < 1e-9)
    whole = {key: ms.DiscreteShell(shell) for key, shell in (("theory", theory), ("hinges", hinges), ("fine", fine))}
    warped = {
        key: ms.ModalWarping(ms.solve_modes(shell, MODES)) for key, shell in (("theory", theory), ("hinges", hinges))
    }
    rest, count = theory.rest_positions, len(theory.rest_positions)
    tip = int(np.argmax(rest[:, 0] + 1e-6 * rest[:, 1]))
    rows = []
    for drop in DROPS:
        factor = load_for(whole["theory"], load_of(theory, how), tip, drop * LENGTH)
        found = {
            f"{kind_of} {key}": model.equilibrium(force=factor * load_of(model.shell, how))
            for kind_of, models in (("whole", whole), ("mwts", warped))
            for key, model in models.items()
        }
        moved = {key: answer.positions[:count] - rest for key, answer in found.items() if key != "whole fine"}
        moved["whole fine"] = displacements_at(fine, found["whole fine"].positions, rest)
        truth = moved["whole theory"]

        def size(field: np.ndarray, mass: np.ndarray = theory.mass) -> float:
            return float(np.sqrt(mass @ np.sum(field**2, axis=1)))

        rows.append(
            {
                "case": name,
                "mesh": family,
                "drop": drop,
                "mwts on hinges": size(moved["mwts hinges"] - truth) / size(truth),
                "hinges": size(moved["whole hinges"] - truth) / size(truth),
                "modes and warp": size(moved["mwts hinges"] - moved["whole hinges"]) / size(truth),
                "mwts on shell theory": size(moved["mwts theory"] - truth) / size(truth),
                "mesh": size(moved["whole fine"] - truth) / size(truth),
                "converged": all(answer.converged for answer in found.values()),
            }
        )
        for key, field in moved.items():
            arrays[f"{name}, {family}, {drop:g}, {key}"] = rest + field
    arrays[f"{name}, {family}, faces"] = mesh.faces
    return rows


def load_for(model: ms.DiscreteShell, load: np.ndarray, tip: int, drop: float) -> float:
    """Factor of ``load`` under which the vertex ``tip`` moves by ``drop`` [m], by secants."""
    rest = model.shell.rest_positions[tip]

    def moved(factor: float) -> float:
        return float(np.linalg.norm(model.equilibrium(force=factor * load).positions[tip] - rest))

    low, high = 0.0, 1e-3
    reached = [0.0, moved(high)]
    while abs(reached[1] - drop) > 1e-3 * drop:
        slope = (reached[1] - reached[0]) / (high - low)
        low, high = high, min(high + (drop - reached[1]) / slope, 4.0 * high if reached[1] < drop else high)
        reached = [reached[1], moved(high)]
    return high


def table(result: StudyResult) -> str:
    """One row a shape, mesh and drop, as a Markdown table."""
    heads = ("mwts on hinges", "hinges", "modes and warp", "mwts on shell theory", "mesh")
    words = ("MWTS on hinges", "of that hinges", "of that modes and warp", "MWTS on shell theory", "the mesh")
    lines = ["Errors of displacement against shell theory [%]; parts add up as vectors:", ""]
    lines += ["| case | mesh | drop [L] | " + " | ".join(words) + " |", "|---" * 8 + "|"]
    for row in result.findings["rows"]:
        cells = " | ".join(f"{100 * row[head]:.2f}" for head in heads)
        mark = "" if row["converged"] else ", not converged"
        lines.append(f"| {row['case']}{mark} | {row['mesh']} | {row['drop']:g} | {cells} |")
    return "\n".join(lines)


def finding(tables: list[Table]) -> str:
    """At which shapes and drops the hinges make the larger part of the error."""
    (rows,) = tables

    def span(head: str, drop: float) -> str:
        values = [
            number(row[head]) for row in rows if float(row["drop [L]"]) == drop and row["case"] != "strip, one way"
        ]
        return f"{min(values):.2g} to {max(values):.2g} %"

    larger = sum(number(row["of that hinges"]) > number(row["of that modes and warp"]) for row in rows)
    return (
        f"Where a sheet bends two ways or twists, MWTS on hinges is {span('MWTS on hinges', 0.1)} off shell theory at a "
        f"drop of 0.1 lengths, {span('MWTS on hinges', 0.4)} at 0.4; on modes of shell theory "
        f"{span('MWTS on shell theory', 0.1)} and {span('MWTS on shell theory', 0.4)}. In {larger} of {len(rows)} cases "
        "the hinges are off by more than modes and warp."
    )
