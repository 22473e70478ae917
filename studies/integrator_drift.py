"""Drift of the summed warp over closed load cycles: the paper's eq. 16 read as a sum, against the closed form.

A V-beam and a strip are loaded and unloaded in cycles that leave rest and return to it, through static equilibria. On a
*line* one load grows and falls again: the modal coordinates come back the way they went. On a *loop* two loads grow and
fall out of phase, so that the coordinates enclose an area. What is left at rest, the drift, has two parts. The *step's*
part vanishes with the step at first order. The *path's* part does not: the sum approximates the integral of
``R(Psi q) Phi dq`` along the path, which depends on more than its ends, so a loop drifts however small the step. The
closed form depends on q alone and returns to rest.

The same two loads are also applied and taken away again in damped motion, at a frame's step and finer ones, by implicit
Euler, the paper's rule.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NoReturn, final

import numpy as np

import modalshell as ms
from modalshell.core.typing import Progress
from modalshell.files.study_result import StudyResult
from modalshell.integrators.modal import ModalIntegrator
from modalshell.integrators.modal.base import DeadForce, ForceInTime
from modalshell.integrators.state import MotionState
from modalshell.kernels import rotations
from modalshell.models.base.modal import ModalModel
from modalshell.motion import Motion
from studies.pages import at_most, counted, markdown, paragraphs, result_of

FIGURES = ("integrator_drift",)

LENGTH, WIDTH = 1.0, 0.2
FLEXURE, DENSITY, MODES = 0.05, 0.2, 8
MEMBRANE = {"v_beam": 20.0, "strip": 200.0}
LOADS = {"v_beam": {"gravity": 8.0, "side": 40.0}, "strip": {"twist": 0.4, "gravity": 5.0}}
"""First the load of the line; the loop takes both. Gravity and side in m/s^2, twist a couple on the free end in N m."""
PATHS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "line": lambda phase: np.column_stack([0.5 - 0.5 * np.cos(phase), 0.0 * phase]),
    "loop": lambda phase: np.column_stack([0.5 - 0.5 * np.cos(phase), np.sin(phase)]),
}
"""Factors of the two loads over one cycle's phase from 0 to 2 pi."""
FINEST, CYCLES = 1024, 20
CYCLED_STEPS = (16, 64, 256)
"""Steps in a cycle of the runs over many cycles."""
MOTION_STEP, MOTION_DAMPING, MOTION_TIME = 1.0 / 30.0, (4.0, 0.0), 16.0
"""Step [s], Rayleigh factors, and time [s] under the load and as long again without it."""


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """Both scenes and paths; ``quick`` takes a coarser mesh and larger steps."""
    cells, finest = ((16, 4), FINEST // 4) if quick else ((40, 8), FINEST)
    findings: dict[str, Any] = {}
    arrays: dict[str, np.ndarray] = {}
    for scene, loads in counted(list(LOADS.items()), on_step):
        basis = scene_basis(scene, cells)
        forces = [load_of(basis.shell, kind, size) for kind, size in loads.items()]
        findings[scene] = {}
        for path, factors in PATHS.items():
            coordinates = equilibrium_path(basis, forces, factors(np.linspace(0.0, 2.0 * np.pi, finest + 1)))
            arrays[f"{scene}_{path}_coordinates"] = coordinates
            findings[scene][path] = drift_findings(basis, coordinates)
        refinements = (1, 2) if quick else (1, 2, 4, 8, 16)
        findings[scene]["motion"] = motion_findings(basis, np.sum(forces, axis=0), refinements)
    return result_of("integrator_drift", findings, arrays, cells=cells, finest=finest)


@final
class SummedWarp(ModalModel):
    """MWTS with [choi2007, eq. 16] as a sum: every step adds ``R(w) Phi dq``, so that the shape depends on the path.

    Its coordinates move as those of the closed form. It takes no constraints and has no statics.
    """

    name = "MWTS, summed warp"
    conservative = False

    def __init__(self, basis: ms.Basis, *, integrator: str | ModalIntegrator = "exponential") -> None:
        super().__init__(basis, integrator=integrator)
        self.closed = ms.ModalWarping(basis, integrator=integrator)

    def warped(self, q: np.ndarray) -> np.ndarray:
        """Displacements (n, 3) [m] of the closed form, which every motion starts from."""
        return self.closed.raw_displacement(q)

    def warped_force(self, q: np.ndarray, load: np.ndarray) -> np.ndarray:
        """Modal force (m,) of the closed form."""
        return self.closed.modal_force(q, load)

    def start_motion(self, positions: np.ndarray | None = None) -> MotionState:
        """Modal state at rest."""
        state = super().start_motion(positions)
        state.memory["sum"] = self.raw_displacement(state.coordinates)
        return state

    def march(
        self,
        state: MotionState,
        dt: float,
        force: ForceInTime,
        damping: ms.Damping,
        dead: DeadForce | None = None,
    ) -> tuple[MotionState, bool]:
        """One step of the integrator, and of the sum."""
        after, solved = super().march(state, dt, force, damping, dead)
        return self.summed(state, after), solved

    def summed(self, state: MotionState, after: MotionState) -> MotionState:
        """``after``, a state that follows ``state``, with its displacement; this grows by ``R(w) Phi dq``."""
        change = np.asarray(self.basis.modes @ (after.coordinates - state.coordinates)).reshape(-1, 3)
        turned = np.empty_like(change)
        rotations.rotate(self.closed.rotation_vectors(after.coordinates), change, 1.0, turned)
        return MotionState(after.coordinates, after.rates, after.memory | {"sum": state.memory["sum"] + turned})

    def positions(self, state: MotionState) -> np.ndarray:
        """Vertex positions (n, 3) [m] of a state: the sum so far."""
        return np.asarray(self.shell.rest_positions + state.memory["sum"])

    def fault(self, state: MotionState, positions: np.ndarray) -> ms.Outcome | None:
        """Say where the state has wound up, as the closed form does."""
        return self.closed.fault(state, positions)

    def _free_statics(self, load: np.ndarray, start: np.ndarray | None) -> NoReturn:  # noqa: ARG002
        raise ms.OptionError("the summed warp depends on the path, so it has no statics: ask its closed form")


def scene_basis(scene: str, cells: tuple[int, int]) -> ms.Basis:
    """Modes of the V-beam or the flat strip, clamped at one end."""
    make = ms.v_beam if scene == "v_beam" else ms.flat_beam
    mesh = make(length=LENGTH, width=WIDTH, cells=cells)
    material = ms.Material(MEMBRANE[scene], MEMBRANE[scene], FLEXURE, DENSITY)
    return ms.solve_modes(ms.Shell(mesh, material, clamped=mesh.vertices[:, 0] < 1.5 * LENGTH / cells[0]), MODES)


def load_of(shell: ms.Shell, kind: str, size: float) -> np.ndarray:
    """Forces (n, 3) [N] of a whole load: gravity down or sideways, or a couple that twists the free end."""
    if kind != "twist":
        return shell.gravity_force((0.0, 0.0, -size) if kind == "gravity" else (0.0, size, 0.0))
    x, y = shell.rest_positions[:, :2].T
    arm = np.where(x > LENGTH - 1e-9, y, 0.0)
    return np.outer(size * arm / np.sum(arm**2), (0.0, 0.0, 1.0))


def equilibrium_path(basis: ms.Basis, forces: list[np.ndarray], factors: np.ndarray) -> np.ndarray:
    """Modal coordinates (k, m) of the static equilibria under ``factors`` (k, 2) of the two loads."""
    model = ms.ModalWarping(basis)
    path = np.zeros((len(factors), basis.count))
    for row, pair in zip(path, factors, strict=True):
        answer = model.equilibrium(force=pair[0] * forces[0] + pair[1] * forces[1])
        if not answer.converged or answer.coordinates is None:
            raise ms.SolverError(f"no equilibrium at load factors {pair}: {answer.status}")
        row[:] = answer.coordinates
    return path


def carry(model: SummedWarp, path: np.ndarray, cycles: int) -> np.ndarray:
    """Displacements (cycles, n, 3) [m] that the sum is left with after each passage of a closed path of coordinates."""
    state = model.start_motion()
    left = []
    for _ in range(cycles):
        for q in path[1:]:
            state = model.summed(state, MotionState(q, state.rates))
        left.append(model.positions(state) - model.shell.rest_positions)
    return np.array(left)


def size_of(displacements: np.ndarray) -> np.ndarray:
    """Largest displacement of a vertex [L] in arrays (..., n, 3)."""
    return np.asarray(np.linalg.norm(displacements, axis=-1).max(axis=-1) / LENGTH)


def drift_findings(basis: ms.Basis, path: np.ndarray) -> dict[str, Any]:
    """Drift of both readings after one cycle, over the step, and after many cycles."""
    summed, closed = SummedWarp(basis), ms.ModalWarping(basis)
    finest = len(path) - 1
    steps = [finest // 2**k for k in range(int(np.log2(finest)) - 2)][::-1]
    left = np.array([carry(summed, path[:: finest // count], 1)[0] for count in steps])
    # First order in the step: the two finest runs give the limit, and leave it an error of second order.
    limit = 2.0 * left[-1] - left[-2]
    step_part = size_of(left - limit)
    return {
        "steps": steps,
        "drift": size_of(left),
        "path_part": float(size_of(limit)),
        "step_part": step_part,
        # The limit is taken from the last two runs, so the order is read from the two before.
        "order": float(np.log2(step_part[-4] / step_part[-3])),
        "largest_displacement": max(float(size_of(closed.displacement(q))) for q in path[:: finest // 16]),
        "cycled": {
            str(count): {
                "sum": size_of(carry(summed, path[:: finest // count], CYCLES)),
                "closed_form": np.full(CYCLES, size_of(closed.displacement(path[-1]))),
            }
            for count in CYCLED_STEPS
        },
    }


def motion_findings(basis: ms.Basis, force: np.ndarray, refinements: tuple[int, ...]) -> list[dict[str, float]]:
    """Drift of both readings after the loads are put on and taken away at once, in damped motion."""
    rows = []
    for refinement in refinements:
        row = {"step": MOTION_STEP / refinement}
        for warp, build in (("sum", SummedWarp), ("closed_form", ms.ModalWarping)):
            model = build(basis, integrator="implicit_euler")
            motion = Motion(model, basis.shell.loading(force=force), dt=row["step"], damping=MOTION_DAMPING)
            count = round(MOTION_TIME / row["step"])
            for _ in range(count):
                motion.advance()
            motion.load = np.zeros_like(force)
            for _ in range(count):
                motion.advance()
            row[warp] = float(size_of(motion.positions() - model.shell.rest_positions))
        rows.append(row)
    return rows


def largest_of_closed_form(found: dict[str, Any]) -> float:
    """Largest drift [L] of the closed form on a path."""
    return max(max(found["cycled"][str(count)]["closed_form"]) for count in CYCLED_STEPS)


def table(result: StudyResult) -> str:
    """Tables in Markdown: cycles through equilibria, then the same loads in motion."""
    cycles, motions = [], []
    for scene in LOADS:
        for path in PATHS:
            found = result.findings[scene][path]
            cycled = [found["cycled"][str(count)]["sum"] for count in CYCLED_STEPS]
            own = {"scene": scene, "path": path, "one": [run[0] for run in cycled], "many": cycled[1][-1]}
            cycles.append({**found, **own, "closed": largest_of_closed_form(found)})
        motions += [{**row, "scene": scene, "rate": 1.0 / row["step"]} for row in result.findings[scene]["motion"]]
    return paragraphs(
        markdown(
            "scene | path | largest displacement [L] | drift of the sum in one cycle [L]: 16 steps | 64 | 256 "
            f"| in the limit | order in the step | after {CYCLES} cycles of 64 | closed form, largest",
            "{scene} | {path} | {largest_displacement:.3f} | {one:.2e} | {path_part:.1e} | {order:.2f} "
            "| {many:.2e} | {closed:.0e}",
            cycles,
        ),
        "Both loads put on and taken away at once, in damped motion:",
        markdown(
            "scene | step [s] | drift of the sum [L] | closed form",
            "{scene} | 1/{rate:.0f} | {sum:.2e} | {closed_form:.0e}",
            motions,
        ),
    )


def finding(result: StudyResult) -> str:
    """What the summed warp leaves at rest after one cycle."""
    found = result.findings
    limits = [f"{100 * found[scene]['loop']['path_part']:.2g} % of the length ({scene})" for scene in LOADS]
    closed = max(largest_of_closed_form(found[scene][path]) for scene in LOADS for path in PATHS)
    return (
        f"After one cycle of two loads out of phase the warp that is summed step by step is off the rest shape by "
        f"{' and '.join(limits)} however small the step; the closed form returns to it within {at_most(closed, 1)}."
    )
