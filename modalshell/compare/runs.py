"""Measurement of one model on one case: errors against DS over the load range, and cost."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace

import numpy as np

from modalshell.compare.candidates import Candidate
from modalshell.compare.case import Case
from modalshell.compare.path import LoadPath
from modalshell.core.cost import Work, counted
from modalshell.core.outcome import Outcome
from modalshell.core.short_repr import short_repr
from modalshell.core.timings import Stopwatch
from modalshell.core.typing import Array
from modalshell.mesh import TriangleMesh
from modalshell.mesh.topology import area_vectors
from modalshell.models import Equilibrium, Model
from modalshell.models.factory import ModelFactory
from modalshell.models.registry import TRUTH
from modalshell.motion import Motion
from modalshell.motion.recorder import Recorder, take_steps
from modalshell.shell import Shell, measure

_FRAMES, _FEWEST, _UNTIMED = 48, 4, 2
"""Frames timed at most and at least, and frames before them that are not timed."""
_FRAME_BUDGET = 4e6
"""Counted cost [reference microseconds] after which timing stops: the same number of frames on every machine."""
_STATICS_LIMIT = 4.0
"""Counted cost of a rung's static answers over that of DS at all loads, from which the other loads are left out."""
ANSWER_FRAMES = 600
"""Frames of the time to answer: ten seconds at sixty a second."""


@short_repr
@dataclass(frozen=True)
class Measurement:
    """One rung at one size, measured."""

    candidate: Candidate
    preprocessing: float
    """Time to build the model [s], its modes included."""
    frame_ms: float
    """Median time of a step and its positions [ms], in motion from rest under the whole load; without the time that
    the process waits for a processor."""
    work: Work
    """Mean counted work of such a frame; its cost ranks the rungs."""
    statics: float
    """Time of all static answers [s]."""
    errors: list[float | None]
    """Relative displacement error against DS at each load; None where DS or the rung has no answer."""
    area_errors: list[float | None]
    """Relative area less that of DS."""
    tip_turns: list[float | None]
    """Turn [degrees] of the surface at the vertex that DS moves most."""
    statuses: list[str]
    """Outcome of each static answer."""
    frequency: float | None
    """Lowest frequency about the last state that DS knows, over that of DS at rest; 0 where that state is unstable,
    None for models without a tangent."""
    motion: str
    """Outcome of the timed motion, with its message."""
    missed: bool
    """Whether the rung has no answer at a load where DS has one, or its motion left the finite numbers."""
    positions: Array = field(repr=False)
    """Under the whole load [m]; shape (n, 3)."""
    outside_error: float | None = None
    """Relative displacement error under the whole load against an external solution, if given."""
    near_errors: list[float | None] = field(default_factory=list)
    """Errors against DS just below and just above a snap; None where the rung has no answer."""
    model: Model | None = field(default=None, repr=False, compare=False)
    """What was measured."""

    @property
    def label(self) -> str:
        """Rung and size."""
        return self.candidate.label

    @property
    def key(self) -> str:
        """Key of the model in the registry."""
        return self.candidate.spec.key

    @property
    def converged(self) -> bool:
        """Whether the solution under the whole load is valid."""
        return Outcome(self.statuses[-1]).solved

    @property
    def is_truth(self) -> bool:
        """Whether this model is the reference of the others."""
        return self.key == TRUTH

    @property
    def frames_per_second(self) -> float:
        """Frames in a second."""
        return 1000.0 / self.frame_ms

    @property
    def answer_seconds(self) -> float:
        """Time to answer [s]: preprocessing and :data:`ANSWER_FRAMES` frames."""
        return self.preprocessing + ANSWER_FRAMES * self.frame_ms / 1000.0

    @property
    def cost(self) -> float:
        """Counted cost per frame [reference microseconds]."""
        return self.work.cost

    @property
    def worst_error(self) -> float | None:
        """Largest error over the load range; None if the rung has no answer at a load where DS has one."""
        known = [error for error in self.errors if error is not None]
        return None if self.missed or not known else max(known)

    @property
    def near_error(self) -> float | None:
        """Largest error next to a snap, infinite without an answer there; None where no snap was located."""
        errors = [float("inf") if error is None else error for error in self.near_errors]
        return max(errors, default=None)

    @property
    def largest_error(self) -> float:
        """Largest error at all loads, those next to a snap included; infinite where the rung has no answer."""
        return float("inf") if self.worst_error is None else max(self.worst_error, self.near_error or 0.0)

    @property
    def final_error(self) -> float | None:
        """Error under the largest load that DS has an answer for."""
        known = [error for error in self.errors if error is not None]
        return None if self.missed or not known else known[-1]


