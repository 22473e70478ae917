"""Flying a flock that a scene declares: stepped into a file of frames, then drawn from it, with what detail it cost."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modalshell.atomic_io import digest, read_npz, read_record, write_npz, write_record
from modalshell.crowd import Flight
from modalshell.motion.recorder import step_count
from modalshell.outcome import Outcome
from modalshell.provenance import run_record
from modalshell.render import ShadedSurface, draw_surface, look_at, write_film
from modalshell.render.camera import Camera
from modalshell.render.content import checked_size, rgb
from modalshell.run.flight_film import FlightFilm, FlightReport
from modalshell.run.frame_file import FrameFile
from modalshell.scene import Scene
from modalshell.scene.read import located
from modalshell.shell import Shell
from modalshell.timings import Stopwatch
from modalshell.typing import Progress

_KEPT = ("time", "positions", "directions", "accelerations", "coordinates", "levels")


@dataclass(frozen=True)
class FlightResult:
    """What flying a flock gave.

    Attributes
    ----------
    report : FlightReport
        What it cost, and what its levels of detail show.
    frames : int
        Stored frames.
    files : list of Path
        The results' files: boids, modal coordinates and levels of all frames in ``NAME.npz``, then the others.
    resumed : int
        Frames that an earlier, stopped run had left.
    """

    report: FlightReport
    frames: int
    files: list[Path]
    resumed: int

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
            f"completed, {self.frames} frames{kept} of {found.birds} birds, stepped in {found.seconds_steps:.3g} s; "
            f"{parts}; levels show at most {found.largest_pixels:.2g} of {found.allowed_pixels:g} pixels"
        )


def run_flock(
    scene: Scene,
    shell: Shell,
    folder: Path,
    file: FrameFile,
    identity: dict[str, str],
    restart: bool,
    on_step: Progress | None,
) -> FlightResult:
    """Fly the flock of a scene, or go on with a flight that was stopped, and write its results.

    Parameters
    ----------
    scene, shell, folder, restart, on_step
        As in :func:`modalshell.run_scene`.
    file : FrameFile
        Open file of frames, which is removed once the results are whole.
    identity : dict of str
        All that decides the frames.
    """
    names = [f"{scene.name}.{kind}" for kind in dict.fromkeys(["npz", *scene.output.formats, "json"])]
    files = [folder / name for name in names]
    record = None if restart else _whole_record(files)
    if record is not None and record.get("identity") == identity:
        return FlightResult(FlightReport(**record["report"]), record["frames"], files, record["frames"])
    if not restart:
        file.refuse_others(identity)
    camera = _camera(scene)
    flight = scene.build_flight(shell)
    assert scene.motion is not None
    steps = step_count(scene.motion.duration, scene.motion.dt)
    drawn = -(-steps // scene.motion.store_every) + 1 if "mp4" in scene.output.formats else 0

    def advance(done: int) -> None:
        if on_step is not None:
            on_step(done, steps + drawn)

    records, resumed = _fly(scene, flight, file, identity, restart, advance)
    files[-1].unlink(missing_ok=True)
    report = _draw(scene, flight, camera, records, folder, lambda done, _: advance(steps + done))
    arrays = {name: records[name] for name in _KEPT} | {"faces": np.asarray(shell.mesh.faces)}
    write_npz(files[0], **arrays)
    document = {"scene": scene.name, "identity": identity, "frames": len(records), "report": asdict(report)}
    document |= {"record": run_record(scene.content()), "arrays": digest(arrays)}
    write_record(files[-1], document)
    frames = len(records)
    del records  # mapped
    file.remove()
    return FlightResult(report, frames, files, resumed)


def _whole_record(files: list[Path]) -> dict[str, Any] | None:
    """The record of results that are there already, and whole; None where they are not."""
    found = read_record(files[-1])
    if found is None or not all(path.exists() for path in files):
        return None
    try:
        return found if digest(read_npz(files[0])) == found.get("arrays") else None
    except Exception:  # whatever zip and NumPy make of a damaged file: it is flown again
        return None


def _fly(
    scene: Scene,
    flight: Flight,
    file: FrameFile,
    identity: dict[str, str],
    restart: bool,
    on_step: Callable[[int], None],
) -> tuple[NDArray[Any], int]:
    """Step to the end from the start or from the last stored frame; the records, and how many there were."""
    assert scene.flock is not None
    assert scene.motion is not None
    film, table = FlightFilm(scene, flight), scene.motion
    start = flight.snapshot()
    fields: list[tuple[Any, ...]] = [(name, array.dtype.str, array.shape) for name, array in start.items()]
    file.begin(identity, [*fields, ("seconds", "<f8")], restart)
    resumed, total, watch, before = file.count, step_count(table.duration, table.dt), Stopwatch(), 0.0
    if resumed:
        last = file.records()[-1]
        flight.restore({name: last[name] for name in start})
        before = float(last["seconds"])
    else:
        for _ in range(step_count(scene.flock.warm_up, table.dt) if scene.flock.warm_up else 0):
            flight.advance(table.dt)
            film.choose_levels()
        flight.flock.time = 0.0
        file.append({**flight.snapshot(), "seconds": 0.0})
        watch = Stopwatch()
    for step in range((file.count - 1) * table.store_every + 1, total + 1):
        flight.advance(table.dt)
        film.choose_levels()
        if step % table.store_every == 0 or step == total:
            file.append({**flight.snapshot(), "seconds": before + watch()})
        on_step(step)
    return file.records(), resumed


def _camera(scene: Scene) -> Camera:
    """The camera, refused before the flight if at all."""
    assert scene.flock is not None
    lens = scene.flock.camera
    with located(scene.file, "flock.camera", lens):
        checked_size(lens.size, even="mp4" in scene.output.formats)
        rgb(lens.color)
        return look_at(lens.position, lens.target, math.radians(lens.view_angle), lens.size[0] / lens.size[1])


def _draw(
    scene: Scene, flight: Flight, camera: Camera, records: NDArray[Any], folder: Path, on_frame: Progress
) -> FlightReport:
    """Draw the film and the picture; return the report."""
    assert scene.flock is not None
    assert scene.motion is not None
    lens, crowd, film = scene.flock.camera, flight.crowd, FlightFilm(scene, flight)
    single = np.asarray(crowd.basis.shell.mesh.faces)
    offsets = crowd.vertices * np.arange(crowd.count)[:, None, None]
    names = tuple(flight.snapshot())

    def surface(at: int) -> ShadedSurface:
        flight.restore({name: records[at][name] for name in names})
        shape = FlightFilm(scene, flight).positions().reshape(-1, 3)
        return ShadedSurface(shape, (single + offsets).reshape(-1, 3), lens.color, lined=False)

    def frames() -> Iterator[NDArray[Any]]:
        for record in records:
            flight.restore({name: record[name] for name in names})
            yield film.positions().reshape(-1, 3)

    if "mp4" in scene.output.formats:
        rate = 1.0 / (scene.motion.dt * scene.motion.store_every)
        path = folder / f"{scene.name}.mp4"
        write_film(
            path, [surface(0)], [frames()], total=len(records), camera=camera, fps=rate, size=lens.size,
            rate_factor=lens.rate_factor, on_frame=on_frame,
        )  # fmt: skip
    else:
        deque(frames(), maxlen=0)  # for the report
    report = film.report(float(records["seconds"][-1]))
    if "png" in scene.output.formats:
        at = -1 if lens.still is None else int(np.abs(records["time"] - lens.still).argmin())
        draw_surface(folder / f"{scene.name}.png", surface(at), camera, size=lens.size)
    return report
