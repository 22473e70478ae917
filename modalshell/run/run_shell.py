"""Run of one shell: its equilibrium, or its motion with every stored frame on disk at once."""

from __future__ import annotations

import json
import math
import os
from collections import deque
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from modalshell.core.errors import FileFormatError, OptionError
from modalshell.core.memory import demand_disk
from modalshell.core.outcome import Outcome
from modalshell.core.short_repr import short_repr
from modalshell.core.touched import TOUCHED, TouchedFrame
from modalshell.core.typing import Array, Progress, unheard
from modalshell.export import load_trajectory
from modalshell.export.near_origin import demand_near_origin
from modalshell.models import Equilibrium
from modalshell.models.factory import SolveModes
from modalshell.motion import Motion, Trajectory
from modalshell.motion.colouring import DISPLACEMENT
from modalshell.motion.fields import checked_fields, shell_at, with_fields, with_stretch_remark
from modalshell.motion.recorder import Recorder, take_steps
from modalshell.render.content import checked_direction
from modalshell.render.stage import down_of
from modalshell.run.balance import has_reactions
from modalshell.run.frame_file import FrameFile
from modalshell.run.protocol import RunResult, SceneRun
from modalshell.run.results import Look, film_slowing, write_result
from modalshell.scene import BuiltScene, ShellScene
from modalshell.scene.parts import build_path
from modalshell.scene.read import located
from modalshell.scene.tables import MotionTable
from modalshell.shell import Shell

_FAULT_BYTES = 64
"""Bytes of a fault's name in a stored record."""
_REMARK_BYTES = 512
"""Bytes of what the model has remarked, in a stored record."""
_ROUNDING = 1e-12
"""Share of all forces below which their sum is rounding."""
_SNAPSHOT, _STATE, _EXTENT = "snapshot_", "snapshot_state_", "extent_"


@final
@short_repr
@dataclass(frozen=True)
class SceneResult(RunResult):
    """What running a scene of one shell gave; see also :class:`RunResult`.

    Attributes
    ----------
    trajectory : Trajectory
        The stored frames, mapped from the ``.npz`` file; one frame for an equilibrium.
    answer : Equilibrium or None
        The equilibrium, where there is one and it was computed now.
    load : ndarray, shape (3,), or None
        Resultant of the load on it.
    slowed : int
        How many times its film was slowed, as the motion is too brief to be seen; 1 without a film, or where its
        rate was given.
    """

    trajectory: Trajectory
    answer: Equilibrium | None = None
    load: Array | None = None
    slowed: int = 1

    @property
    def outcome(self) -> Outcome:
        """How the motion or the equilibrium ended."""
        return self.trajectory.outcome

    @property
    def summary(self) -> str:
        """One line on how it went."""
        run = self.trajectory
        kept = f", {self.resumed} of them from an earlier run" if self.resumed else ""
        work = f"{len(run.times)} frames in {run.seconds:.3g} s{kept}"
        if self.answer is not None:
            work = f"{self.answer.iterations} iterations, residual {self.answer.residual:.1e}"
        if self.load is not None and self.load.any():
            work += f", load ({', '.join(f'{part:.4g}' for part in self.load)}) {run.units.of('N')} in all"
        if self.slowed > 1:
            work += f", the film slowed {self.slowed} times"
        bar = "" if run.bars is None else f"; {run.units.restated(str(run.bars))}"
        return f"{run.outcome.with_message(run.message)}, {work}{bar}"


