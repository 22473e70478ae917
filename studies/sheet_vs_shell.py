"""Where a sheet of springs is good enough: its displacement against discrete shells, over the load.

Four sheets, each clamped along one end, under gravity: a flat strip and a square cloth whose bending stiffness falls at
one gravity, from a board to a rag; and a V-beam and a curved panel under growing gravity. Springs take the shell's
shear stiffness along edges, and across hinges the stiffness that holds the hinge's energy at one reference change of
its fold angle (three are tried); the shell's area energy they do not have. A flat hinge resists its spring at fourth
order only, so no stiffness fits more than one curvature; a hinge folded at rest at second order, as in the shell.

The load is given as ``Gamma = 8 x (linear drop of the free end) / (free length)``; see ``v_beam_accuracy``. Timings are
those of a static answer, and of a step of 1/30 s: implicit Euler of the shell, and one linearised step of the springs,
both by factorisation.
"""

from __future__ import annotations

from collections.abc import Iterator
from time import perf_counter
from typing import Any

import numpy as np

import modalshell as ms
from modalshell.compare.report import percent
from modalshell.core.typing import Progress
from modalshell.files.study_result import StudyResult
from modalshell.models.base.full import FullModel
from modalshell.models.registry import TRUTH
from modalshell.springs import shell_springs
from studies.pages import counted, markdown, result_of

FIGURES = ("sheet_vs_shell",)

FOLDS = (0.05, 0.2, 0.8)
"""Reference changes of the fold angle [rad]."""
GRAVITY, MEMBRANE, DENSITY = 9.81, 200.0, 0.2
SOFT: dict[str, Any] = {"stretch": 20.0, "shear": 20.0, "flexure": 0.05}
GAMMAS = {
    "strip": tuple(4.0 ** np.arange(-1, 6)),
    "cloth": tuple(4.0 ** np.arange(-1, 6)),
    "v_beam": tuple(4.0 ** np.arange(-3, 3)),
    "panel": tuple(4.0 ** np.arange(-3, 3)),
}
LARGE = 256.0
"""Gamma of the load at which springs serve."""
DT, STEPS = 1.0 / 30.0, 5


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """All sheets, loads and reference folds; ``quick`` takes two loads, one fold and coarser meshes."""
    folds = FOLDS[1:2] if quick else FOLDS
    gammas = {name: found[1::4][:2] if quick else found for name, found in GAMMAS.items()}
    findings: dict[str, Any] = {}
    arrays: dict[str, np.ndarray] = {}
    for name, asked in counted(list(gammas.items()), on_step):
        rows = []
        start: np.ndarray | None = None
        for shell, gravity, gamma in cases(name, asked, quick):
            row, truth = compared(shell, gravity, folds, start)
            rows.append({"gamma": gamma} | row)
            start = truth if row["ds"]["converged"] else None
        findings[name] = rows
        arrays[f"{name}_faces"], arrays[f"{name}_last"] = np.asarray(shell.mesh.faces), truth
    return result_of("sheet_vs_shell", {"sheets": findings, "folds": folds}, arrays, quick=quick)


def mesh_of(name: str, quick: bool) -> ms.TriangleMesh:
    """The sheet's mesh, clamped end at x = 0."""
    if name == "cloth":
        return ms.sheet(cells=(8, 8) if quick else (16, 16))
    if name == "panel":
        return ms.cylinder_panel(radius=0.4, angle=60.0, cells=(10, 4) if quick else (20, 8))
    make = ms.v_beam if name == "v_beam" else ms.flat_beam
    return make(cells=(12, 4) if quick else (30, 6))