def measure_row(
    candidate: Candidate, case: Case, factory: ModelFactory, path: LoadPath, tip: int, outside: Array | None = None
) -> Measurement:
    """Build the rung, find its answers at the loads of ``path``, and time its frames.

    ``tip`` is the vertex whose rotation is reported; ``outside`` (n, 3) [m] an external solution under the whole load.
    """
    shell, mesh = case.shell, case.shell.mesh
    model, preprocessing = candidate.build(factory)
    watch = Stopwatch()
    is_truth = candidate.spec.key == TRUTH
    answers = path.answers if is_truth else static_answers(model, case, path)
    statics = sum(answer.seconds for answer in answers) if is_truth else watch()
    errors: list[float | None] = []
    areas: list[float | None] = []
    turns: list[float | None] = []
    for answer, exact in zip(answers, path.answers, strict=True):
        errors.append(answer_error(answer, exact, shell))
        grown = [] if errors[-1] is None else [measure.area_change(one.positions, mesh) for one in (answer, exact)]
        areas.append(grown[0] - grown[1] if grown else None)
        turns.append(turn_at(answer.positions, mesh, tip) if answer.converged else None)
    frame_ms, work, motion, message = timed_frames(model, case)
    known = path.known
    frequency = None
    if known and answers[known[-1]].converged:
        factor = path.factors[known[-1]]
        lowest = model.tangent_eigenvalue(answers[known[-1]], factor * case.load)
        frequency = None if lowest is None else float(np.sqrt(max(lowest, 0.0) / path.lowest))
    missed = any(not answers[k].converged for k in known) or motion is Outcome.DIVERGED
    near_errors: list[float | None] = [None] * len(path.near)
    if not missed:
        near_answers = path.near_answers if is_truth else static_answers(model, case, path, near=True)
        both = zip(near_answers, path.near_answers, strict=True)
        near_errors = [answer_error(answer, exact, shell) for answer, exact in both]
    return Measurement(
        candidate,
        preprocessing,
        frame_ms,
        work,
        statics,
        errors,
        areas,
        turns,
        [answer.status for answer in answers],
        frequency,
        motion.with_message(case.units.restated(message)),
        missed,
        answers[-1].positions,
        None if outside is None else measure.displacement_error(answers[-1].positions, outside, shell),
        near_errors,
        model,
    )


def answer_error(answer: Equilibrium, exact: Equilibrium, shell: Shell) -> float | None:
    """Relative displacement error of an answer; None unless both are valid."""
    if not answer.converged or not exact.converged:
        return None
    return measure.displacement_error(answer.positions, exact.positions, shell)


def static_answers(model: Model, case: Case, path: LoadPath, *, near: bool = False) -> list[Equilibrium]:
    """Equilibria of ``model`` at the loads of ``path``, or at those ``near`` its snap.

    They stop once they cost several times those of DS.
    """
    answers: list[Equilibrium] = []
    cost = 0.0
    for factor in path.near if near else path.factors:
        if cost > _STATICS_LIMIT * path.cost:
            answers.append(replace(answers[-1], outcome=Outcome.STOPPED))
            continue
        with counted() as work:
            answers.append(model.equilibrium(force=factor * case.load))
        cost += work.cost
    return answers


def turn_at(positions: Array, mesh: TriangleMesh, vertex: int) -> float:
    """Angle [degrees] between the surface's normals at ``vertex`` at rest and now."""
    faces = mesh.faces[(mesh.faces == vertex).any(axis=1)]

    def normal(points: Array) -> Array:
        total = area_vectors(points, faces).sum(axis=0)
        return total / max(float(np.linalg.norm(total)), 1e-300)

    before, after = normal(np.asarray(mesh.vertices)), normal(positions)
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(before, after)), before @ after)))


def timed_frames(model: Model, case: Case) -> tuple[float, Work, Outcome, str]:
    """Median time [ms] and mean counted work of a frame in motion from rest under the whole load.

    Also the outcome of that motion, and its message.
    """
    damping = case.damping.mass_factor, case.damping.stiffness_factor
    motion = Motion(model, case.shell.loading(force=case.load), dt=case.dt, damping=damping)
    recorder = Recorder(motion, _UNTIMED + _FRAMES)
    times: list[float] = []
    with counted() as work:
        begin, began = time.perf_counter(), time.process_time()
        for _ in take_steps(motion, recorder.total):
            motion.positions()
            wall, own = time.perf_counter() - begin, time.process_time() - began
            # On a busy machine the processor's time is the smaller one, with several threads the wall's. A coarse
            # clock of the processor stands still in short frames.
            times.append(min(wall, own or wall))
            if motion.count >= _UNTIMED + _FEWEST and work.cost > _FRAME_BUDGET:
                break
            begin, began = time.perf_counter(), time.process_time()
    return 1000.0 * float(np.median(times[_UNTIMED:] or [np.inf])), work.per(motion.count), *recorder.verdict()
