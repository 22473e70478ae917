"""Films and pictures of a surface too large to hold all its frames, from a camera that stands somewhere."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from modalshell.render.camera import Camera
from modalshell.render.content import ShadedSurface, checked_path, checked_positions, checked_size
from modalshell.render.film import RATE_FACTOR, encode
from modalshell.render.open_painter import open_painter
from modalshell.render.surfaces import scalar_colors
from modalshell.render.views import save_picture


def write_streamed_film(
    path: str | Path,
    surface: ShadedSurface,
    frames: Iterable[NDArray[np.float64]],
    total: int,
    camera: Camera,
    *,
    fps: float,
    size: tuple[int, int],
    colormap: str = "viridis",
    rate_factor: int = RATE_FACTOR,
    on_frame: Callable[[int, int], None] | None = None,
) -> Path:
    """
    Write a film, taking each frame as it is drawn.

    Parameters
    ----------
    path : str or Path
        File to write, ending in ``.mp4``; it appears only when the film is complete.
    surface : ShadedSurface
        What is seen; its scalars, if any, are coloured from their least to their largest.
    frames : iterable of ndarray, shape (n, 3)
        Positions, frame by frame [m].
    total : int
        Number of frames.
    camera : Camera
        Where the camera is; see `look_at`.
    fps : float
        Frames per second.
    size : tuple of int
        Width and height, both even [pixels].
    colormap : str
        Matplotlib colour map for scalars.
    rate_factor : int
        H.264's constant rate factor: higher makes a smaller and coarser film.
    on_frame : callable, optional
        As in `write_film`.

    Returns
    -------
    Path
        The file written.
    """
    target, size = checked_path(path, ".mp4"), checked_size(size, even=True)

    def pictures() -> Iterator[NDArray[np.uint8]]:
        with open_painter(size) as painter:
            painter.start([surface], camera, scalar_colors([surface], colormap))
            for positions in frames:
                painter.move(0, checked_positions(positions, "frames"))
                yield painter.image()

    encode(target, pictures(), size, fps, total, on_frame, rate_factor)
    return target


def draw_surface(
    path: str | Path, surface: ShadedSurface, camera: Camera, *, size: tuple[int, int], colormap: str = "viridis"
) -> Path:
    """Draw one frame of such a film into a PNG file."""
    target, size = checked_path(path, ".png"), checked_size(size)
    with open_painter(size) as painter:
        painter.start([surface], camera, scalar_colors([surface], colormap))
        save_picture(painter.image(), target)
    return target