@final
class ShellRun(SceneRun[SceneResult]):
    """The run of a scene of one shell, with modes by ``solve``.

    Films and pictures have the ``look``, by default the scene's colour; ``on_frame`` is called after each frame drawn.
    """

    def __init__(
        self,
        scene: ShellScene,
        shell: Shell,
        folder: Path,
        look: Look | None = None,
        on_frame: Progress = unheard,
        solve: SolveModes | None = None,
    ) -> None:
        super().__init__(scene, shell, folder)
        shown = scene.output
        own = Look(color=shown.color, model=scene.model.spec.name, style=shown.look, follow=shown.camera == "follow")
        with located(scene.file, "output", shown):
            if not isinstance(shown.camera, str):
                own = replace(own, camera=checked_direction(shown.camera))
        self._scene, self._look = scene, replace(look or own, down=down_of(_gravity(scene)))
        self._on_frame, self._solve = on_frame, solve
        with located(scene.file, "output", shown):
            checked_fields(self._fields, shell)
        self._trajectory: Trajectory
        self._answer: Equilibrium | None = None
        self._load: Array | None = None

    def _take(self, run: Trajectory) -> None:
        path = build_path(self._scene.supports)
        self._trajectory, self.frames = with_fields(run, self.shell, self._fields, path), len(run.times)

    @cached_property
    def _contacts(self) -> Sequence[Any]:
        return self._scene.build_contacts()

    @property
    def _fields(self) -> list[str]:
        """Fields that are stored with the frames, that of the colour among them."""
        output = self._scene.output
        coloured = [name for name in (output.color,) if name not in (None, DISPLACEMENT)]
        return list(dict.fromkeys([*output.fields, *coloured]))

    def find_results(self, record: dict[str, Any], whole: list[str]) -> bool:
        """Load the trajectory if its file is intact; files with other fields than requested are rewritten."""
        try:
            found = load_trajectory(self.path("npz"), verify=True)
        except FileFormatError:
            return False
        if has_reactions(self._scene) and not found.reactions.size:  # stored before runs had them
            return False
        if set(found.fields) != set(self._fields):
            whole.clear()
            found = replace(found, fields={name: found.fields[name] for name in self._fields if name in found.fields})
        if record.get("look") != self._look.plain():
            whole[:] = [suffix for suffix in whole if suffix not in ("png", "mp4")]
        self._take(found)
        self._trajectory = with_stretch_remark(self._trajectory, self.shell, build_path(self._scene.supports))
        return True

    def compute(self, file: FrameFile, restart: bool, on_step: Progress) -> int:
        """Find the equilibrium, or step to the end of the motion."""
        scene = self._scene
        if scene.output.positions == "float32":
            kind = 'positions = "float32"'
            with located(scene.file, "output", scene.output):
                demand_near_origin(self.shell.rest_positions, scene.unit_system.length, kind)
        built = scene.build(self.shell, self._solve)
        self._contacts = built.contacts
        if scene.motion is None:
            self._answer = built.equilibrium()
            self._load = _resultant(built.loading().force(self._answer.positions))
            run, resumed = Trajectory.still(self._answer, self.shell, built.loading(), scene.output.positions), 0
            if has_reactions(scene):
                load: dict[str, Any] = {"gravity": built.gravity, "force": built.force, "loads": built.loads}
                x = self._answer.positions
                run = replace(run, reactions=shell_at(self.shell, run, 0).reactions(x, **load)[None])
        else:
            run, resumed = _move(built, scene.motion, file, self.identity, restart, on_step)
        self._take(built.judged(run).in_units(scene.unit_system))
        own = None
        if self._answer is not None and self._fields:
            own = built.model.elastic_energy(built.model.start_motion(self._answer.positions))
        self._trajectory = with_stretch_remark(self._trajectory, self.shell, built.path, own)
        return resumed

    def write(self, formats: list[str], on_step: Progress) -> None:  # noqa: ARG002 (steps alone are counted)
        """Write the trajectory."""
        for suffix in formats:
            write_result(self._trajectory, self.path(suffix), self._look, self._on_frame, self._contacts)

    def record(self) -> dict[str, Any]:
        """How the motion ended, its wall time, and the scene's file, from the folder of the results."""
        run = self._trajectory
        units = {"seconds": "s of wall time"} | asdict(run.units)
        ended: dict[str, Any] = {"status": run.status, "message": run.message, "seconds": run.seconds}
        if run.bars is not None:
            bars = {name: getattr(run.bars, name).tolist() for name in ("times", "displacement", "margin", "valid")}
            bars |= {"unjudged": list(run.bars.unjudged)} if run.bars.unjudged else {}
            ended["bars"] = bars | {"summary": run.units.restated(str(run.bars))}
        return ended | {"units": units, "look": self._look.plain(), "file": self._scene_file()}

    def _scene_file(self) -> str:
        """The scene's file, from the folder of the results where there is a way."""
        file = self._scene.file.resolve()
        try:
            return Path(os.path.relpath(file, self.folder.resolve())).as_posix()
        except ValueError:  # on another drive
            return file.as_posix()

    def result(self, files: list[Path], resumed: int) -> SceneResult:
        """The trajectory as it was written."""
        written = replace(load_trajectory(files[0]), contacts=tuple(self._contacts))
        slowed = film_slowing(written, self._look) if any(file.suffix == ".mp4" for file in files) else 1
        return SceneResult(files, resumed, written, self._answer, self._load, slowed)


