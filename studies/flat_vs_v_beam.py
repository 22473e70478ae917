"""Paper Fig. 4: how a fold stiffens a beam. Flat and V-beams at flexure x1, x10, x100, by MWTS with 8 modes.

A fold carries bending by its membrane, a flat beam by its flexure alone: the flat beam's drop falls with the flexural
stiffness, the V-beam's hardly, until flexure is as stiff as the fold. Every MWTS shape is compared with DS.
"""

from __future__ import annotations

from typing import Any

import numpy as np

import modalshell as ms
from modalshell.compare.report import percent
from modalshell.core.typing import Progress
from modalshell.files.study_result import StudyResult
from studies.pages import counted, markdown, result_of

FIGURES = ("figure_4",)

FOLDS = {"flat": 180.0, "v": 120.0}
FACTORS = (1.0, 10.0, 100.0)
LENGTH, WIDTH, MEMBRANE, FLEXURE, DENSITY = 1.0, 0.2, 60.0, 0.01, 0.2
GRAVITY, MODES = 10.0, 8


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """Solve the three pairs; ``quick`` takes a coarser mesh."""
    cells = (20, 4) if quick else (40, 8)
    rows: list[dict[str, Any]] = []
    arrays: dict[str, np.ndarray] = {}
    cases = [(factor, name) for factor in FACTORS for name in FOLDS]
    for factor, name in counted(cases, on_step):
        mesh = ms.v_beam(length=LENGTH, width=WIDTH, fold=FOLDS[name], cells=cells)
        material = ms.Material(MEMBRANE, MEMBRANE, FLEXURE * factor, DENSITY)
        shell = ms.Shell(mesh, material, clamped=mesh.vertices[:, 0] < 1.5 * LENGTH / cells[0])
        basis = ms.solve_modes(shell, MODES)
        gravity = (0.0, 0.0, -GRAVITY)
        warped = ms.ModalWarping(basis).equilibrium(gravity=gravity)
        truth = ms.DiscreteShell(shell).equilibrium(gravity=gravity, start=warped.positions)
        tip = int(np.argmin(np.linalg.norm(mesh.vertices - [LENGTH, 0.0, 0.0], axis=1)))
        rows.append(
            {
                "beam": name,
                "fold_degrees": FOLDS[name],
                "flexure_factor": factor,
                "frequencies_hz": basis.frequencies,
                "mwts_tip_drop": -warped.positions[tip, 2],
                "mwts_status": warped.status,
                "ds_tip_drop": -truth.positions[tip, 2],
                "ds_status": truth.status,
                "mwts_error": ms.measure.displacement_error(warped.positions, truth.positions, shell),
            }
        )
        key = f"{name}_x{factor:g}"
        arrays |= {f"{key}_mwts": warped.positions, f"{key}_ds": truth.positions}
        arrays |= {f"{name}_faces": mesh.faces, f"{name}_rest": mesh.vertices}
    return result_of("flat_vs_v_beam", {"rows": rows}, arrays, cells=cells)


def table(result: StudyResult) -> str:
    """The findings as a Markdown table."""
    return markdown(
        "beam | flexure | first frequency [Hz] | tip drop, MWTS [L] | tip drop, DS [L] | MWTS error",
        "{beam} ({fold_degrees:g}°) | x{flexure_factor:g} | {frequencies_hz[0]:.3f} | {mwts_tip_drop:.3f} "
        "| {ds_tip_drop:.3f} | {mwts_error:100*.1f} %",
        result.findings["rows"],
    )


def finding(result: StudyResult) -> str:
    """What the fold gains at the least and at the largest flexure."""
    rows = result.findings["rows"]
    drops, errors = ([row[key] for row in rows] for key in ("ds_tip_drop", "mwts_error"))
    least, most = rows[0]["flexure_factor"], rows[-1]["flexure_factor"]
    return (
        f"With flexure x{least:g} the flat beam drops {drops[0] / drops[1]:.1f} times as far as "
        f"the V-beam, with x{most:g} {drops[-2] / drops[-1]:.1f} times: the fold carries bending by "
        f"its membrane until flexure is as stiff. MWTS is {percent(max(errors), '.1f')} off DS at the largest drop, "
        f"{percent(min(errors), '.1f')} at the smallest."
    )
