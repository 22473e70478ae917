"""Following a running simulation from another process: its newest frame and its state."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from modalshell.core.checks import checked_number
from modalshell.core.errors import FileFormatError, OptionError
from modalshell.core.outcome import Outcome
from modalshell.core.typing import Array
from modalshell.core.units import SI, UnitSystem
from modalshell.export import load_trajectory
from modalshell.files.archive import Field, check_arrays
from modalshell.files.atomic_io import read_record
from modalshell.run.frame_reader import FrameReader
from modalshell.scene import load_scene

_FRAMES = ".frames"
_SHELL_FIELDS = {
    "rest_positions": Field("f", ("n", 3)),
    "faces": Field("iu", ("T", 3)),
    "held": Field("b", ("n",)),
    "gravity": Field("f", (3,)),
    "unit_system": Field("U", (3,)),
}
_FRAME_FIELDS = {"time": Field("f"), "positions": Field("f", ("n", 3))}
"""What a followed run has stored of its shell, and of every frame."""
_PAUSE = 0.05
"""Polling interval [s] before the first frame."""

State = Literal["waiting", "running", "stopped", "running or stopped", "finished"]
_STATES: dict[bool | None, State] = {True: "running", False: "stopped", None: "running or stopped"}


class RunFollower:
    """Follower of a run of another process, or of an earlier one: reads its newest stored frame.

    It acquires no lock and writes nothing, so it does not affect the run.

    Parameters
    ----------
    run : path
        The run's output folder; its scene file, if the scene's own folder takes the results; or the file of frames,
        ``FOLDER/NAME.frames``, where one folder holds several runs. The last two need not exist yet (the scene file
        must), nor need the folder, which may also be empty.

    Attributes
    ----------
    name : str
        The scene's name; "" before it is known.
    state : str
        "waiting" for a first frame, "running", "stopped" (no process runs it, and its results are missing),
        "finished", or "running or stopped" where the system cannot tell.
    outcome : Outcome or None
        The finished run's own, such as "completed"; "stopped" of a stopped one; None before.
    message : str
        Message of the finished run; "" if there is none.
    index, time, positions
        Number of the newest frame, its time [s] and positions (n, 3) [m].
    rest_positions, faces, held, gravity
        The shell at rest (n, 3) [m], its triangles (T, 3), which vertices are held (n,), and gravity (3,) [m/s^2]. A
        run that was finished before it was followed has stored neither supports nor gravity.
    units : UnitSystem
        Of the run's numbers.
    restarts : int
        How often the run was restarted while it was followed.

    Raises
    ------
    OptionError
        If ``run`` is not a run; also raised by :meth:`poll` if ``run`` appears later and is not one.
    SceneError
        For a scene file that is refused.
    """

    def __init__(self, run: str | os.PathLike[str]) -> None:
        if sys.platform == "win32":
            raise OptionError("runs cannot be followed under Windows, where a file that is read cannot be deleted")
        self._given = Path(run)
        self._path: Path | None = None
        self._reader: FrameReader | None = None
        self._generation: object = None
        self._identity: dict[str, Any] = {}
        self.name, self.message = "", ""
        self.state: State = "waiting"
        self.outcome: Outcome | None = None
        self.index, self.time, self.restarts = -1, 0.0, 0
        self.positions, self.rest_positions, self.gravity = np.empty((0, 3)), np.empty((0, 3)), np.zeros(3)
        self.faces, self.held, self.units = np.empty((0, 3), np.int64), np.empty(0, bool), SI
        self._find()

    def close(self) -> None:
        """Let go of the run's file."""
        if self._reader is not None:
            self._reader.close()
            self._reader = None

    def wait(self, seconds: float) -> None:
        """Wait for the first frame; OptionError if there is none after ``seconds``."""
        end = time.monotonic() + checked_number("wait", seconds, at_least=0.0, unit="s")
        self.poll()
        while self.index < 0:
            if time.monotonic() > end:
                raise OptionError(
                    f"{self._given} has stored no frame within {seconds:g} s; run it, or wait longer (--wait SECONDS)"
                )
            time.sleep(_PAUSE)
            self.poll()

    def poll(self) -> bool:
        """Read the newest frame and the state; return whether either has changed."""
        if self._path is None:
            self._find()
        if self._path is None:
            return False
        before = self.state, self.index, self.restarts, self._generation
        self._look(self._path)
        return before != (self.state, self.index, self.restarts, self._generation)

    def bodies(self) -> list[tuple[Array, NDArray[np.integer]]]:
        """None: frames that are followed name no colliders."""
        return []

    def status(self) -> str:
        """One line: name, frame, time, state."""
        if self.index < 0:
            return f"{self.name or self._given}; {self.state}"
        state: str = self.state
        if state == "finished" and self.outcome is not None:
            state += f": {self.outcome.with_message(self.message)}"
        parts = [self.name, f"frame {self.index}", f"t = {self.time:.6g} {self.units.time}", state]
        return "; ".join([*parts, "restarted"] if self.restarts else parts)

    def _look(self, path: Path) -> None:
        if self._reader is None or not self._reader.is_file(path):
            if self._reader is not None:
                self._take_newest(self._reader)  # a deleted file can still be read where it is open
            try:
                following = FrameReader(path)
            except FileNotFoundError:
                self._look_at_results(path)
                return
            self.close()
            self._reader = following
        held = self._reader.is_held()  # asked first: what a process that has ended wrote is all there
        self._take_newest(self._reader)
        if held is False and not self._reader.is_file(path):  # it has finished since we looked for the file
            self._look_at_results(path)
            return
        if self.index < 0 or self._reader.index < 0:  # at work, if at all, on what comes before the first frame
            self.state = "waiting"
        else:
            self.state = _STATES[held]
        self.outcome = Outcome.STOPPED if self.state == "stopped" else None

    def _take_newest(self, reader: FrameReader) -> None:
        if not reader.read_newest():
            return
        if fault := _fault(reader.constants, reader.record):
            raise FileFormatError(
                f"{self._path or self._given} holds no frames of a shell's run ({fault}); name another run"
            )
        if reader.generation != self._generation:
            self._begin(reader.generation, reader.identity)
            constants = dict(reader.constants)
            self.units = UnitSystem.from_array(constants.pop("unit_system"))
            self._take_shell(**constants)
        self._show(reader.index, reader.record["time"], reader.record["positions"])

    def _look_at_results(self, path: Path) -> None:
        """Update the state if no file of frames exists: the run is finished, not started, or was deleted."""
        record = _record(path.with_suffix(".json"))
        if record is not None and self.index >= 0 and _same(record["identity"], self._identity):
            self._finish(record)
        elif self._reader is not None and self._reader.index >= 0 and self._reader.is_held():
            self.state = "running"
        elif record is not None and self._take_results(path.with_suffix(".npz"), record["identity"]):
            self._finish(record)
        elif self.index >= 0:
            self.state, self.outcome = "stopped", Outcome.STOPPED

    def _finish(self, record: dict[str, Any]) -> None:
        self.state = "finished"
        self.outcome, self.message = Outcome(record["status"]), record.get("message", "")

    def _take_results(self, path: Path, identity: dict[str, Any]) -> bool:
        try:
            run = load_trajectory(path)
        except FileFormatError:
            return False
        self._begin(path, identity)
        self.units = run.units
        self._take_shell(run.rest_positions, run.faces, np.zeros(len(run.rest_positions), bool), np.zeros(3))
        self._show(len(run.times) - 1, run.times[-1], run.positions[-1])
        return True

    def _begin(self, generation: object, identity: dict[str, Any]) -> None:
        self.restarts += self.index >= 0
        self._generation, self._identity = generation, identity

    def _take_shell(self, rest_positions: Array, faces: Any, held: Any, gravity: Array) -> None:
        """Replace the shell if it differs from the present one, so that a viewer is not rebuilt needlessly."""
        found = {"rest_positions": rest_positions, "faces": faces, "held": held, "gravity": gravity}
        if not all(np.array_equal(getattr(self, name), array) for name, array in found.items()):
            for name, array in found.items():
                setattr(self, name, np.array(array))

    def _show(self, index: int, moment: Any, positions: Any) -> None:
        self.index, self.time = index, float(moment)
        self.positions = np.array(positions, dtype=np.float64)

    def _find(self) -> None:
        """Determine which run it is, if that is known yet."""
        given = self._given
        if given.suffix == ".toml":
            scene = load_scene(given)
            self._path = Path(scene.output.folder) / f"{scene.name}{_FRAMES}"
        elif given.suffix == _FRAMES:
            self._path = given
        elif given.is_dir():
            name = _only_run(given)
            self._path = None if name is None else given / f"{name}{_FRAMES}"
        elif given.exists() and not given.is_dir():  # which may just have been made
            raise OptionError(
                f"a run must be its output folder, its scene file (.toml) or its file of frames (.frames) (got {given})"
            )
        if self._path is not None:
            self.name = self._path.stem


