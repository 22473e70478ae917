"""Run of a flock: steps into a file of frames, then draws them, with a report on the levels of detail."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import asdict, dataclass, replace
from itertools import tee
from operator import itemgetter
from pathlib import Path
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from modalshell.core.memory import demand_disk, demand_memory
from modalshell.core.outcome import Outcome
from modalshell.core.short_repr import short_repr
from modalshell.core.timings import Stopwatch
from modalshell.core.typing import Progress
from modalshell.crowd.film import FlightFilm, FlightReport
from modalshell.crowd.flight import Flight
from modalshell.crowd.scene import FlockScene
from modalshell.crowd.stage import FlightStage
from modalshell.files.archive import Archive, Field
from modalshell.files.atomic_io import write_npz
from modalshell.render import ShadedSurface, draw_surfaces, look_at, write_film
from modalshell.render.camera import Camera
from modalshell.render.content import checked_size, rgb
from modalshell.run.frame_file import FrameFile
from modalshell.run.protocol import RunResult, SceneRun
from modalshell.run.run_scene import new_run
from modalshell.scene.read import located
from modalshell.shell import Shell

_BIRD_BYTES, _DRAWN_BYTES = 60, 240
"""Bytes per vertex of each bird, in stepping and in drawing."""
_UNITS = {"time": "s", "positions": "m", "accelerations": "m/s^2"}
"""Units of the arrays but the modal coordinates."""
_KEPT = ("time", "positions", "directions", "accelerations", "coordinates", "levels")
_FLIGHT = Archive("a flight", "modalshell_flight")
"""Marks the arrays as those of a flight."""


@final
@short_repr
@dataclass(frozen=True)
class FlightResult(RunResult):
    """What flying a flock gave.

    Attributes
    ----------
    files : list of Path
        The results' files: boids, modal coordinates and levels of all frames in ``NAME.npz``, then the others.
    resumed : int
        Frames that an earlier, stopped run had left.
    report : FlightReport
        What it cost, and what its levels of detail show.
    frames : int
        Stored frames.
    """

    report: FlightReport
    frames: int

    @property
    def outcome(self) -> Outcome:
        """How the flight ended: birds fly to the end, or what stops them is raised."""
        return Outcome.COMPLETED

    @property
    def summary(self) -> str:
        """One line on how it went."""
        found = self.report
        kept = f" ({self.resumed} of them from an earlier run)" if self.resumed else ""
        parts = ", ".join(f"{name} {100.0 * part:.0f} %" for name, part in found.shares.items())
        return (
            f"{self.outcome}, {self.frames} frames{kept} of {found.birds} birds, stepped in "
            f"{found.seconds_steps:.3g} s; {parts}; "
            f"levels show at most {found.largest_pixels:.2g} of {found.allowed_pixels:g} pixels"
        )


@final
class FlockRun(SceneRun[FlightResult]):
    """The run of a scene of a flock."""

    def __init__(self, scene: FlockScene, shell: Shell, folder: Path) -> None:
        super().__init__(scene, shell, folder)
        self._scene = scene
        self._report: FlightReport
        self._camera: Camera
        self._flight: Flight
        self._records: NDArray[Any]
        steps = scene.motion.steps()
        drawn = -(-steps // scene.motion.store_every) + 1 if "mp4" in self.formats else 0
        self._steps, self._drawn = steps, drawn + ("png" in self.formats)
        self._warm_up = scene.motion.steps(scene.flock.warm_up)
        self._total = self._warm_up + self._steps + self._drawn

    def find_results(self, record: dict[str, Any], whole: list[str]) -> bool:
        """Load the report if every file is intact: none can be made from the others."""
        if not set(self.formats) <= set(whole):
            return False
        self._report, self.frames = FlightReport(**record["report"]), int(record["frames"])
        return True

    def compute(self, file: FrameFile, restart: bool, on_step: Progress) -> int:
        """Step to the end from the start or from the last stored frame."""
        scene, table = self._scene, self._scene.motion
        self._camera = _camera(scene)
        self._demand_memory()
        flight = self._flight = scene.build_flight(self.shell)
        film = FlightFilm(scene.flock, flight)
        start = flight.snapshot()
        fields: list[tuple[Any, ...]] = [(name, array.dtype.str, array.shape) for name, array in start.items()]
        frames = self._steps // table.store_every + 2
        size = 2 * frames * np.dtype([*fields, ("seconds", "<f8")]).itemsize
        demand_disk(f"a flight of {frames} frames", size, self.folder, "store fewer (store_every)")
        file.begin(self.identity, [*fields, ("seconds", "<f8")], restart)
        resumed, watch, before = file.count, Stopwatch(), 0.0
        for step in range(1, 1 + (0 if resumed else self._warm_up)):
            flight.advance(table.dt)
            film.choose_levels()
            on_step(step, self._total)
        flight.count_from(self._warm_up * table.dt)
        if resumed:
            last = file.records()[-1]
            flight.restore({name: last[name] for name in start})
            before = float(last["seconds"])
        else:
            file.append({**flight.snapshot(), "seconds": 0.0})
            watch = Stopwatch()
        for step in range((file.count - 1) * table.store_every + 1, self._steps + 1):
            flight.advance(table.dt)
            film.choose_levels()
            if step % table.store_every == 0 or step == self._steps:
                file.append({**flight.snapshot(), "seconds": before + watch()})
            on_step(self._warm_up + step, self._total)
        self._records, self.frames = file.records(), file.count
        return resumed

    def _demand_memory(self) -> None:
        """OptionError where the birds do not fit into memory."""
        birds, vertices = self._scene.flock.count, len(self.shell.rest_positions)
        what, each = f"a flock of {birds} birds of {vertices} vertices", _DRAWN_BYTES if self._drawn else _BIRD_BYTES
        demand_memory(what, float(each) * birds * vertices, "take fewer birds, or a coarser mesh")

    def write(self, formats: list[str], on_step: Progress) -> None:
        """Draw film and picture, collect the report, and write the arrays."""

        def advance(done: int, _total: int) -> None:
            on_step(self._warm_up + self._steps + done, self._total)

        self._report = self._draw(formats, advance)
        arrays = {name: self._records[name] for name in _KEPT} | {"faces": np.asarray(self.shell.mesh.faces)}
        system = self._scene.unit_system
        named = _UNITS | {"coordinates": f"{system.length} sqrt({system.mass})"}
        fields = {name: Field("fiu", None, named.get(name, "")) for name in arrays}
        write_npz(self.path("npz"), **_FLIGHT.arrays(arrays, system, fields))
        del self._records  # mapped, and about to be deleted

    def record(self) -> dict[str, Any]:
        """The report."""
        return {"status": str(Outcome.COMPLETED), "report": asdict(self._report)}

    def result(self, files: list[Path], resumed: int) -> FlightResult:
        """The report and the files."""
        return FlightResult(files, resumed, self._report, self.frames)

    def _draw(self, formats: list[str], on_frame: Progress) -> FlightReport:
        """Draw the film and the picture; return the report."""
        scene, flight, records = self._scene, self._flight, self._records
        table, crowd, film = scene.flock.camera, flight.crowd, FlightFilm(scene.flock, flight)
        single = np.asarray(crowd.basis.shell.mesh.faces)
        offsets = crowd.vertices * np.arange(crowd.count)[:, None, None]
        names = tuple(flight.snapshot())

        stage = None
        if table.ground is not None:
            stage = FlightStage(self._camera, table.ground, crowd.basis.shell.rest_positions, crowd.count)

        def seen(film: FlightFilm, at: int) -> list[NDArray[Any]]:
            """Everything that moves, as the camera sees it that goes along."""
            flight.restore({name: records[at][name] for name in names})
            positions, shift = film.positions(), film.shift()
            moved = [] if stage is None else stage.move(positions, shift)
            return [(positions - shift).reshape(-1, 3), *moved]

        def surfaces(at: int) -> list[ShadedSurface]:
            shapes = seen(FlightFilm(scene.flock, flight), at)
            birds = ShadedSurface(shapes[0], (single + offsets).reshape(-1, 3), table.color, lined=False)
            about = [birds, *(stage.surfaces() if stage is not None else [])]
            moved = [replace(one, vertices=shape) for one, shape in zip(about, shapes, strict=False)]
            return moved + about[len(moved) :]

        frames = (seen(film, at) for at in range(len(records)))
        if "mp4" in formats:
            rate = 1.0 / (scene.unit_system.seconds * scene.motion.dt * scene.motion.store_every)
            shown = surfaces(0)
            count = 1 if stage is None else 4
            each = [map(itemgetter(k), copy) for k, copy in enumerate(tee(frames, count))]
            write_film(
                self.path("mp4"), shown, [*each, *[None] * (len(shown) - count)], total=len(records),
                camera=self._camera, fps=rate, size=table.size, rate_factor=table.rate_factor, on_frame=on_frame,
            )  # fmt: skip
        else:
            deque(frames, maxlen=0)  # for the report
        report = film.report(float(records["seconds"][-1]))
        if "png" in formats:
            at = -1 if table.still is None else int(np.abs(records["time"] - table.still).argmin())
            draw_surfaces(self.path("png"), surfaces(at), self._camera, size=table.size)
            on_frame(self._drawn, self._drawn)
        return report


def _camera(scene: FlockScene) -> Camera:
    """The camera, refused before the flight if at all."""
    table = scene.flock.camera
    with located(scene.file, "flock.camera", table):
        checked_size(table.size, even="mp4" in scene.output.formats)
        rgb(table.color)
        return look_at(table.position, table.target, math.radians(table.view_angle), table.size[0] / table.size[1])


new_run.register(FlockScene, FlockRun)