def _resultant(force: Array) -> Array:
    """Sum (3,) of forces (n, 3) [N]; a component that is rounding is zero."""
    total = np.asarray(force.sum(axis=0))
    return np.where(np.abs(total) > _ROUNDING * np.abs(force).sum(), total, 0.0)


def _gravity(scene: ShellScene) -> Sequence[float] | None:
    """The gravity of a scene, or that of its first weight."""
    if scene.gravity is not None:
        return scene.gravity
    weights: list[Any] = getattr(scene.loads, "weight", [])
    return next((weight.gravity for weight in weights), None)


def _move(
    built: BuiltScene,
    table: MotionTable,
    file: FrameFile,
    identity: dict[str, str],
    restart: bool,
    on_step: Progress,
) -> tuple[Trajectory, int]:
    """Step to the end from rest or from the last stored frame; also return how many frames there were."""
    motion = built.start_motion()
    precision, steps = built.scene.output.positions, table.steps()
    recorder = Recorder(motion, steps, store_every=table.store_every, precision=precision)
    fields = _record_fields(motion, precision)
    record = np.dtype(fields)
    frames = recorder.total // table.store_every + 2
    # The stored frames, and the results that are made of them.
    size = (1 + len(built.scene.output.formats)) * frames * record.itemsize
    demand_disk(f"a run of {frames} frames", size, file.path.parent, "store fewer (store_every)")
    file.begin(identity, fields, restart, _constants(built))
    resumed = file.count
    if resumed:
        _resume(recorder, file.records(), file.path)
    for _ in recorder.frames(on_step):
        values = _stored(motion.snapshot(), record)
        values |= {"time": motion.time, "positions": motion.positions(), "energies": recorder.energies[-1]}
        values |= {"fault": str(recorder.fault or "").encode(), "fault_time": recorder.fault_time}
        values |= {"remarks": _remarks(motion.remarked)}
        if recorder.touched:
            values |= dict(zip(TOUCHED, recorder.touched[-1], strict=True))
        file.append(values | {"seconds": recorder.seconds})
    return recorder.trajectory(file.records()["positions"]), resumed


def _record_fields(motion: Motion, precision: str) -> list[tuple[Any, ...]]:
    """NumPy fields of one stored frame: results, then the checkpoint to resume from."""
    fields: list[tuple[Any, ...]] = [
        ("time", "<f8"),
        ("seconds", "<f8"),
        ("energies", "<f8", (3,)),
        ("fault", f"S{_FAULT_BYTES}"),
        ("fault_time", "<f8"),
        ("remarks", f"S{_REMARK_BYTES}"),
        ("positions", np.dtype(precision).newbyteorder("<").str, motion.shell.rest_positions.shape),
    ]
    if motion.setup.contacts:
        count = len(motion.shell.rest_positions)
        shapes = ("<f8", (count, 3)), ("?", (count,)), ("<f8",), ("<f8",)
        fields += [(name, *shape) for name, shape in zip(TOUCHED, shapes, strict=True)]
    for name, extents in motion.extents().items():
        if len(extents) == 1:
            fields.append((f"{_SNAPSHOT}{name}", "<f8", *extents))
        else:
            fields += [
                (f"{_SNAPSHOT}{name}", "<f8", (max(map(math.prod, extents)),)),
                (f"{_EXTENT}{name}", "<i8", (2,)),
            ]
    return fields


