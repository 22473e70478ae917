"""Results of a run as files: the archive, VTK files, a film, a picture."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, final

import numpy as np

from modalshell.core.typing import Array, Progress, unheard
from modalshell.export import save_trajectory
from modalshell.motion import Trajectory
from modalshell.motion.colouring import Colouring
from modalshell.motion.pace import slowing
from modalshell.render import ShadedSurface, View, draw_views, write_film
from modalshell.render.bodies import bodies_at, moving_bodies
from modalshell.render.content import DEFAULT_CAMERA
from modalshell.render.stage import DOWN, LOWEST_VIEW, Stage

if TYPE_CHECKING:
    from modalshell.contact import Contact


_FILM_RATE = 60.0
"""Frames a second of a film, at most."""


@final
@dataclass(frozen=True)
class Look:
    """How films and pictures of a motion look."""

    rate: float | None = None
    """Stored frames shown a second; without it real speed, slower if too brief to be seen (see `slowing`)."""
    color: str | None = None
    """Field of the trajectory that colours them, or "displacement"."""
    camera: tuple[float, float, float] = DEFAULT_CAMERA
    """Direction from the shell to the camera."""
    turntable: bool = False
    """Whether the shell turns once about the vertical in a film."""
    still: float | None = None
    """Time of a picture [s]; the end without it."""
    title: str = ""
    """Of a picture; the name of its file without it."""
    model: str = ""
    """Name of the model, for the corner of a film."""
    style: Literal["stage", "plain"] = "stage"
    """Whether films have a ground, a shadow, and the model and the time in a corner, or show the shell alone."""
    follow: bool = False
    """Whether the camera of a film moves with the middle of the shell."""
    down: tuple[float, float, float] = DOWN
    """Axis along which a film's ground is below, and its sign."""

    def plain(self) -> dict[str, Any]:
        """The attributes as JSON has them; films of before the last two were there are not made again."""
        given = asdict(self) | {"camera": list(self.camera), "down": list(self.down)}
        unsaid = {"follow": self.follow, "down": self.down != DOWN}
        return {name: value for name, value in given.items() if unsaid.get(name, True)}


def write_result(
    run: Trajectory, path: Path, look: Look, on_step: Progress = unheard, contacts: Sequence[Contact] = ()
) -> Path:
    """Write a motion in the format of the file's suffix, atomically; return the path.

    Films and pictures show the colliders of ``contacts``, too.
    """
    shown = Colouring.of(run, look.color) if look.color is not None and path.suffix in (".png", ".mp4") else None
    colours: dict[str, Any] = {} if shown is None else {"colormap": shown.colormap}
    if path.suffix == ".png":
        frame = len(run.times) - 1 if look.still is None else int(np.abs(run.times - look.still).argmin())
        surface = ShadedSurface(run.positions[frame], run.faces, smooth=True)
        rest = ShadedSurface(run.rest_positions, run.faces, color="#999999", style="outline")
        title = look.title or path.stem
        if look.still is not None:
            title = f"{title}, {run.times[frame]:.4g} {run.units.time}"
        if shown is not None:
            surface = replace(surface, scalars=shown.values[frame], label=shown.label)
            colours["scalar_range"] = shown.spread(frame)
        bodies = bodies_at(run.positions, run.faces, run.times, contacts, float(run.times[frame]))
        return draw_views([View([surface, rest, *bodies], title=title, camera=look.camera)], path, **colours)
    if path.suffix == ".mp4":
        slowed = film_slowing(run, look)
        rate = look.rate or _real_rate(run) / slowed
        every = int(np.ceil(rate / _FILM_RATE - 1e-9))  # with as many frames as a screen shows
        positions = _turned(run) if look.turntable else run.positions
        surface = ShadedSurface(positions[0], run.faces, smooth=True)
        if shown is not None:
            surface = replace(surface, scalars=shown.values[0], label=shown.label)
            colours |= {"scalars": [shown.values[::every]], "scalar_range": shown.spread()}
        surfaces: list[ShadedSurface] = [surface]
        motions: list[Any] = [positions[::every]]
        touched = () if look.turntable else contacts
        for body, moved in moving_bodies(run.positions, run.faces, run.times, touched, run.times[::every]):
            surfaces.append(body)
            motions.append(np.broadcast_to(moved, (len(motions[0]), *moved.shape[1:])))
        framed = len(surfaces)
        if look.style == "stage":
            colours["texts"] = _texts(run, look.model, run.times[::every], slowed)
            # A scene with colliders has its own ground.
            height = -float(np.dot(look.camera, look.down))
            if framed == 1 and height > LOWEST_VIEW * float(np.linalg.norm(look.camera)):
                stage = Stage(motions[0], run.faces, look.down)
                surfaces, motions = surfaces + stage.surfaces, motions + stage.motions
        if look.follow:
            framed, motions = 1, _followed(surfaces, motions)
        if "scalars" in colours:
            colours["scalars"] += [None] * (len(surfaces) - 1)
        return write_film(
            path, surfaces, motions, fps=rate / every, camera=look.camera, framed=framed, on_frame=on_step, **colours
        )
    return save_trajectory(run, path, on_frame=on_step)


def _followed(surfaces: Sequence[ShadedSurface], motions: Sequence[Any]) -> list[Array]:
    """All motions as a camera sees them that moves with the middle of the first."""
    middle = np.asarray(motions[0], dtype=np.float64).mean(axis=1, keepdims=True)
    still = (surface.vertices if motion is None else motion for surface, motion in zip(surfaces, motions, strict=True))
    return [np.asarray(one, dtype=np.float64) - (middle - middle[0]) for one in still]


def _real_rate(run: Trajectory) -> float:
    """Stored frames a second at real speed."""
    return 1.0 / (run.units.seconds * float(run.times[1] - run.times[0])) if len(run.times) > 1 else _FILM_RATE


def film_slowing(run: Trajectory, look: Look) -> int:
    """How many times slower than real a film with that look shows a motion, where the look does not say how fast."""
    return slowing(run.times, run.units.seconds) if look.rate is None else 1


def _texts(run: Trajectory, model: str, times: Array, slowed: int = 1) -> list[str]:
    """The corner of each frame: the model, the time, how slowed, and the last error bar that was found up to then."""
    name, bars = f"{model}, " if model else "", run.bars
    texts = []
    digits = 2
    if len(times) > 1:  # those in which the times of two frames differ
        digits = max(digits, math.ceil(-math.log10(float(times[1] - times[0])) - 1e-9))
    for time in times:
        text = f"{name}{time:.{digits}f} {run.units.time}" + (f", slowed {slowed} times" if slowed > 1 else "")
        before = 0 if bars is None else int(np.searchsorted(bars.times, time, side="right"))
        if bars is not None and before:
            text = f"{text}, {bars.texts()[before - 1]}"
        texts.append(text)
    return texts


def _turned(run: Trajectory) -> Array:
    """Positions (F, n, 3), turned once about the vertical through the middle of the shell at rest."""
    middle = 0.5 * (run.rest_positions.min(axis=0) + run.rest_positions.max(axis=0))
    angle = 2.0 * np.pi * np.arange(len(run.times)) / len(run.times)
    cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
    x, y, z = np.moveaxis(np.asarray(run.positions, dtype=np.float64) - middle, -1, 0)
    return np.stack([cosine * x - sine * y, sine * x + cosine * y, z], axis=-1) + middle
