"""One rung on one case, measured: its answers over the load range against those of DS, and what they cost."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np

from modalshell import measure
from modalshell.compare.candidates import Candidate, Workshop
from modalshell.compare.case import Case
from modalshell.compare.path import LoadPath
from modalshell.mesh import TriangleMesh
from modalshell.models import Equilibrium, Model
from modalshell.timings import Stopwatch
from modalshell.typing import Array

_FRAMES, _FEWEST, _UNTIMED = 48, 4, 2
_FRAME_BUDGET = 4.0
"""Seconds after which no more frames are timed."""


@dataclass(frozen=True)
class Row:
    """One rung at one size, measured.

    Attributes
    ----------
    rung, size, label : str
        Which one.
    quadratic : bool
        Whether its elastic energy is quadratic in modes about rest.
    preprocessing : float
        Time to build the model [s], its modes included.
    frame_ms : float
        Median time of a step and its positions [ms], in motion from rest under the whole load.
    statics : float
        Time of all static answers [s].
    errors : list of float or None
        Relative displacement error against DS at each load; None where DS or the rung has no answer.
    area_errors : list of float or None
        Relative area less that of DS.
    tip_turns : list of float or None
        Turn [degrees] of the surface at the vertex that DS moves most.
    statuses : list of str
        Outcome of each static answer.
    frequency : float or None
        Lowest frequency about the last state that DS knows, over that of DS at rest; 0 where that state is unstable,
        None for rungs that cannot tell.
    motion : str
        Outcome of the timed motion.
    missed : bool
        Whether the rung has no answer at a load where DS has one, or its motion left the finite numbers.
    positions : ndarray, shape (n, 3)
        Under the whole load [m].
    outside_error : float or None
        Relative displacement error under the whole load against an outside solution, where one was given.
    """

    rung: str
    size: str
    label: str
    quadratic: bool
    preprocessing: float
    frame_ms: float
    statics: float
    errors: list[float | None]
    area_errors: list[float | None]
    tip_turns: list[float | None]
    statuses: list[str]
    frequency: float | None
    motion: str
    missed: bool
    positions: Array = field(repr=False)
    outside_error: float | None = None

    @property
    def frames_per_second(self) -> float:
        """Frames in a second."""
        return 1000.0 / self.frame_ms

    @property
    def worst_error(self) -> float | None:
        """Largest error over the load range; None if the rung has no answer at a load where DS has one."""
        known = [error for error in self.errors if error is not None]
        return None if self.missed or not known else max(known)

    @property
    def final_error(self) -> float | None:
        """Error under the largest load that DS has an answer for."""
        known = [error for error in self.errors if error is not None]
        return None if self.missed or not known else known[-1]


def measure_row(
    candidate: Candidate, workshop: Workshop, path: LoadPath, tip: int, outside: Array | None = None
) -> Row:
    """Build the rung, find its answers at the loads of ``path``, and time its frames.

    ``tip`` is the vertex whose turn is told; ``outside`` (n, 3) [m] an outside solution under the whole load.
    """
    case = workshop.case
    shell, mesh = case.shell, case.shell.mesh
    model, preprocessing = workshop.build(candidate)
    watch = Stopwatch()
    answers = path.answers
    if candidate.rung != "DS":
        answers = [model.equilibrium(force=factor * case.load) for factor in path.factors]
    statics = watch() if candidate.rung != "DS" else sum(answer.seconds for answer in answers)
    errors: list[float | None] = []
    areas: list[float | None] = []
    turns: list[float | None] = []
    for answer, exact in zip(answers, path.answers, strict=True):
        both = answer.converged and exact.converged
        errors.append(measure.displacement_error(answer.positions, exact.positions, shell) if both else None)
        areas.append(area_difference(answer, exact, mesh) if both else None)
        turns.append(turn_at(answer.positions, mesh, tip) if answer.converged else None)
    frame_ms, motion = timed_frames(model, case)
    known = path.known
    frequency = None
    if known and answers[known[-1]].converged:
        factor = path.factors[known[-1]]
        found = model.tangent_eigenvalue(answers[known[-1]], factor * case.load)
        frequency = None if found is None else float(np.sqrt(max(found, 0.0) / path.lowest))
    missed = any(not answers[k].converged for k in known) or motion.startswith("diverged")
    return Row(
        candidate.rung,
        candidate.size,
        candidate.label,
        candidate.quadratic,
        preprocessing,
        frame_ms,
        statics,
        errors,
        areas,
        turns,
        [answer.status for answer in answers],
        frequency,
        motion,
        missed,
        answers[-1].positions,
        None if outside is None else measure.displacement_error(answers[-1].positions, outside, shell),
    )


def area_difference(answer: Equilibrium, exact: Equilibrium, mesh: TriangleMesh) -> float:
    """Relative area of an answer less that of the exact one."""
    return measure.area_change(answer.positions, mesh) - measure.area_change(exact.positions, mesh)


def turn_at(positions: Array, mesh: TriangleMesh, vertex: int) -> float:
    """Angle [degrees] between the surface's normals at ``vertex`` at rest and now."""
    faces = mesh.faces[(mesh.faces == vertex).any(axis=1)]

    def normal(points: Array) -> Array:
        corners = points[faces]
        total = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(axis=0)
        return np.asarray(total / max(float(np.linalg.norm(total)), 1e-300))

    before, after = normal(np.asarray(mesh.vertices)), normal(positions)
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(before, after)), before @ after)))


def timed_frames(model: Model, case: Case) -> tuple[float, str]:
    """Median time of a frame [ms] in motion from rest under the whole load, and how that motion went."""
    state = model.start_motion()
    times: list[float] = []
    failed = 0
    with np.errstate(over="ignore", invalid="ignore"):
        for count in range(_UNTIMED + _FRAMES):
            begin = time.perf_counter()
            state, converged = model.step(state, case.dt, case.load, case.damping)
            positions = model.positions(state)
            if count >= _UNTIMED:
                times.append(time.perf_counter() - begin)
            failed += not converged
            if not np.isfinite(positions.sum()):
                return 1000.0 * float(np.median(times or [np.inf])), f"diverged at frame {count + 1}"
            if len(times) >= _FEWEST and sum(times) > _FRAME_BUDGET:
                break
    motion = f"{failed} of {count + 1} steps did not converge" if failed else "completed"
    return 1000.0 * float(np.median(times)), motion
