"""Films of moving shells: MP4 with H.264 through the ffmpeg that imageio-ffmpeg carries."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modalshell.errors import OptionError
from modalshell.render.camera import frame_points
from modalshell.render.compose import Page, paste
from modalshell.render.content import (
    DEFAULT_CAMERA,
    Color,
    ShadedSurface,
    checked_direction,
    checked_path,
    checked_positions,
    checked_size,
)
from modalshell.render.open_painter import open_painter

RATE_FACTOR = 18
"""H.264's constant rate factor where nothing is said about a film's size: higher is smaller and coarser."""


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
    surfaces = [ShadedSurface(positions[0], faces, color, smooth=smooth, edges=edges)]
    motions: list[ArrayLike | None] = [positions]
    if rest is not None:
        outline = checked_positions(rest, "rest")
        if outline.shape != positions.shape[1:]:
            raise OptionError(f"rest must have shape {positions.shape[1:]}, as each frame (got {outline.shape})")
        surfaces.append(ShadedSurface(outline, faces, "0.55", opacity=0.6, style="outline"))
        motions.append(None)
    return write_scene_film(
        path, surfaces, motions, fps=fps, size=size, title=title, camera=camera, zoom=zoom, parallel=parallel,
        on_frame=on_frame,
    )  # fmt: skip


def write_scene_film(
    path: str | Path,
    surfaces: Sequence[ShadedSurface],
    motions: Sequence[ArrayLike | None],
    *,
    fps: float = 30.0,
    size: tuple[int, int] = (960, 720),
    title: str | None = None,
    camera: tuple[float, float, float] = DEFAULT_CAMERA,
    zoom: float = 1.0,
    parallel: bool = False,
    on_frame: Callable[[int, int], None] | None = None,
) -> Path:
    """
    Write a film of several surfaces, moving or not; the parameters not named here are those of `write_film`.

    Parameters
    ----------
    path : str or Path
        File to write, ending in ``.mp4``.
    surfaces : sequence of ShadedSurface
        What is seen.
    motions : sequence of array_like or None
        For each surface its positions in every frame, shape (F, n, 3) [m], or None where it stands still.

    Returns
    -------
    Path
        The file written.
    """
    shown = list(surfaces)
    moves = [None if motion is None else checked_positions(motion, "motions", frames=True) for motion in motions]
    counts = {len(motion) for motion in moves if motion is not None}
    if len(moves) != len(shown) or len(counts) != 1:
        raise OptionError(
            f"motions must hold one entry a surface, all of the same number of frames (got {len(moves)} for "
            f"{len(shown)} surfaces, with {sorted(counts)} frames)"
        )
    for surface, motion in zip(shown, moves, strict=True):
        if motion is not None and motion.shape[1:] != np.shape(surface.vertices):
            raise OptionError(f"a surface of {len(np.asarray(surface.vertices))} vertices moves by {motion.shape}")
    size = checked_size(size, even=True)
    if not (math.isfinite(fps) and 0.0 < fps <= 1000.0):
        raise OptionError(f"fps must lie in (0, 1000] (got {fps!r})")
    if not (math.isfinite(zoom) and zoom > 0.0):
        raise OptionError(f"zoom must be a positive number (got {zoom!r})")
    target = checked_path(path, ".mp4")
    page = Page(size, [(title, None)], 1)
    seen = [
        np.asarray(surface.vertices) if motion is None else motion.reshape(-1, 3)
        for surface, motion in zip(shown, moves, strict=True)
    ]
    aspect = page.cell[0] / page.cell[1]
    view = frame_points(np.concatenate(seen), checked_direction(camera), aspect, zoom=zoom, parallel=parallel)
    total = counts.pop()

    def pictures() -> Iterator[NDArray[np.uint8]]:
        blank = np.full((page.cell[1], page.cell[0], 3), 255, dtype=np.uint8)
        canvas = page.paint([blank])
        with open_painter(page.cell) as painter:
            painter.start(shown, view, None)
            for frame in range(total):
                for index, motion in enumerate(moves):
                    if motion is not None:
                        painter.move(index, motion[frame])
                paste(canvas, page.corners[0], painter.image())
                yield canvas

    encode(target, pictures(), size, fps, total, on_frame)
    return target


def encode(
    target: Path,
    pictures: Iterator[NDArray[np.uint8]],
    size: tuple[int, int],
    fps: float,
    total: int,
    on_frame: Callable[[int, int], None] | None,
    rate_factor: int = RATE_FACTOR,
) -> None:
    """Send pictures to ffmpeg, under a temporary name until the last one is in."""
    import imageio_ffmpeg

    partial = target.with_name(f".{target.stem}.{os.getpid()}.partial.mp4")
    writer = imageio_ffmpeg.write_frames(
        str(partial), size, fps=fps, codec="libx264", pix_fmt_in="rgb24", pix_fmt_out="yuv420p", quality=None,
        macro_block_size=2, output_params=["-crf", str(rate_factor), "-movflags", "+faststart"],
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
