"""What the error of modal models is made of: the hinges, the modes and their warp, and the mesh, against shell theory.

The method of 2007 takes modes of discrete shells (hinges) and warps them; its error was measured against the discrete
shells themselves. Here the truth is shell theory (Isotropic shells) on the same mesh, and the errors of LMA, MWTS and
RSW are parted: *hinges* is what calibrated discrete shells are off shell theory, *modes and warp* what a model on their
modes is off the discrete shells. Next to them stand the same models on modes of shell theory, which have no part of the
hinges, and what the mesh leaves of shell theory's answer (against cells of half the size). All are displacements in the
mass norm, relative to those of the truth, at 0.2, 0.5 and all of a load under which the tip would move by half a length
in linear theory: a quarter for the V-beam and a fortieth for the panel, which snap.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

import modalshell as ms
from modalshell.core.typing import Progress
from modalshell.files.study_result import StudyResult
from modalshell.models.registry import MODELS as MODEL_SPECS
from studies.pages import at_most, markdown, result_of
from studies.shell_theory import ENERGIES, Sheet, columns, crossed, displacements_at, flat_shell, rows_of

FIGURES = ("error_budget", "shell_theory_errors", "shell_theory_shapes")

LENGTH = 0.3
PARTS = ("on hinges", "modes and warp", "on shell theory")
"""Errors of a model on modes."""
LOADS = (0.2, 0.5, 1.0)
"""Shares of the largest load."""
MODES = 16
MODELS = tuple(key for key, spec in MODEL_SPECS.items() if spec.needs == "basis" and spec.pictured)
"""Models on modes, by their keys: one for each way to deform."""
SWEEP = np.radians(30.0)
FAMILIES = ("union-jack", "equilateral")
SHAPES: dict[str, tuple[str, float, str, float]] = {
    "strip, one way": ("flat", 0.0, "weight", 0.5),
    "plate": ("wide", 0.3, "weight", 0.5),
    "swept plate": ("swept", 0.3, "weight", 0.5),
    "twisted strip": ("flat", 0.3, "couple", 0.5),
    "curved panel": ("panel", 0.3, "lift", 0.025),
    "V-beam": ("v", 0.3, "weight", 0.25),
}
"""Shape, Poisson's ratio and load of each case, and by how many lengths its tip would move in linear theory."""


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """All shapes on both mesh families; ``quick`` takes coarser meshes and two shapes."""
    across = 4 if quick else 8
    arrays: dict[str, np.ndarray] = {}
    cases = crossed(case=list(SHAPES)[:4:3] if quick else SHAPES, mesh=FAMILIES)
    rows = rows_of(partial(budget, across=across, arrays=arrays), cases, on_step)
    return result_of("error_budget", {"rows": rows}, arrays, across=across)


def shape(kind: str, family: str, across: int) -> ms.TriangleMesh:
    """A mesh of ``across`` cells across, clamped at x = 0; cells near equilateral or square."""
    width = {"flat": 0.06, "wide": 0.2, "swept": 0.1, "panel": 0.15, "v": 0.04}[kind]
    cells = (columns(family, LENGTH / width * across), across)
    if kind == "panel":
        return ms.cylinder_panel(length=LENGTH, radius=LENGTH, angle=np.degrees(0.5), cells=cells, family=family)
    if kind == "v":
        return ms.v_beam(length=LENGTH, width=width, fold=150.0, cells=cells, family=family)
    if kind == "swept" and family == "equilateral":
        # Sheared by 30 degrees, right triangles under the short diagonal become equilateral ones.
        cells, family = (round(cells[0] * 4.0 / 3.0), cells[1]), "right"
    flat = ms.flat_beam(length=LENGTH, width=width, cells=cells, family=family)
    if kind != "swept":
        return flat
    sheared = np.array(flat.vertices)
    sheared[:, 1] -= np.tan(SWEEP) * sheared[:, 0]
    return ms.TriangleMesh(sheared, flat.faces)


def sheet(kind: str, poisson: float) -> Sheet:
    """The sheet: 1 mm thick, the V-beam's 2 mm, so that its fold does not flatten at these loads."""
    return {"young": 1e9, "poisson": poisson, "thickness": 2e-3 if kind == "v" else 1e-3, "density": 1000.0}


def load_of(shell: ms.Shell, how: str) -> np.ndarray:
    """The load (n, 3) [N] of size 1: weight, down or up, with opposite forces at the tip's corners to twist."""
    weight = shell.gravity_force((0.0, 0.0, 1.0 if how == "lift" else -1.0))
    if how == "couple":
        rest = shell.rest_positions
        far = np.flatnonzero(np.isclose(rest[:, 0], rest[:, 0].max(), atol=1e-6))
        total = np.linalg.norm(weight.sum(axis=0))
        for corner, sign in ((far[rest[far, 1].argmin()], 1.0), (far[rest[far, 1].argmax()], -1.0)):
            weight[corner, 2] += 3.0 * sign * total
    return weight


