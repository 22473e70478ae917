"""Films of moving shells: MP4 with H.264 by the ffmpeg of imageio-ffmpeg."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Generator, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, closing
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modalshell.core.errors import OptionError
from modalshell.core.typing import Progress, unheard
from modalshell.files.atomic_io import replacing
from modalshell.render.backend import open_painters
from modalshell.render.camera import Camera, frame_points
from modalshell.render.compose import Page, paste
from modalshell.render.content import (
    DEFAULT_CAMERA,
    ShadedSurface,
    checked_direction,
    checked_path,
    checked_positions,
    checked_size,
)
from modalshell.render.painter import Painter
from modalshell.render.stage import with_texts
from modalshell.render.surfaces import scalar_colors

RATE_FACTOR = 18
"""H.264's constant rate factor where nothing is said about a film's size: higher is smaller and coarser."""
_AT_ONCE = 4
"""Frames that are drawn at the same time at most: each takes the memory of a painter."""


def write_film(
    path: str | Path,
    surfaces: Sequence[ShadedSurface],
    motions: Sequence[ArrayLike | Iterable[ArrayLike] | None],
    *,
    total: int | None = None,
    fps: float = 30.0,
    size: tuple[int, int] = (960, 720),
    title: str | None = None,
    camera: tuple[float, float, float] | Camera = DEFAULT_CAMERA,
    colormap: str = "viridis",
    scalars: Sequence[ArrayLike | None] = (),
    scalar_range: tuple[float, float] | None = None,
    rate_factor: int = RATE_FACTOR,
    framed: int | None = None,
    texts: Sequence[str] = (),
    on_frame: Progress = unheard,
) -> Path:
    """Write a film of surfaces, moving or not.

    Parameters
    ----------
    path : str or Path
        File to write, ending in ``.mp4``; it appears only when the film is complete.
    surfaces : sequence of ShadedSurface
        What is seen; scalars, if any, are coloured from their least to their largest, and named by a colour bar.
    motions : sequence of array_like, iterable or None
        For each surface its positions in every frame, shape (F, n, 3) [m], or None where it stands still. With `total`
        an iterable of positions (n, 3) serves too, of which a few frames are held at a time.
    total : int, optional
        Number of frames, where motions are iterables.
    fps : float
        Frames per second.
    size : tuple of int
        Width and height, both even [pixels].
    title : str, optional
        Text above the picture.
    camera : tuple of float or Camera
        Direction from target to camera, the framing holding the whole motion; or a camera that stands somewhere (see
        `look_at`), which iterables need.
    colormap : str
        Matplotlib colour map for scalars.
    scalars : sequence of array_like or None
        For each surface its scalars in every frame, shape (F, n), or None where they stay; left out where all do.
    scalar_range : tuple of float, optional
        Values at the ends of the colour map; by default the extremes over all frames.
    rate_factor : int
        H.264's constant rate factor: higher makes a smaller and coarser film.
    framed : int, optional
        How many of the first surfaces the camera frames; all without it.
    texts : sequence of str
        A text for the lower left of each frame; none where left out.
    on_frame : callable, optional
        Called as ``on_frame(done, total)`` after each frame; what it raises ends the film and leaves no file.

    Raises
    ------
    OptionError
        For motions that fit neither the surfaces nor one another, and options out of range.
    """
    shown = list(surfaces)
    moves, count = (list(motions), total) if total is not None else _checked_motions(shown, motions)
    size = checked_size(size, even=True)
    if not (math.isfinite(fps) and 0.0 < fps <= 1000.0):
        raise OptionError(f"fps must lie in (0, 1000] (got {fps!r})")
    target = checked_path(path, ".mp4")
    values = _checked_scalars(shown, scalars, count)
    if texts and len(texts) != count:
        raise OptionError(f"texts must hold one text a frame, {count} (got {len(texts)})")
    if scalar_range is None and (known := [one for one in values if one is not None]):
        scalar_range = min(float(one.min()) for one in known), max(float(one.max()) for one in known)
    colors = scalar_colors(shown, colormap, scalar_range)
    page = Page(size, [(title, None)], 1, bar=colors, bar_label=next((one.label for one in shown if one.label), None))
    if isinstance(camera, Camera):
        view = camera
    elif total is not None:
        raise OptionError("frames that come one by one cannot be framed before they are drawn: place a camera, look_at")
    else:
        passed = [
            surface.framed(np.asarray(surface.vertices if motion is None else motion, dtype=np.float64))
            for surface, motion in list(zip(shown, moves, strict=True))[:framed]
        ]
        view = frame_points(np.concatenate(passed), checked_direction(camera), page.cell[0] / page.cell[1])
    with ExitStack() as opened:
        painters = open_painters(page.cell, min(_AT_ONCE, count), film=all(surface.opacity == 1.0 for surface in shown))
        for painter in painters:
            opened.callback(painter.close)
            painter.start(shown, view, colors)
        drawn = opened.enter_context(closing(_pictures(page, painters, moves, values, count)))
        pictures: Iterator[NDArray[np.uint8]] = drawn
        if texts:
            left, top = page.corners[0]
            pictures = with_texts(drawn, texts, (left, top + page.cell[1]), page.font)
        _encode(target, pictures, size, fps, count, on_frame, rate_factor)
    return target


def _pictures(
    page: Page,
    painters: Sequence[Painter],
    motions: Sequence[ArrayLike | Iterable[ArrayLike] | None],
    scalars: Sequence[NDArray[np.float64] | None],
    count: int,
) -> Generator[NDArray[np.uint8]]:
    """The frames of a film, all in one array; several painters draw at the same time, each on a thread."""
    canvas = page.paint([np.full((page.cell[1], page.cell[0], 3), 255, dtype=np.uint8)])
    moving: dict[int, Iterator[ArrayLike]] = {
        index: iter(cast("Iterable[ArrayLike]", motion)) for index, motion in enumerate(motions) if motion is not None
    }

    def draw(frame: int, places: dict[int, NDArray[np.float64]]) -> NDArray[np.uint8]:
        painter = painters[frame % len(painters)]
        for index, positions in places.items():
            values = scalars[index]
            painter.move(index, positions, None if values is None else values[frame])
        return painter.image()

    def images() -> Iterator[NDArray[np.uint8]]:
        frames = (
            (frame, {index: checked_positions(next(rest), "motions") for index, rest in moving.items()})
            for frame in range(count)
        )
        if len(painters) == 1:
            yield from (draw(*frame) for frame in frames)
            return
        with ThreadPoolExecutor(len(painters)) as threads:
            waiting: deque[Future[NDArray[np.uint8]]] = deque()
            for frame in frames:
                done = waiting.popleft().result() if len(waiting) == len(painters) else None  # its painter is free
                waiting.append(threads.submit(draw, *frame))
                if done is not None:
                    yield done
            yield from (one.result() for one in waiting)

    for image in images():
        paste(canvas, page.corners[0], image)
        yield canvas


def _checked_motions(
    surfaces: Sequence[ShadedSurface], motions: Sequence[ArrayLike | Iterable[ArrayLike] | None]
) -> tuple[list[NDArray[np.float64] | None], int]:
    """Motions as arrays (F, n, 3) that fit their surfaces, and their number of frames."""
    moves = [
        None if motion is None else checked_positions(cast(ArrayLike, motion), "motions", frames=True)
        for motion in motions
    ]
    counts = {len(motion) for motion in moves if motion is not None}
    if len(moves) != len(surfaces) or len(counts) != 1:
        raise OptionError(
            f"motions must hold one entry a surface, all of the same number of frames (got {len(moves)} for "
            f"{len(surfaces)} surfaces, with {sorted(counts)} frames)"
        )
    for surface, motion in zip(surfaces, moves, strict=True):
        if motion is not None and motion.shape[1:] != np.shape(surface.vertices):
            raise OptionError(f"a surface of {len(np.asarray(surface.vertices))} vertices moves by {motion.shape}")
    return moves, counts.pop()


def _checked_scalars(
    surfaces: Sequence[ShadedSurface], scalars: Sequence[ArrayLike | None], frames: int
) -> list[NDArray[np.float64] | None]:
    """Scalars (F, n) of every surface, None where they stay; OptionError for others."""
    given = list(scalars) or [None] * len(surfaces)
    if len(given) != len(surfaces):
        raise OptionError(f"scalars must hold one entry a surface (got {len(given)} for {len(surfaces)})")
    checked: list[NDArray[np.float64] | None] = []
    for surface, one in zip(surfaces, given, strict=True):
        values = None if one is None else np.asarray(one, dtype=np.float64)
        expected = (frames, len(np.asarray(surface.vertices)))
        if values is not None and (values.shape != expected or not np.isfinite(values).all()):
            raise OptionError(f"scalars must be finite, {expected}, one per frame and vertex (got {values.shape})")
        checked.append(values)
    return checked


def _encode(
    target: Path,
    pictures: Iterator[NDArray[np.uint8]],
    size: tuple[int, int],
    fps: float,
    total: int,
    on_frame: Progress,
    rate_factor: int,
) -> None:
    """Send pictures to ffmpeg; the film is put in place when the last one is in."""
    import imageio_ffmpeg

    with replacing(target) as temporary:
        # This preset takes half the time of x264's own choice, for films of the same size.
        options = ["-preset", "veryfast", "-crf", str(rate_factor), "-movflags", "+faststart"]
        writer = imageio_ffmpeg.write_frames(
            str(temporary), size, fps=fps, codec="libx264", pix_fmt_in="rgb24", pix_fmt_out="yuv420p", quality=None,
            macro_block_size=2, output_params=options,
        )  # fmt: skip
        with closing(writer):
            writer.send(None)
            for index, picture in enumerate(pictures):
                writer.send(np.ascontiguousarray(picture))
                on_frame(index + 1, total)
