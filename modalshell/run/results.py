"""Results of a run as files: the archive, VTK files, a film, a picture."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from modalshell.export import save_trajectory
from modalshell.motion import Trajectory
from modalshell.render import ShadedSurface, View, draw_views, write_film
from modalshell.typing import Progress

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
    on_step: Progress | None = None,
) -> list[Path]:
    """Write ``NAME.format`` into ``folder`` for each format, whole or not at all; return the paths.

    A film shows ``rate`` stored frames a second, or plays at real speed without it.
    """
    return [_write(run, folder / f"{name}.{kind}", title or name, rate, on_step) for kind in dict.fromkeys(formats)]


def _write(run: Trajectory, path: Path, title: str, rate: float | None, on_step: Progress | None) -> Path:
    if path.suffix == ".png":
        surface = ShadedSurface(run.positions[-1], run.faces, smooth=True)
        rest = ShadedSurface(run.rest_positions, run.faces, color="#999999", style="outline")
        return draw_views([View([surface, rest], title=title)], path)
    if path.suffix == ".mp4":
        if rate is None:
            rate = 1.0 / float(run.times[1] - run.times[0]) if len(run.times) > 1 else _FILM_RATE
        every = int(np.ceil(rate / _FILM_RATE - 1e-9))  # at real speed, with as many frames as a screen shows
        surface = ShadedSurface(run.positions[0], run.faces, smooth=True)
        return write_film(path, [surface], [run.positions[::every]], fps=rate / every, on_frame=on_step)
    return save_trajectory(run, path, on_frame=on_step)
