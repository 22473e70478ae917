"""Flying a flock that a scene declares: stepped into a file of frames, then drawn from it, with what detail it cost."""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modalshell.crowd import LEVELS, Flight
from modalshell.files import write_npz, write_text
from modalshell.motion.simulate import step_count
from modalshell.run.frame_file import FrameFile
from modalshell.rungs import RotationStrain
from modalshell.rungs.model import Stopwatch
from modalshell.scene import Scene
from modalshell.shell import Shell
from modalshell.study import run_record

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]

_KEPT = ("time", "positions", "directions", "accelerations", "coordinates", "levels")


@dataclass(frozen=True)
class FlightReport:
    """What a flight cost, and what its levels of detail show.

    Attributes
    ----------
    birds, vertices : int
        Number of birds, and of vertices of one.
    shares : dict of float
        Part of the birds' frames at each level; "RSW" is the part with any share of it, counted in its own level too.
    allowed_pixels : float
        Largest distance allowed between a vertex as drawn and its place by MWTS.
    largest_error : float
        That distance, largest over all frames [m].
    largest_pixels : float
        The same as it is seen: over the distance of its bird times the focal length [pixels].
    strains_gap : float
        Largest distance of a vertex by RSW from its place by MWTS, among the birds where RSW was blended in [m].
    strains_jump_pixels : float
        Largest motion that a change of RSW's share caused between two frames [pixels].
    switches : int
        How often a bird changed its level.
    seconds_steps, seconds_positions : float
        Time spent in stepping boids and shells, and in levels and positions of stored frames [s].
    """

    birds: int
    vertices: int
    shares: dict[str, float]
    allowed_pixels: float
    largest_error: float
    largest_pixels: float
    strains_gap: float
    strains_jump_pixels: float
    switches: int
    seconds_steps: float
    seconds_positions: float


