"""Run a scene, or go on with a run that was stopped."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modalshell.atomic_io import read_record, write_record
from modalshell.errors import FileFormatError, OptionError
from modalshell.export import check_formats, load_trajectory
from modalshell.motion import Motion, Trajectory
from modalshell.motion.recorder import Recorder, step_count
from modalshell.outcome import Outcome
from modalshell.provenance import run_record
from modalshell.run.folder import remove_leftovers, result_digest, run_identity
from modalshell.run.frame_file import FrameFile
from modalshell.run.results import write_results
from modalshell.run.run_flock import FlightResult, run_flock
from modalshell.scene import BuiltScene, Scene, load_scene
from modalshell.scene.tables import Motion as MotionTable
from modalshell.typing import Array, Progress

_FAULT_BYTES = 64
"""Bytes of a fault's text in a stored record."""
_SNAPSHOT = "snapshot_"


@dataclass(frozen=True)
class SceneResult:
    """What running a scene gave.

    Attributes
    ----------
    trajectory : Trajectory
        The stored frames, mapped from the ``.npz`` file; one frame for an equilibrium.
    files : list of Path
        The results' files.
    resumed : int
        Frames that an earlier, stopped run had left.
    """

    trajectory: Trajectory
    files: list[Path]
    resumed: int

    @property
    def outcome(self) -> Outcome:
        """How the motion or the equilibrium ended."""
        return self.trajectory.outcome

    @property
    def summary(self) -> str:
        """One line on how it went."""
        run = self.trajectory
        kept = f", {self.resumed} of them from an earlier run" if self.resumed else ""
        return f"{run.outcome.with_message(run.message)}, {len(run.times)} frames in {run.seconds:.3g} s{kept}"


def run_scene(
    scene: Scene | str | os.PathLike[str],
    *,
    out: str | os.PathLike[str] | None = None,
    restart: bool = False,
    on_step: Progress | None = None,
) -> SceneResult | FlightResult:
    """Run a scene and write its results; a run that was stopped, even killed, goes on after its last stored frame.

    Stored frames are kept in ``NAME.frames`` until the results are whole; :class:`RunFollower` shows them to other
    processes. However often a run was stopped, its results are those of an uninterrupted one to the last bit. A scene
    whose results are whole already is not run again.

    Parameters
    ----------
    scene : Scene or path
        The scene or its file.
    out : path, optional
        Folder for the results; the scene's own without it.
    restart : bool
        Drop what an earlier run has left and start at time 0.
    on_step : callable, optional
        Called after each step with the steps done and their total.

    Returns
    -------
    SceneResult
        Trajectory and files: ``NAME.npz``, ``NAME.json`` with the record of the run, and the formats asked for.
    FlightResult
        The same of a flock, with a report on its levels of detail instead of a trajectory.

    Raises
    ------
    SceneError
        Where the scene is refused.
    OptionError
        If the folder holds frames of another run under this name, or another process is at work there.
    """
    declared = scene if isinstance(scene, Scene) else load_scene(scene)
    check_formats(declared.output.formats)
    folder = Path(declared.output.folder if out is None else out)
    shell = declared.build_shell()
    identity = run_identity(declared, shell)
    with FrameFile(folder / f"{declared.name}.frames") as file:
        remove_leftovers(folder, declared.name)
        if declared.flock is not None:
            return run_flock(declared, shell, folder, file, identity, restart, on_step)
        whole = None if restart else _whole_results(folder, declared.name, identity)
        resumed, valid = 0, list[str]()
        if whole is None and not restart:
            file.refuse_others(identity)  # before the work of building the model
        if whole is not None:
            run, valid = whole
            resumed = len(run.times)
        elif declared.motion is None:
            built = declared.build(shell)
            run = Trajectory.still(built.equilibrium(), shell, built.load(), declared.output.positions)
        else:
            run, resumed = _move(declared.build(shell), declared.motion, file, identity, restart, on_step)
        wanted = [kind for kind in dict.fromkeys(["npz", *declared.output.formats]) if kind not in valid]
        if whole is None:  # what another run has left is about to be replaced
            (folder / f"{declared.name}.json").unlink(missing_ok=True)
        if wanted:
            write_results(run, folder, declared.name, wanted)
            _write_record(folder, declared, identity, run, [*valid, *wanted])
        if whole is None or not file.difference(identity):
            file.remove()
    files = [folder / f"{declared.name}.{kind}" for kind in dict.fromkeys(["npz", *declared.output.formats, "json"])]
    return SceneResult(load_trajectory(files[0]), files, resumed)


