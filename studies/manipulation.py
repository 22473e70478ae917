"""Paper Fig. 7: a flat beam led by its tip: by position, by orientation, and by both.

One end is clamped; the target of the tip moves from rest to its place within a second and stays. MWTS follows by the
least modal forces and is left to settle; its static answer is found for itself. DS answers the same constraints where
it can: it moves vertices, so an orientation alone says nothing to it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

import modalshell as ms
from modalshell.compare.report import percent
from modalshell.core.typing import Progress
from modalshell.files.study_result import StudyResult
from studies.pages import at_most, counted, markdown, result_of

FIGURES = ("figure_7",)

LENGTH, WIDTH, MEMBRANE, FLEXURE, DENSITY = 1.0, 0.2, 60.0, 0.1, 0.2
MODES, DT, DURATION, DAMPING = 12, 1.0 / 30.0, 4.0, (1.0, 0.01)
LEADING = 1.0
"""Time [s] in which the target moves."""
CASES: dict[str, tuple[tuple[float, float, float] | None, tuple[float, float] | None]] = {
    # position [m]; rotation [degrees] about the beam (x), then upwards (-y)
    "position": ((0.738, 0.0, 0.566), None),
    "orientation": (None, (0.0, 75.0)),
    "both": ((0.65, 0.0, 0.55), (0.0, 75.0)),
    "position, aside": ((0.8, 0.12, 0.5), None),
    "orientation, twisted": (None, (80.0, 0.0)),
    "both, twisted": ((0.77, 0.0, 0.45), (60.0, 60.0)),
}


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """Lead the beam to six targets; ``quick`` takes a coarser mesh."""
    cells = (16, 4) if quick else (40, 8)
    mesh = ms.flat_beam(length=LENGTH, width=WIDTH, cells=cells)
    material = ms.Material(MEMBRANE, MEMBRANE, FLEXURE, DENSITY)
    shell = ms.Shell(mesh, material, clamped=mesh.vertices[:, 0] < 1.5 * LENGTH / cells[0])
    basis = ms.solve_modes(shell, MODES)
    model = ms.ModalWarping(basis, integrator="implicit_euler")
    tip = int(np.argmin(np.linalg.norm(mesh.vertices - [LENGTH, 0.0, 0.0], axis=1)))
    rows = []
    arrays = {"faces": mesh.faces, "rest": mesh.vertices, "tip": np.array(tip)}
    for number, (name, (position, angles)) in counted(list(enumerate(CASES.items(), start=1)), on_step):
        turn = None if angles is None else upwards(*angles)
        static = model.equilibrium(constraints=constraints(tip, mesh.vertices[tip], position, turn))
        led = constraints(tip, mesh.vertices[tip], position, turn, leading=LEADING)
        run = ms.simulate(model, duration=DURATION, dt=DT, damping=DAMPING, constraints=led)
        assert static.coordinates is not None
        row = {
            "case": name,
            "position": position,
            "rotation_vector": turn,
            "status": static.status,
            "residuals": static.constraint_residuals,
            "modal_energy": 0.5 * float(basis.eigenvalues @ static.coordinates**2),
            "area_change": ms.measure.area_change(static.positions, mesh),
            "motion_status": run.status,
            "motion_residual": float(run.constraint_residuals.max()),
            "settled_apart": float(np.abs(run.positions[-1] - static.positions).max()) / LENGTH,
            "frames_per_second": (len(run.times) - 1) / run.seconds,
        }
        key = f"case_{number}"
        arrays |= {f"{key}_mwts": static.positions, f"{key}_motion": run.positions.astype(np.float32)}
        arrays[f"{key}_turn"] = (basis.rotations @ static.coordinates).reshape(-1, 3)[tip]
        if position is not None:
            truth = ms.DiscreteShell(shell).equilibrium(
                constraints=constraints(tip, mesh.vertices[tip], position, turn), start=None
            )
            row |= {
                "ds_status": truth.status,
                "ds_energy": shell.energy(truth.positions),
                "error": ms.measure.displacement_error(static.positions, truth.positions, shell),
            }
            arrays[f"{key}_ds"] = truth.positions
        rows.append(row)
    findings = {"vertices": len(mesh.vertices), "frequencies_hz": basis.frequencies, "rows": rows}
    return result_of("manipulation", findings, arrays, cells=cells)


def upwards(twist: float, lift: float) -> list[float]:
    """Rotation vector [rad] of a twist about x and then a lift about -y [degrees]."""
    turn = Rotation.from_euler("y", -lift, degrees=True) * Rotation.from_euler("x", twist, degrees=True)
    return [float(value) for value in turn.as_rotvec()]


def constraints(
    tip: int,
    rest: np.ndarray,
    position: tuple[float, float, float] | None,
    turn: list[float] | None,
    leading: float = 0.0,
) -> list[ms.PositionConstraint | ms.OrientationConstraint]:
    """The constraints on the tip; with ``leading`` [s] their targets move smoothly from rest to their place."""

    def led(start: np.ndarray, end: np.ndarray) -> Callable[[float], np.ndarray]:
        def target(time: float) -> np.ndarray:
            share = min(time / leading, 1.0)
            return start + share**2 * (3.0 - 2.0 * share) * (end - start)

        return target

    given: list[ms.PositionConstraint | ms.OrientationConstraint] = []
    if position is not None:
        place = np.array(position)
        given.append(ms.PositionConstraint(tip, led(rest, place) if leading else place))
    if turn is not None:
        rotation = np.array(turn)
        given.append(ms.OrientationConstraint(tip, led(np.zeros(3), rotation) if leading else rotation))
    return given


def table(result: StudyResult) -> str:
    """The findings as a Markdown table."""
    rows = result.findings["rows"]
    apart, slowest = max(row["settled_apart"] for row in rows), min(row["frames_per_second"] for row in rows)
    answers = markdown(
        "constraint | static residual | in motion | modal energy [J] | DS energy [J] | MWTS error | area change",
        "{case} | {largest:.0e} | {motion_residual:.0e} | {modal_energy:.3f} | {ds_energy:.3f|no counterpart} "
        "| {apart} | {area_change:100*+.1f} %",
        [
            {"ds_energy": None} | row | {"largest": max(row["residuals"]), "apart": percent(row.get("error"), ".1f")}
            for row in rows
        ],
    )
    return (
        f"{answers}\n\n"
        "Residuals in m and rad (the beam is 1 m long). After their targets stand still, motions settle within "
        f"{100 * apart:.2g} % of the length of the static answers; the slowest ran at {slowest:.0f} frames a second. "
        "Modal warping draws a bent beam in where DS keeps its length: a tip held in place and turned is pulled out by "
        "in-plane modes, which is what the modal energy of 'both' pays for."
    )


def finding(result: StudyResult) -> str:
    """How well targets are met, and how far the shapes are from those of DS."""
    rows = result.findings["rows"]
    errors = [100 * row["error"] for row in rows if "error" in row]
    return (
        f"All {len(rows)} targets of position and orientation are met in motion within "
        f"{at_most(max(row['motion_residual'] for row in rows), 1)} (m, rad). Shapes "
        f"under the same position target are {min(errors):.0f} to {max(errors):.0f} % off DS."
    )