class FlightFilm:
    """Frames of a flight as a camera sees them: levels of detail, positions, and what these cost.

    Parameters
    ----------
    scene : Scene
        A scene with a flock.
    flight : Flight
        Its birds; their state is overwritten.
    """

    def __init__(self, scene: Scene, flight: Flight) -> None:
        assert scene.flock is not None
        self._flight, self._detail, lens = flight, scene.flock.detail, scene.flock.camera
        self._eye = np.array(lens.position)
        self._focal = 0.5 * lens.size[1] / math.tan(0.5 * math.radians(lens.view_angle))
        crowd = flight.crowd
        rest = crowd.basis.shell.rest_positions
        self._radius = float(np.linalg.norm(rest, axis=1).max())
        self._strains = RotationStrain(crowd.basis) if self._detail.strains_within else None
        self._out = np.empty((crowd.count, crowd.vertices, 3), crowd.dtype)
        self._before: dict[str, NDArray[Any]] = {}
        self._counts, self._frames = np.zeros(len(LEVELS) + 1), 0
        self._errors = {"metres": 0.0, "pixels": 0.0, "gap": 0.0, "jump": 0.0}
        self._switches, self._seconds = 0, 0.0

    def choose_levels(self) -> None:
        """Levels of detail at the present state."""
        self._flight.crowd.choose_levels(self._distances(), self._detail.pixels / self._focal)

    def positions(self) -> NDArray[Any]:
        """Vertex positions (B, n, 3) [m] at the present state; overwritten by the next call."""
        watch = Stopwatch()
        flock, crowd = self._flight.flock, self._flight.crowd
        frames, distances = self._flight.frames, self._distances()
        out = crowd.positions(frames, flock.positions, self._out)
        shares, gaps = np.zeros(crowd.count), np.zeros(crowd.count)
        if self._strains is not None:
            # One within the distance, zero beyond half as much again; smooth at both ends.
            part = np.clip(3.0 - 2.0 * distances / self._detail.strains_within, 0.0, 1.0)
            shares = part**2 * (3.0 - 2.0 * part)
            gaps = crowd.blend_strains(self._strains, shares, out, frames, flock.positions)
        self._seconds += watch()
        self._note(distances, shares, gaps)
        return out

    def _distances(self) -> Array:
        """From the camera to the nearest that a vertex of each bird may be, at least a tenth of a bird."""
        away = np.linalg.norm(self._flight.flock.positions - self._eye, axis=1)
        return np.asarray(np.maximum(away - self._radius, 0.1 * self._radius))

    def _note(self, distances: Array, shares: Array, gaps: Array) -> None:
        crowd = self._flight.crowd
        errors = crowd.level_errors()
        jumps = np.abs(shares - self._before.get("shares", shares)) * np.maximum(gaps, self._before.get("gaps", gaps))
        found = {"metres": errors, "pixels": self._focal * errors / distances, "gap": gaps}
        found["jump"] = self._focal * jumps / distances
        self._errors = {name: max(value, float(found[name].max())) for name, value in self._errors.items()}
        self._switches += int((crowd.levels != self._before.get("levels", crowd.levels)).sum())
        self._before = {"levels": crowd.levels.copy(), "shares": shares, "gaps": gaps}
        self._counts += [*np.bincount(crowd.levels, minlength=len(LEVELS)), np.count_nonzero(shares)]
        self._frames += 1

    def report(self, seconds_steps: float) -> FlightReport:
        """The report on the frames so far."""
        crowd = self._flight.crowd
        parts = self._counts / (crowd.count * self._frames)
        return FlightReport(
            birds=crowd.count,
            vertices=crowd.vertices,
            shares=dict(zip((*LEVELS, "RSW"), parts.tolist(), strict=True)),
            allowed_pixels=self._detail.pixels,
            largest_error=self._errors["metres"],
            largest_pixels=self._errors["pixels"],
            strains_gap=self._errors["gap"],
            strains_jump_pixels=self._errors["jump"],
            switches=self._switches,
            seconds_steps=seconds_steps,
            seconds_positions=self._seconds,
        )


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
    record = {} if restart else _record(files)
    if record.get("identity") == identity:
        return FlightResult(FlightReport(**record["report"]), record["frames"], files, record["frames"])
    if not restart:
        file.refuse_others(identity)
    flight = scene.build_flight(shell)
    records, resumed = _fly(scene, flight, file, identity, restart, on_step)
    files[-1].unlink(missing_ok=True)
    report = _write(scene, flight, records, folder)
    document = {"scene": scene.name, "identity": identity, "frames": len(records), "report": asdict(report)}
    document["record"] = run_record(scene.content())
    write_text(files[-1], json.dumps(document, indent=1) + "\n")
    frames = len(records)
    del records  # mapped
    file.remove()
    return FlightResult(report, frames, files, resumed)


def _record(files: list[Path]) -> dict[str, Any]:
    """The record of whole results that are there already, if they are."""
    try:
        found: dict[str, Any] = json.loads(files[-1].read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if all(path.exists() for path in files) else {}


def _fly(
    scene: Scene, flight: Flight, file: FrameFile, identity: dict[str, str], restart: bool, on_step: Progress | None
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
        if on_step is not None:
            on_step(step, total)
    return file.records(), resumed


def _write(scene: Scene, flight: Flight, records: NDArray[Any], folder: Path) -> FlightReport:
    """Write the archive, the film and the picture; return the report."""
    from modalshell.render import ShadedSurface, draw_surface, look_at, write_streamed_film

    assert scene.flock is not None
    assert scene.motion is not None
    lens, crowd, film = scene.flock.camera, flight.crowd, FlightFilm(scene, flight)
    camera = look_at(lens.position, lens.target, math.radians(lens.view_angle), lens.size[0] / lens.size[1])
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
        write_streamed_film(
            path, surface(0), frames(), len(records), camera, fps=rate, size=lens.size, rate_factor=lens.rate_factor
        )
    else:
        deque(frames(), maxlen=0)  # for the report
    report = film.report(float(records["seconds"][-1]))
    if "png" in scene.output.formats:
        at = -1 if lens.still is None else int(np.abs(records["time"] - lens.still).argmin())
        draw_surface(folder / f"{scene.name}.png", surface(at), camera, size=lens.size)
    write_npz(folder / f"{scene.name}.npz", **{name: records[name] for name in _KEPT}, faces=single)
    return report