def _remarks(remarked: dict[str, int]) -> bytes:
    """What a model has remarked and in which step first, as far as it fits."""
    kept = dict(remarked)
    while len(text := json.dumps(kept).encode()) > _REMARK_BYTES:
        kept.popitem()
    return text


def _constants(built: BuiltScene) -> dict[str, NDArray[Any]]:
    """Data for followers of the run in addition to its frames."""
    shell, units = built.shell, built.scene.unit_system
    return {
        "rest_positions": np.asarray(shell.rest_positions, "<f8"),
        "faces": np.asarray(shell.mesh.faces, "<i8"),
        "held": np.asarray(shell.clamped, "?"),
        "gravity": np.asarray(built.gravity or (0.0, 0.0, 0.0), "<f8"),
        "unit_system": np.array([units.length, units.mass, units.time]),
    }


def _resume(recorder: Recorder, records: NDArray[Any], path: Path) -> None:
    """Bring the recorder and its motion to the last record.

    The last stored step is taken again: libraries may round otherwise where they find other threads, and the frames
    would be those of no single run.
    """
    last, motion = records[-1], recorder.motion
    motion.restore(_snapshot(records[-2:][0]))
    deque(take_steps(motion, int(_snapshot(last)["counts"][0])), maxlen=0)
    found = motion.snapshot() | {"positions": motion.positions().astype(last["positions"].dtype)}
    expected = _snapshot(last) | {"positions": last["positions"]}
    if not all(np.array_equal(found[name], expected[name]) for name in expected):
        raise OptionError(
            f"the last step of {path} comes out otherwise than it did (other threads or libraries?), so that going on "
            "would not give the frames of one run; run it as before, or pass --restart (restart=True) to start again"
        )
    recorder.recall({name.removeprefix(_STATE): records[name] for name in last.dtype.names if name.startswith(_STATE)})
    if motion.setup.contacts:
        each = zip(*(np.array(records[name]) for name in TOUCHED), strict=True)
        recorder.touched = [
            TouchedFrame(forces, touches, float(deep), float(near)) for forces, touches, deep, near in each
        ]
    fault = bytes(last["fault"]).decode()
    motion.remarked = json.loads(bytes(last["remarks"]))
    recorder.resume(
        np.array(records["time"]),
        np.array(records["energies"]),
        np.array(records["snapshot_constraint_residuals"]),
        Outcome(fault) if fault else None,
        float(last["fault_time"]),
        float(last["seconds"]),
    )
    if motion.setup.contacts:
        recorder.look_back(records["positions"])


def _snapshot(record: Any) -> dict[str, Array]:
    """The arrays of :meth:`Motion.snapshot` in a record."""
    names = record.dtype.names
    found = {name.removeprefix(_SNAPSHOT): record[name] for name in names if name.startswith(_SNAPSHOT)}
    for name in found:
        if f"{_EXTENT}{name}" in names:
            shape = [length for length in record[f"{_EXTENT}{name}"] if length > 0] or [0]
            found[name] = found[name][: math.prod(shape)].reshape(shape)
    return found


def _stored(snapshot: dict[str, Array], record: np.dtype[Any]) -> dict[str, Any]:
    """The arrays of :meth:`Motion.snapshot` as values of a ``record``.

    An array that may come to have several shapes has room for the largest, and its own with it: (a, 0) or (a, b), and
    (0, 0) where it is empty.
    """
    values: dict[str, Any] = {}
    for name, array in snapshot.items():
        values[f"{_SNAPSHOT}{name}"] = array
        if f"{_EXTENT}{name}" in (record.names or ()):
            room = np.zeros(record[f"{_SNAPSHOT}{name}"].shape)
            room[: array.size] = array.ravel()
            values |= {f"{_SNAPSHOT}{name}": room, f"{_EXTENT}{name}": np.array([*array.shape, 0])[:2]}
    return values