def _fault(constants: dict[str, NDArray[Any]], record: Any) -> str:
    """Reason why arrays with correct checksums are no shell with a frame of it; "" if they are."""
    if constants.keys() != _SHELL_FIELDS.keys():
        return f"its shell must be arrays named {', '.join(_SHELL_FIELDS)}"
    if not _FRAME_FIELDS.keys() <= set(record.dtype.names or ()):
        return f"a frame must have {' and '.join(_FRAME_FIELDS)}"
    try:
        count = check_arrays(_SHELL_FIELDS, constants)["n"]
        UnitSystem.from_array(constants["unit_system"])
        check_arrays(_FRAME_FIELDS, {name: np.asarray(record[name]) for name in _FRAME_FIELDS}, n=count)
    except ValueError as error:
        return str(error)
    faces = constants["faces"]
    return f"faces must name vertices 0 to {count - 1}" if ((faces < 0) | (faces >= count)).any() else ""


def _only_run(folder: Path) -> str | None:
    """Name of the only run in the folder; None if the folder is empty."""
    files = sorted(folder.iterdir())  # once, as a run may begin at any moment
    names = [path.stem for path in files if path.suffix == _FRAMES]
    names = names or [path.stem for path in files if path.suffix == ".json" and _record(path) is not None]
    if len(names) > 1:
        listed = ", ".join(str(folder / f"{name}{_FRAMES}") for name in names)
        raise OptionError(f"{folder} holds several runs: name one of them ({listed})")
    if not names and any(not path.name.startswith(".") for path in files):
        raise OptionError(
            f"{folder} holds no run; to wait for one there, name its scene file (.toml) or its frames "
            f"({folder / 'NAME.frames'})"
        )
    return names[0] if names else None


def _record(path: Path) -> dict[str, Any] | None:
    """The record of a finished run; None if the file is not one."""
    record = read_record(path)
    if record is None or not isinstance(record.get("identity"), dict) or record.get("status") not in list(Outcome):
        return None
    return record


def _same(identity: dict[str, Any], whole: dict[str, Any]) -> bool:
    """Whether the frames' identity, which has more entries, agrees with that of the record."""
    return all(whole.get(name) == value for name, value in identity.items())
