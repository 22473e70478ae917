"""Paper Fig. 5 and 6: LMA, MWTS and DS on a V-beam under growing gravity.

Two regimes. *Soft membrane*, the paper's: the fold keeps its shape and the beam bends smoothly; MWTS follows DS with an
error that grows with the load, LMA inflates. *Stiff membrane*: the fold flattens like a tape spring's and the beam
snaps; no model on rest modes follows DS there. The path of equilibria is followed through that: where the straight
beam turns unstable to twisting (a bifurcation), where the twisted states end (a limit point), and from which load on
the flattened beam is stable.

Gravity is given as Gamma = (weight per length) L^3 / EI, see :func:`modalshell.measure.gamma_per_gravity`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

import modalshell as ms
from modalshell.compare.path import Marks
from modalshell.compare.report import percent
from modalshell.core.typing import Progress
from modalshell.files.study_result import StudyResult
from modalshell.models.registry import TRUTH
from modalshell.modes import lowest_tangent_eigenvalue
from studies.pages import counted, markdown, paragraphs, result_of

FIGURES = ("figure_5", "figure_6a", "figure_6b")

SHAPE = {"length": 1.0, "width": 0.2, "fold": 150.0}
REGIMES: dict[str, dict[str, Any]] = {
    "soft": {"membrane": 20.0, "gravities": [0.5, 1, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20]},
    "stiff": {"membrane": 2000.0, "gravities": [5, 10, 15, 20, 25, 30, 35, 40, 45, 50, 60, 70]},
}
LINEAR, WARPED = ms.models()["lma"], ms.models()["mwts"]
FLEXURE = 0.05
DENSITY = 0.2
MODES = 8
MARKS = ("bifurcation", "limit", "stable_again")
"""Marks of the path of equilibria: where it turns unstable aside, where stable states end, and begin again."""


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """Sweep both regimes; ``quick`` takes a coarser mesh and fewer loads."""
    cells = (20, 4) if quick else (40, 8)
    stride = 3 if quick else 1
    findings: dict[str, Any] = {}
    arrays: dict[str, np.ndarray] = {}
    for name, regime in counted(list(REGIMES.items()), on_step):
        mesh = ms.v_beam(**SHAPE, cells=cells, family="alternating")
        material = ms.Material(regime["membrane"], regime["membrane"], FLEXURE, DENSITY)
        clamped = mesh.vertices[:, 0] < 1.5 * SHAPE["length"] / cells[0]
        shell = ms.Shell(mesh, material, clamped=clamped)
        basis = ms.solve_modes(shell, MODES)
        linear, warping, truth = ms.LinearModal(basis), ms.ModalWarping(basis), ms.DiscreteShell(shell)
        gamma, unit = ms.measure.gamma_per_gravity(shell), shell.gravity_force((0.0, 0.0, -1.0))
        tip = int(np.argmin(np.linalg.norm(mesh.vertices - [SHAPE["length"], 0.0, 0.0], axis=1)))
        rows, last, most = [], mesh.vertices, max(regime["gravities"])
        path = ms.equilibrium_path(shell, force=unit, until=most, branches=1)
        snap = snap_of(Marks.of(path), gamma)
        findings[f"{name}_path"] = {"converged": path.converged, "events": path.events}
        for gravity in regime["gravities"][::-stride][::-1]:
            answers = {
                LINEAR.key: linear.equilibrium(gravity=(0, 0, -gravity)),
                WARPED.key: warping.equilibrium(gravity=(0, 0, -gravity)),
                TRUTH: truth.equilibrium(gravity=(0, 0, -gravity), start=last),
            }
            exact = answers[TRUTH].positions
            row: dict[str, Any] = {"gravity": gravity, "gamma": gamma * gravity}
            for model, answer in answers.items():
                row |= {
                    f"{model}_tip_z": answer.positions[tip, 2],
                    f"{model}_area_change": ms.measure.area_change(answer.positions, mesh),
                    f"{model}_status": answer.status,
                }
                if model != TRUTH:
                    moved = answer.positions
                    row[f"{model}_error"] = ms.measure.displacement_error(moved, exact, shell, weighted=False)
                    row[f"{model}_error_mass"] = ms.measure.displacement_error(moved, exact, shell)
                arrays[f"{name}_{model}_{gravity:g}"] = answer.positions
            row["ds_iterations"] = answers[TRUTH].iterations
            row["lowest_tangent_ratio"] = lowest_tangent_eigenvalue(shell, exact) / basis.eigenvalues[0]
            row["after_snap"] = snap is not None and gravity > snap["gravity"]
            rows.append(row)
            last = exact
        findings[name] = {"rows": rows, "snap": snap, "gamma_per_gravity": gamma, "frequencies_hz": basis.frequencies}
        arrays |= {f"{name}_faces": mesh.faces, f"{name}_rest": mesh.vertices}
    return result_of("v_beam_accuracy", findings, arrays, cells=cells)


def snap_of(marks: Marks, gamma: float) -> dict[str, float | None] | None:
    """Where the stable states end, as gravity and as Gamma, and the marks on the way as Gamma; None if they go on."""
    if marks.snap is None:
        return None
    places = {"bifurcation": marks.bifurcation, "limit": marks.limit, "stable_again": marks.stable_again}
    scaled = {key: None if place is None else gamma * place for key, place in places.items()}
    return {"gravity": marks.snap, "gamma": gamma * marks.snap} | scaled


def table(result: StudyResult) -> str:
    """The findings as a Markdown table, one row per load."""
    compared, rows = [LINEAR, WARPED, ms.models()[TRUTH]], []
    for regime in REGIMES:
        for row in result.findings[regime]["rows"]:
            areas = [f"{100 * row[f'{spec.key}_area_change']:+.2f} %" for spec in compared]
            rows.append({**row, "regime": f"{regime}{', snapped' if row['after_snap'] else ''}", "areas": areas})
    names = " | ".join(spec.name for spec in compared)
    loads = markdown(
        f"membrane | Γ | DS ridge tip [L] | LMA error | MWTS error | area: {names} | tangent",
        "{regime} | {gamma:.3f} | {ds_tip_z:.3f} | {lma_error:100*.1f} % | {mwts_error:100*.1f} % | {areas} "
        "| {lowest_tangent_ratio:.2f}",
        rows,
    )
    words = "Tangent: lowest eigenvalue about the deformed state over the first one at rest; a snap nears as it falls."
    stiff = result.findings["stiff"]["snap"]
    if stiff is not None:
        marks = [f"{key.replace('_', ' ')} at Γ = {stiff[key]:.4f}" for key in MARKS if stiff[key] is not None]
        words = f"The path of equilibria of the stiff beam: {', '.join(marks)}.\n\n{words}"
    return paragraphs(loads, words)


def finding(result: StudyResult) -> str:
    """Errors at the largest load of the soft beam, and where the stiff one snaps."""
    soft, stiff = (result.findings[regime]["rows"] for regime in REGIMES)
    before = [row for row in stiff if not row["after_snap"]][-1]
    snapped = next(row for row in stiff if row["after_snap"])
    last = soft[-1]
    return (
        f"With a soft membrane MWTS is {percent(last['mwts_error'], '.1f')} off DS at Γ = {last['gamma']:.0f}, "
        f"LMA {percent(last['lma_error'], '.1f')}. With a stiff one the fold flattens and the beam snaps between "
        f"Γ = {before['gamma']:.3f} and {snapped['gamma']:.3f}; then MWTS is "
        f"{percent(snapped['mwts_error'], '.1f')} off."
    )
