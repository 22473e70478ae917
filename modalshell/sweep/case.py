"""Case of a sweep: the input of a worker, and its result."""

from __future__ import annotations

import hashlib
import json
import platform
import threading
import warnings
from pathlib import Path
from typing import Any

import numba
import numpy as np
from llvmlite.binding import get_host_cpu_name
from msgspec import Struct

from modalshell.core.errors import ModalShellError, ModalShellWarning, WorkerError
from modalshell.core.outcome import Outcome
from modalshell.core.timings import Stopwatch
from modalshell.core.typing import Array
from modalshell.files.provenance import run_record
from modalshell.mesh import TriangleMesh
from modalshell.motion import Trajectory
from modalshell.motion.recorder import Recorder
from modalshell.scene import BuiltScene, Scene, parse_scene
from modalshell.shell.measure import area_change

_ONE_AT_A_TIME = threading.Lock()
"""Threads of a cluster's worker take turns: results must not depend on concurrent cases."""


class Task(Struct, frozen=True):
    """A case to compute: its digest, its scene's plain tables and file, and the mesh, so that no file is read again."""

    digest: str
    file: str
    scene: dict[str, Any]
    vertices: bytes
    faces: bytes

    def mesh(self) -> TriangleMesh:
        """The mesh as it was when the sweep was checked."""
        return TriangleMesh(
            np.frombuffer(self.vertices, dtype="<f8").reshape(-1, 3),
            np.frombuffer(self.faces, dtype="<i8").reshape(-1, 3),
        )


class Measures(Struct, frozen=True, kw_only=True):
    """Numbers of a result; None where they do not apply or are not finite."""

    converged: bool
    """Whether the solver converged: of an equilibrium, or in every step of a motion that stayed finite."""
    frames: int
    unconverged_steps: int
    """Stored frames, and steps (or equilibria) that did not converge."""
    iterations: int | None
    residual: float | None
    """Of an equilibrium."""
    displacement: float | None
    peak_displacement: float | None
    """Largest of any vertex [m]: in the last frame, and in any frame."""
    area_change: float | None
    """Relative, in the last frame."""
    kinetic_energy: float | None
    elastic_energy: float | None
    load_potential: float | None
    """In the last frame [J]."""
    error_bar: float | None = None
    """Bar on the displacement, over the largest one; of a motion the largest. None if there is none, or it is void
    anywhere."""
    margin: float | None = None
    """Smallest stability margin of the checked frames."""


class RunInfo(Struct, frozen=True):
    """What differs from run to run: seconds to build the model and to solve, where and by what, and warnings."""

    building_seconds: float = 0.0
    solving_seconds: float = 0.0
    host: str = ""
    versions: str = ""
    processor: str = ""
    warnings: list[str] = []


class CaseResult(Struct, frozen=True):
    """What became of a case."""

    digest: str
    """Of the case."""
    outcome: Outcome
    """The solver's; or "refused" by an error that the package raises on purpose, "failed" by another one or because
    the process died each time, "stopped" by the time limit."""
    message: str
    """The solver's sentence, or the error's."""
    measures: Measures | None = None
    """None where the solver gave no answer."""
    positions: bytes = b""
    """Vertex positions of the last frame [m], (n, 3) little-endian float64."""
    info: RunInfo = RunInfo()
    """What differs from run to run."""

    def final_positions(self) -> Array:
        """Positions of the last frame (n, 3) [m]."""
        return np.frombuffer(self.positions, dtype="<f8").reshape(-1, 3)


def case_digest(scene: Scene, mesh: TriangleMesh) -> str:
    """Names a case by all that decides its result: scene, mesh and this package's version."""
    parts = scene.digests(mesh) | {"modalshell": run_record({})["versions"]["modalshell"]}
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def run_case(task: Task) -> CaseResult:
    """Compute a case on one thread; exceptions become its outcome.

    WorkerError if this process does not know the case by the same digest: it runs another version of the package.
    """
    with _ONE_AT_A_TIME, warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", RuntimeWarning)
        warnings.simplefilter("always", ModalShellWarning)
        scene, mesh = parse_scene(Path(task.file), task.scene), task.mesh()
        if case_digest(scene, mesh) != task.digest:
            raise WorkerError("the worker names the case otherwise: give workers and driver the same modalshell")
        watch, building, threads = Stopwatch(), 0.0, numba.get_num_threads()
        numba.set_num_threads(1)
        measures, positions = None, b""
        try:
            built = scene.require_shell().build(scene.build_shell(mesh))
            building = watch()
            outcome, message, measures, last = _solved(built)
            positions = np.ascontiguousarray(last, dtype="<f8").tobytes()
        except ModalShellError as error:
            outcome, message = Outcome.REFUSED, str(error)
        except Exception as error:  # one case's fault must not end the sweep
            outcome, message = Outcome.FAILED, f"{type(error).__name__}: {error}"
        finally:
            numba.set_num_threads(threads)
        message = scene.unit_system.restated(message)
        said = [scene.unit_system.restated(str(warning.message)) for warning in heard]
        info = _run_info(building, watch() - building, said)
    return CaseResult(task.digest, outcome, message, measures, positions, info)


def _run_info(building: float, solving: float, heard: list[str]) -> RunInfo:
    versions = ", ".join(f"{name} {version}" for name, version in run_record({})["versions"].items())
    return RunInfo(building, solving, platform.node(), versions, str(get_host_cpu_name()), list(dict.fromkeys(heard)))


def _solved(built: BuiltScene) -> tuple[Outcome, str, Measures, Array]:
    """Outcome, message, numbers and last positions of an equilibrium or a motion."""
    numbers: dict[str, Any]
    if built.scene.motion is None:
        answer = built.equilibrium()
        run = Trajectory.still(answer, built.shell, built.loading())
        peak = _largest(answer.positions, built)
        numbers = {
            "converged": answer.converged,
            "unconverged_steps": run.unconverged_steps,
            "iterations": answer.iterations,
            "residual": _finite(answer.residual),
        }
    else:
        table, motion = built.scene.motion, built.start_motion()
        recorder = Recorder(motion, table.steps(), store_every=table.store_every)
        peak, frames = 0.0, list[Array]()
        for _ in recorder.frames():
            kept = len(frames) if built.scene.bar else 0  # bars take all frames, other measures the last one
            frames[kept:] = [motion.positions()]
            peak = max(peak, _largest(frames[-1], built))
        run = built.judged(recorder.trajectory(np.array(frames)))
        numbers = {
            "converged": motion.finite and not motion.unconverged,
            "unconverged_steps": motion.unconverged,
            "iterations": None,
            "residual": None,
        }
    last, bars = run.positions[-1], run.bars
    kinetic, elastic, potential = map(_finite, run.energies[-1])
    measures = Measures(
        frames=len(run.times),
        displacement=_finite(_largest(last, built)),
        peak_displacement=_finite(peak),
        area_change=_finite(area_change(last, built.shell.mesh)),
        kinetic_energy=kinetic,
        elastic_energy=elastic,
        load_potential=potential,
        error_bar=bars.largest if bars is not None and bars.valid.size and bars.valid.all() else None,
        margin=None if bars is None else bars.least_margin,
        **numbers,
    )
    message = "; ".join(filter(None, (run.message, "" if bars is None else str(bars))))
    return run.outcome, message, measures, np.asarray(last)


def _largest(positions: Array, built: BuiltScene) -> float:
    return float(np.linalg.norm(positions - built.shell.rest_positions, axis=1).max())


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
