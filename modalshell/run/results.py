"""Results of a run as files: the archive, VTK files, a film, a picture."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import final

import numpy as np

from modalshell.export import save_trajectory
from modalshell.motion import Trajectory
from modalshell.render import ShadedSurface, View, draw_views, write_film
from modalshell.shell.fields import FIELDS, TENSORS, scalar_of
from modalshell.typing import Array, Progress


@final
@dataclass(frozen=True)
class _Colouring:
    """Values (F, n) at the vertices that colour a motion, their name with its unit, and a colour map."""

    values: Array
    label: str
    colormap: str

    @classmethod
    def of(cls, run: Trajectory, name: str) -> _Colouring:
        """The field of a trajectory, averaged over the triangles at each vertex by their area at rest."""
        scalars = scalar_of(name, run.fields[name])
        rest = run.rest_positions[run.faces]
        areas = 0.5 * np.linalg.norm(np.cross(rest[:, 1] - rest[:, 0], rest[:, 2] - rest[:, 0]), axis=1)
        count, corners = run.positions.shape[1], run.faces.ravel()
        around = np.bincount(corners, np.repeat(areas, 3), count)
        around[around == 0.0] = 1.0
        values = np.stack([np.bincount(corners, np.repeat(areas * one, 3), count) / around for one in scalars])
        unit = run.units.of(FIELDS[name])
        label = name.replace("_", " ") + (f" [{unit}]" if unit else "")
        return cls(values, label, "coolwarm" if name in TENSORS else "viridis")

    def spread(self, frames: int | slice) -> tuple[float, float]:
        """Values at the ends of the colour map: about zero for fields of either sign."""
        low, high = float(self.values[frames].min()), float(self.values[frames].max())
        if self.colormap == "coolwarm":
            high = max(abs(low), abs(high))
            return -high, high
        return low, high


_FILM_RATE = 60.0
"""Frames a second of a film, at most."""


def write_results(
    run: Trajectory,
    folder: Path,
    name: str,
    formats: Iterable[str],
    *,
    title: str = "",
    rate: float | None = None,
    color: str | None = None,
    on_step: Progress | None = None,
) -> list[Path]:
    """Write ``NAME.format`` into ``folder`` for each format, atomically; return the paths.

    A film shows ``rate`` stored frames per second, at real speed if None. Films and pictures are coloured by
    the trajectory's field ``color``.
    """
    return [
        _write(run, folder / f"{name}.{kind}", title or name, rate, color, on_step) for kind in dict.fromkeys(formats)
    ]


def _write(
    run: Trajectory, path: Path, title: str, rate: float | None, color: str | None, on_step: Progress | None
) -> Path:
    shown = _Colouring.of(run, color) if color is not None and path.suffix in (".png", ".mp4") else None
    if path.suffix == ".png":
        surface = ShadedSurface(run.positions[-1], run.faces, smooth=True)
        rest = ShadedSurface(run.rest_positions, run.faces, color="#999999", style="outline")
        if shown is None:
            return draw_views([View([surface, rest], title=title)], path)
        surface = replace(surface, scalars=shown.values[-1], label=shown.label)
        return draw_views(
            [View([surface, rest], title=title)], path, colormap=shown.colormap, scalar_range=shown.spread(-1)
        )
    if path.suffix == ".mp4":
        if rate is None:
            rate = 1.0 / float(run.times[1] - run.times[0]) if len(run.times) > 1 else _FILM_RATE
        every = int(np.ceil(rate / _FILM_RATE - 1e-9))  # at real speed, with as many frames as a screen shows
        surface = ShadedSurface(run.positions[0], run.faces, smooth=True)
        if shown is None:
            return write_film(path, [surface], [run.positions[::every]], fps=rate / every, on_frame=on_step)
        surface = replace(surface, scalars=shown.values[0], label=shown.label)
        return write_film(
            path,
            [surface],
            [run.positions[::every]],
            fps=rate / every,
            colormap=shown.colormap,
            scalars=[shown.values[::every]],
            scalar_range=shown.spread(slice(None)),
            on_frame=on_step,
        )
    return save_trajectory(run, path, on_frame=on_step)