def budget(case: str, mesh: str, across: int, arrays: dict[str, np.ndarray]) -> list[dict[str, Any]]:
    """Errors of one shape on one mesh family, one row per load."""
    kind, poisson, how, most = SHAPES[case]
    coarse_mesh, fine_mesh = (shape(kind, mesh, factor * across) for factor in (1, 2))
    stuff = sheet(kind, poisson)
    held = coarse_mesh.vertices[:, 0] < 1e-9
    slope = SWEEP if kind == "swept" else 0.0
    along = (float(np.cos(slope)), -float(np.sin(slope)), 0.0)
    theory, hinges = (flat_shell(energy, coarse_mesh, stuff, held, direction=along) for energy in ENERGIES)
    fine = flat_shell("Isotropic", fine_mesh, stuff, fine_mesh.vertices[:, 0] < 1e-9)
    whole = {key: ms.DiscreteShell(shell) for key, shell in (("theory", theory), ("hinges", hinges), ("fine", fine))}
    bases = {"theory": ms.solve_modes(theory, MODES), "hinges": ms.solve_modes(hinges, MODES)}
    modal = {f"{model} {key}": ms.models()[model].builder(basis) for model in MODELS for key, basis in bases.items()}
    rest, count = theory.rest_positions, len(theory.rest_positions)
    tip = int(np.argmax(rest[:, 0] + 1e-6 * rest[:, 1]))
    unit = modal["lma theory"].equilibrium(force=load_of(theory, how)).positions
    linear = float(np.linalg.norm(unit[tip] - rest[tip]))
    rows = []
    for share in LOADS:
        factor = share * most * LENGTH / linear
        found = {
            key: model.equilibrium(force=factor * load_of(model.shell, how))
            for key, model in {**{f"whole {key}": model for key, model in whole.items()}, **modal}.items()
        }
        moved = {key: answer.positions[:count] - rest for key, answer in found.items() if key != "whole fine"}
        moved["whole fine"] = displacements_at(fine, found["whole fine"].positions, rest)
        truth = moved["whole theory"]

        def size(field: np.ndarray, mass: np.ndarray = theory.mass) -> float:
            return float(np.sqrt(mass @ np.sum(field**2, axis=1)))

        rows.append(
            {
                "load": share,
                "moved": float(np.linalg.norm(truth[tip]) / LENGTH),
                "hinges": size(moved["whole hinges"] - truth) / size(truth),
                "of the mesh": size(moved["whole fine"] - truth) / size(truth),
                "converged": all(answer.converged for answer in found.values()),
                "models": {
                    model: {
                        "on hinges": size(moved[f"{model} hinges"] - truth) / size(truth),
                        "modes and warp": size(moved[f"{model} hinges"] - moved["whole hinges"]) / size(truth),
                        "on shell theory": size(moved[f"{model} theory"] - truth) / size(truth),
                    }
                    for model in MODELS
                },
            }
        )
        for key, field in moved.items():
            arrays[f"{case}, {mesh}, {share:g}, {key}"] = rest + field
    arrays[f"{case}, {mesh}, faces"] = coarse_mesh.faces
    return rows


def table(result: StudyResult) -> str:
    """One row per shape, mesh and load, as a Markdown table."""
    parts = [(model, head) for model in result.findings["rows"][0]["models"] for head in PARTS]
    headings = " | ".join(f"{ms.models()[model].name} {head}" for model, head in parts)
    rows = []
    for row in result.findings["rows"]:
        errors = [row["models"][model][head] for model, head in parts]
        rows.append({**row, "errors": errors, "mark": "" if row["converged"] else ", not converged"})
    return "Errors of displacement against shell theory [%]; parts add up as vectors:\n\n" + markdown(
        f"case | mesh | load | tip [L] | hinges | {headings} | the mesh",
        "{case}{mark} | {mesh} | {load:g} | {moved:.3f} | {hinges:100*.2f} | {errors:100*.2f} | {of the mesh:100*.2f}",
        rows,
    )


def finding(result: StudyResult) -> str:
    """At which shapes and loads the hinges make the larger part of the error."""
    rows = result.findings["rows"]

    def largest(load: float, head: str) -> str:
        chosen = [row for row in rows if row["case"] != "strip, one way" and row["load"] == load]
        return f"{at_most(max(100 * row['models']['mwts'][head] for row in chosen))} %"

    larger = sum(row["hinges"] > row["models"]["mwts"]["modes and warp"] for row in rows)
    hinges, theory = ([largest(load, f"on {head}") for load in (0.2, 1.0)] for head in ("hinges", "shell theory"))
    return (
        "Where a sheet bends two ways or twists, modal warping (MWTS) on modes of hinges is off shell theory by up to "
        f"{hinges[0]} under small loads and {hinges[1]} under large ones, on modes of shell theory by {theory[0]} "
        f"and {theory[1]}. In {larger} of {len(rows)} cases the hinges themselves are off by more than modes and warp "
        "together."
    )
