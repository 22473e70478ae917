"""V-beams under their weight, every model of both bending energies beside finite elements, through the snap.

The references are solid finite elements with geometric nonlinearity (``studies/finite_elements.json``): folds of 150
and 120 degrees, gravity down (the free edges are compressed) and up, and a wider beam whose fold flattens between
Gamma 2.2 and 2.3. Poisson's ratio is 0, so that the hinges are calibrated as well as they can be, on equilateral
triangles. Both energies clamp the same line. Errors are of displacement at free edges and ridge, ten stations each,
relative to that of the finite elements. Gamma = 12 rho g L^3 / (E b^2 cos^2(fold / 2)), b the width of a flange.

Run it alone with ``modalshell reproduce --only v_beam_truth``.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import modalshell as ms
from modalshell.compare.path import find_jump
from modalshell.provenance import run_record
from modalshell.study import StudyResult, Table
from studies.both_energies import ENERGIES, Sheet, displacements_at, flat_shell
from studies.pages import number

FIGURES = ("v_beam_truth",)

SHEET: Sheet = {"young": 1e9, "poisson": 0.0, "thickness": 1e-3, "density": 1000.0}
LENGTH = 0.3
MODES = 8
RUNGS = ("lma", "mwts", "rsw", "md-rom", "ds")
"""Models by their keys; the last is the whole mesh."""
SNAPPING = "150 deg, flange 15 mm, down"
PAST = 2.25
"""Gamma above which the snapping beam has snapped."""


def references() -> list[dict[str, Any]]:
    """Beams, loads and displacements of the finite elements."""
    text = Path(__file__).with_name("finite_elements.json").read_text(encoding="utf-8")
    cases: list[dict[str, Any]] = json.loads(text)["v_beams"]["cases"]
    return cases


def main(quick: bool = False, on_step: Callable[[int, int], None] | None = None) -> StudyResult:
    """All beams, energies, models and loads; ``quick`` takes a coarser mesh, two beams and three loads of each."""
    flange_cells, stride = (2, 3) if quick else (6, 1)
    cases = references()[::3] if quick else references()
    total, done = len(cases) * len(ENERGIES) * len(RUNGS), 0
    rows: list[dict[str, Any]] = []
    snaps: dict[str, Any] = {}
    arrays: dict[str, np.ndarray] = {}
    for case in cases:
        loads = case["loads"][::-stride][::-1]
        mesh = beam(case, flange_cells)
        for energy in ENERGIES:
            shell = flat_shell(energy, mesh, SHEET, mesh.vertices[:, 0] < 1e-9)
            for key in RUNGS:
                found, snap = answers(shell, key, case, loads)
                rows += [{"beam": case["name"], "energy": energy, "model": key, **row} for row in found]
                if snap is not None:
                    snaps[f"{case['name']}, {energy}"] = snap
                done += 1
                if on_step is not None:
                    on_step(done, total)
        arrays[f"{case['name']} faces"], arrays[f"{case['name']} rest"] = mesh.faces, mesh.vertices
    parameters = {**SHEET, "length": LENGTH, "modes": MODES, "flange_cells": flange_cells, "family": "equilateral"}
    return StudyResult("v_beam_truth", {"rows": rows, "snaps": snaps}, arrays, run_record(parameters))


def beam(case: dict[str, Any], flange_cells: int) -> ms.TriangleMesh:
    """A V-beam of near-equilateral triangles."""
    height = case["flange"] / flange_cells
    columns = round(LENGTH / (height * 2.0 / np.sqrt(3.0)))
    width, cells = 2.0 * case["flange"], (columns, 2 * flange_cells)
    return ms.v_beam(length=LENGTH, width=width, fold=case["fold"], cells=cells, family="equilateral")


def answers(
    shell: ms.Shell, key: str, case: dict[str, Any], loads: list[dict[str, Any]]
) -> tuple[list[dict[str, Any]], list[float] | None]:
    """Drop of the ridge's tip and error of a model at every load; and where the whole mesh jumps [Gamma], if it does.

    The whole mesh is followed from load to load, models on modes answer each load from rest.
    """
    spec = ms.models()[key]
    if spec.needs == "basis":
        model = spec.builder(ms.solve_modes(shell, MODES))
    else:
        model = spec.builder(shell) if key == "ds" else spec.builder(shell, MODES)
    direction, points = np.array(case["direction"]), np.array(case["points"])
    whole = key == "ds"
    unit = shell.gravity_force(direction)
    rows: list[dict[str, Any]] = []
    last, last_gravity, snap = None, 0.0, None
    for load in loads:
        gravity = load["gravity"]
        answer = model.equilibrium(gravity=gravity * direction, start=last if whole else None)
        exact = np.array(load["displacements"])
        moved = displacements_at(shell, answer.positions, points)
        rows.append(
            {
                "gamma": load["gamma"],
                "drop": float(moved[-2] @ direction / LENGTH),
                "reference_drop": float(exact[-2] @ direction / LENGTH),
                "error": float(np.linalg.norm(moved - exact) / np.linalg.norm(exact)),
                "status": answer.status,
            }
        )
        if whole and answer.converged:
            before = shell.rest_positions if last is None else last
            jump = None
            if snap is None and case["name"] == SNAPPING:
                jump = find_jump(model, unit, before, last_gravity, answer.positions, gravity)
            if jump is not None:
                snap = [share / gravity * load["gamma"] for share in (jump.low, jump.high)]
            last, last_gravity = answer.positions, gravity
    return rows, snap


def table(result: StudyResult) -> str:
    """Errors by beam, load, energy and model, as Markdown tables."""
    names = [ms.models()[key].name for key in RUNGS]
    heads = [f"{name}, {energy}" for energy in ENERGIES for name in names]
    lines = ["Errors of displacement against finite elements [%]:", ""]
    lines.append("| beam | Γ | drop [L] | " + " | ".join(heads) + " |")
    lines.append("|---" * (3 + len(heads)) + "|")
    rows = result.findings["rows"]
    cells = {(row["beam"], row["gamma"], row["energy"], row["model"]): row for row in rows}
    for case, gamma in dict.fromkeys((row["beam"], row["gamma"]) for row in rows):
        chosen = [cells[case, gamma, energy, key] for energy in ENERGIES for key in RUNGS]
        errors = " | ".join(
            f"{100 * row['error']:.2f}" + ("" if row["status"] == "converged" else f" ({row['status']})")
            for row in chosen
        )
        lines.append(f"| {case} | {gamma:g} | {chosen[0]['reference_drop']:.4f} | {errors} |")
    lines += ["", "Where the fold flattens, Γ:", "", "| beam and energy | from | to |", "|---|---|---|"]
    lines += [f"| {name} | {low:.3f} | {high:.3f} |" for name, (low, high) in result.findings["snaps"].items()]
    lines.append(f"| {SNAPPING}, finite elements | 2.2 | 2.3 |")
    return "\n".join(lines)


def finding(tables: list[Table]) -> str:
    """The largest error of both energies' whole meshes before the snap, that of MWTS, and where both snap."""
    errors, snaps = tables

    def largest(head: str) -> float:
        return max(number(r[head]) for r in errors if r["beam"] != SNAPPING or float(r["Γ"]) < PAST)

    whole = [largest(f"DS, {energy}") for energy in ENERGIES]
    warped = [largest(f"MWTS, {energy}") for energy in ENERGIES]
    places = {row["beam and energy"].rsplit(", ", 1)[1]: (row["from"], row["to"]) for row in snaps}
    snapped = {name: " to ".join(places[name]) if name in places else "nowhere" for name in ENERGIES}
    return (
        f"Before the snap whole meshes of Isotropic shells are {whole[0]:.2g} % off finite elements at most, of "
        f"calibrated hinges {whole[1]:.2g} %; MWTS on their modes {warped[0]:.2g} and {warped[1]:.2g} %. The wide beam "
        f"snaps at Γ = {snapped['Isotropic']} with Isotropic shells, {snapped['hinges']} with hinges, 2.2 to 2.3 with "
        "finite elements."
    )
