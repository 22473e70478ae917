"""Films of moving shells: MP4 with H.264 through the ffmpeg that imageio-ffmpeg carries."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modalshell.errors import OptionError
from modalshell.render.camera import frame_points
from modalshell.render.compose import Page, paste
from modalshell.render.open_painter import open_painter
from modalshell.render.scene import (
    DEFAULT_CAMERA,
    Color,
    ShadedSurface,
    checked_direction,
    checked_path,
    checked_positions,
    checked_size,
)


def write_film(
    path: str | Path,
    frames_positions: ArrayLike,
    faces: ArrayLike,
    *,
    fps: float = 30.0,
    color: Color = "#8fb3d9",
    size: tuple[int, int] = (960, 720),
    rest: ArrayLike | None = None,
    title: str | None = None,
    camera: tuple[float, float, float] = DEFAULT_CAMERA,
    zoom: float = 1.0,
    parallel: bool = False,
    smooth: bool = False,
    edges: bool = False,
    on_frame: Callable[[int, int], None] | None = None,
) -> Path:
    """
    Write a film of one moving surface.

    Parameters
    ----------
    path : str or Path
        File to write, ending in ``.mp4``; it appears only when the film is complete.
    frames_positions : array_like, shape (F, n, 3)
        Positions in each frame [m].
    faces : array_like of int, shape (T, 3)
        Triangles.
    fps : float
        Frames per second.
    color : str or tuple of float
        Colour of the surface.
    size : tuple of int
        Width and height, both even [pixels].
    rest : array_like, shape (n, 3), optional
        Rest positions, drawn as a pale outline [m].
    title : str, optional
        Text above the picture.
    camera : tuple of float
        Direction from target to camera; the framing holds the whole motion.
    zoom : float
        Magnification over this framing.
    parallel : bool
        Parallel instead of perspective projection.
    smooth, edges : bool
        As in `ShadedSurface`.
    on_frame : callable, optional
        Called as ``on_frame(done, total)`` after each frame; what it raises ends the film and leaves no file.

    Returns
    -------
    Path
        The file written.
    """
    positions = checked_positions(frames_positions, "frames_positions", frames=True)
    size = checked_size(size, even=True)
    if not (math.isfinite(fps) and 0.0 < fps <= 1000.0):
        raise OptionError(f"fps must lie in (0, 1000] (got {fps!r})")
    if not (math.isfinite(zoom) and zoom > 0.0):
        raise OptionError(f"zoom must be a positive number (got {zoom!r})")
    surfaces = [ShadedSurface(positions[0], faces, color, smooth=smooth, edges=edges)]
    cloud = positions.reshape(-1, 3)
    if rest is not None:
        outline = checked_positions(rest, "rest")
        if outline.shape != positions.shape[1:]:
            raise OptionError(f"rest must have shape {positions.shape[1:]}, as each frame (got {outline.shape})")
        surfaces.append(ShadedSurface(outline, faces, "0.55", opacity=0.6, style="outline"))
        cloud = np.concatenate([cloud, outline])
    target = checked_path(path, ".mp4")
    page = Page(size, [(title, None)], 1)
    view = frame_points(cloud, checked_direction(camera), page.cell[0] / page.cell[1], zoom=zoom, parallel=parallel)

    def pictures() -> Iterator[NDArray[np.uint8]]:
        blank = np.full((page.cell[1], page.cell[0], 3), 255, dtype=np.uint8)
        canvas = page.paint([blank])
        with open_painter(page.cell) as painter:
            painter.start(surfaces, view, None)
            for frame in positions:
                painter.move(0, frame)
                paste(canvas, page.corners[0], painter.image())
                yield canvas

    _encode(target, pictures(), size, fps, len(positions), on_frame)
    return target


def _encode(
    target: Path,
    pictures: Iterator[NDArray[np.uint8]],
    size: tuple[int, int],
    fps: float,
    total: int,
    on_frame: Callable[[int, int], None] | None,
) -> None:
    """Send pictures to ffmpeg, under a temporary name until the last one is in."""
    import imageio_ffmpeg

    partial = target.with_name(f".{target.stem}.{os.getpid()}.partial.mp4")
    writer = imageio_ffmpeg.write_frames(
        str(partial), size, fps=fps, codec="libx264", pix_fmt_in="rgb24", pix_fmt_out="yuv420p", quality=None,
        macro_block_size=2, output_params=["-crf", "18", "-movflags", "+faststart"],
    )  # fmt: skip
    try:
        writer.send(None)
        for index, picture in enumerate(pictures):
            writer.send(np.ascontiguousarray(picture))
            if on_frame is not None:
                on_frame(index + 1, total)
        writer.close()
        os.replace(partial, target)
    finally:
        writer.close()
        partial.unlink(missing_ok=True)