def _move(
    built: BuiltScene,
    table: MotionTable,
    file: FrameFile,
    identity: dict[str, str],
    restart: bool,
    on_step: Progress | None,
) -> tuple[Trajectory, int]:
    """Step to the end from rest or from the last stored frame; also returns how many frames there were."""
    motion = built.start_motion()
    recorder = Recorder(motion, step_count(table.duration, table.dt), store_every=table.store_every)
    file.begin(identity, _record_fields(motion, built.scene.output.positions), restart, _constants(built))
    resumed = file.count
    if resumed:
        _resume(recorder, file.records(), file.path)
    for _ in recorder.frames(on_step):
        values: dict[str, Any] = {f"{_SNAPSHOT}{name}": array for name, array in motion.snapshot().items()}
        values |= {"time": motion.time, "positions": motion.positions(), "energies": recorder.energies[-1]}
        values |= {"fault": str(recorder.fault or "").encode(), "fault_time": recorder.fault_time}
        file.append(values | {"seconds": recorder.seconds})
    return recorder.trajectory(file.records()["positions"]), resumed


def _record_fields(motion: Motion, precision: str) -> list[tuple[Any, ...]]:
    """NumPy fields of one stored frame: results, then the snapshot from which to go on."""
    fields: list[tuple[Any, ...]] = [
        ("time", "<f8"),
        ("seconds", "<f8"),
        ("energies", "<f8", (3,)),
        ("fault", f"S{_FAULT_BYTES}"),
        ("fault_time", "<f8"),
        ("positions", np.dtype(precision).newbyteorder("<").str, motion.model.shell.rest_positions.shape),
    ]
    return fields + [(f"{_SNAPSHOT}{name}", "<f8", array.shape) for name, array in motion.snapshot().items()]


def _constants(built: BuiltScene) -> dict[str, NDArray[Any]]:
    """What those who follow the run need beside its frames."""
    shell = built.shell
    return {
        "rest_positions": np.asarray(shell.rest_positions, "<f8"),
        "faces": np.asarray(shell.mesh.faces, "<i8"),
        "held": np.asarray(shell.clamped, "?"),
        "gravity": np.asarray(built.gravity or (0.0, 0.0, 0.0), "<f8"),
    }


def _resume(recorder: Recorder, records: NDArray[Any], path: Path) -> None:
    """Bring the recorder and its motion to the last record.

    The last stored step is taken again: libraries may round otherwise where they find other threads, and the frames
    would be those of no single run.
    """
    last, motion = records[-1], recorder.motion
    motion.restore(_snapshot(records[-2:][0]))
    while motion.count < _snapshot(last)["counts"][0]:
        motion.advance()
    found = motion.snapshot() | {"positions": motion.positions().astype(last["positions"].dtype)}
    expected = _snapshot(last) | {"positions": last["positions"]}
    if not all(np.array_equal(found[name], expected[name]) for name in expected):
        raise OptionError(
            f"the last step of {path} comes out otherwise than it did (other threads or libraries?), so that going on "
            "would not give the frames of one run; run it as before, or pass --restart (restart=True) to start anew"
        )
    fault = bytes(last["fault"]).decode()
    recorder.resume(
        np.array(records["time"]),
        np.array(records["energies"]),
        np.array(records["snapshot_constraint_residuals"]),
        Outcome(fault) if fault else None,
        float(last["fault_time"]),
        float(last["seconds"]),
    )


def _snapshot(record: Any) -> dict[str, Array]:
    """The arrays of :meth:`Motion.snapshot` in a record."""
    names = [name for name in record.dtype.names if name.startswith(_SNAPSHOT)]
    return {name.removeprefix(_SNAPSHOT): record[name] for name in names}


def _whole_results(folder: Path, name: str, identity: dict[str, str]) -> tuple[Trajectory, list[str]] | None:
    """Results of this very run that are there already, and their formats; None if it has to be run."""
    record = read_record(folder / f"{name}.json")
    if record is None or record.get("identity") != identity:
        return None
    try:
        run = load_trajectory(folder / f"{name}.npz", verify=True)
        digests = record.get("digests", {})  # records of earlier versions have none: what they name is written again
        return run, [kind for kind in record["formats"] if digests.get(kind) == result_digest(folder, name, kind)]
    except FileFormatError:
        return None


def _write_record(folder: Path, scene: Scene, identity: dict[str, str], run: Trajectory, formats: list[str]) -> None:
    document = {
        "scene": scene.name,
        "identity": identity,
        "formats": formats,
        "digests": {kind: result_digest(folder, scene.name, kind) for kind in formats},
        "status": run.status,
        "message": run.message,
        "frames": len(run.times),
        "seconds": run.seconds,
        "record": run_record(scene.content()),
    }
    write_record(folder / f"{scene.name}.json", document)