def cases(name: str, gammas: tuple[float, ...], quick: bool) -> Iterator[tuple[ms.Shell, float, float]]:
    """Shell, gravity [m/s^2] and Gamma of each load."""
    mesh = mesh_of(name, quick)
    columns = np.unique(mesh.vertices[:, 0].round(9))
    clamped = mesh.vertices[:, 0] < 0.5 * (columns[1] + columns[2])
    per_gravity = ms.measure.gamma_per_gravity
    if name in ("v_beam", "panel"):
        shell = ms.Shell(mesh, ms.Material(**SOFT, density=DENSITY), clamped)
        unit = per_gravity(shell)
        for gamma in gammas:
            yield shell, gamma / unit, gamma
        return
    flexure = 0.05
    for gamma in gammas:
        for _ in range(4):  # Gamma falls nearly as 1 / flexure
            shell = ms.Shell(mesh, ms.Material(MEMBRANE, MEMBRANE / 20.0, flexure, DENSITY), clamped)
            flexure *= GRAVITY * per_gravity(shell) / gamma
        yield shell, GRAVITY, gamma


def compared(
    shell: ms.Shell, gravity: float, folds: tuple[float, ...], start: np.ndarray | None
) -> tuple[dict[str, Any], np.ndarray]:
    """DS and the sheets of springs under one load: their answers, errors and times."""
    load: dict[str, Any] = {"gravity": (0.0, 0.0, -gravity)}
    truth = ms.DiscreteShell(shell)
    answer = truth.equilibrium(start=start, **load)
    if not answer.converged and start is not None:
        answer = truth.equilibrium(**load)
    ds = {"converged": answer.converged, "seconds": answer.seconds, "step": step_seconds(truth, answer, gravity)}
    found: dict[str, Any] = {"gravity": gravity, TRUTH: ds, "springs": []}
    for fold in folds:
        springs = shell_springs(shell, fold)
        sheet = ms.SpringSheet(shell, springs, integrator="linear_implicit")
        # From the shell's own answer, so that a sheet with several equilibria is given the nearest.
        own = sheet.equilibrium(start=answer.positions, **load)
        known = answer.converged and own.converged
        found["springs"].append(
            {
                "fold": fold,
                "status": own.status,
                "error": ms.measure.displacement_error(own.positions, answer.positions, shell) if known else None,
                "seconds": own.seconds,
                "step": step_seconds(sheet, own, gravity),
            }
        )
    return found, answer.positions


def step_seconds(model: FullModel, answer: Any, gravity: float) -> float:
    """Median seconds of a step from the answer, under a load that pushes it on."""
    state, times = model.start_motion(answer.positions), []
    load = model.shell.gravity_force((0.0, 0.0, -1.1 * gravity))
    for _ in range(STEPS):
        begin = perf_counter()
        state, _ = model.step(state, DT, load, ms.Damping(1.0))
        times.append(perf_counter() - begin)
    return float(np.median(times))


def table(result: StudyResult) -> str:
    """Table in Markdown: errors of each reference fold, and times, one row per load."""
    heads, lines = " | ".join(f"error, fold {fold:g}" for fold in result.findings["folds"]), []
    for name, rows in result.findings["sheets"].items():
        for row in rows:
            errors = ["no answer" if own["error"] is None else percent(own["error"], ".1f") for own in row["springs"]]
            median = {f"median_{key}": np.median([own[key] for own in row["springs"]]) for key in ("seconds", "step")}
            lines.append({**row, **median, "sheet": name, "errors": errors})
    return markdown(
        f"sheet | Γ | {heads} | static [s]: DS | springs | step [ms]: DS | springs",
        "{sheet} | {gamma:.3g} | {errors} | {ds[seconds]:.2f} | {median_seconds:.2f} | {ds[step]:1e3*.1f} "
        "| {median_step:1e3*.1f}",
        lines,
    )


def finding(result: StudyResult) -> str:
    """Errors of a strip at the least and at a large load."""
    strip = {row["gamma"]: [own["error"] for own in row["springs"]] for row in result.findings["sheets"]["strip"]}
    first, last = min(strip), max(gamma for gamma in strip if gamma <= LARGE)
    least, large = ([error for error in strip[gamma] if error is not None] for gamma in (first, last))
    return (
        f"A strip of springs is off discrete shells by {max(least):.0f} times their displacement at Γ = {first:g}, by "
        f"{100 * min(large):.2g} to {100 * max(large):.2g} % at Γ = {last:g}, whatever its springs across hinges: "
        "springs serve as cloth."
    )
