"""Drawing of a page of views into a picture."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from modalshell.core.errors import OptionError
from modalshell.files.atomic_io import replacing
from modalshell.render.backend import open_painter
from modalshell.render.camera import Camera, camera_axes, frame_points
from modalshell.render.compose import Entry, Page
from modalshell.render.content import ShadedSurface, View, checked_path, checked_size, rgb
from modalshell.render.surfaces import scalar_colors


def draw_views(
    views: Sequence[View],
    path: str | Path,
    *,
    columns: int | None = None,
    size: tuple[int, int] = (1600, 900),
    link_cameras: bool = True,
    legend: bool = True,
    title: str | None = None,
    headings: Sequence[str] = (),
    colormap: str = "viridis",
    scalar_range: tuple[float, float] | None = None,
    scalar_label: str | None = None,
) -> Path:
    """Draw views side by side into a PNG file.

    Parameters
    ----------
    views : sequence of View
        The cells, row by row.
    path : str or Path
        File to write, ending in ``.png``; its folder is made where it is missing.
    columns : int, optional
        Cells in a row; by default as many as show the shapes largest.
    size : tuple of int
        Width and height of the picture [pixels].
    link_cameras : bool
        Frame every view on the shapes of all views, so that sizes compare; otherwise each view on its own.
    legend : bool
        Name the colours of labelled surfaces, once each, below the cells.
    title : str, optional
        Text above all cells.
    headings : sequence of str
        Text at the left above each row of cells, one for each row; none by default.
    colormap : str
        Matplotlib colour map for scalars.
    scalar_range : tuple of float, optional
        Values at the ends of the colour map; by default the extremes over all views.
    scalar_label : str, optional
        Title of the colour bar; by default the label of the first surface with scalars.
    """
    cells = list(views)
    if not cells or not all(isinstance(view, View) for view in cells):
        raise OptionError("views must be a sequence of at least one View")
    if columns is not None and not 1 <= columns <= 64:
        raise OptionError(f"columns must lie from 1 to 64 (got {columns})")
    size = checked_size(size)
    target = checked_path(path, ".png")
    colors = scalar_colors([surface for view in cells for surface in view.surfaces], colormap, scalar_range)
    clouds = [np.concatenate([one.framed(np.asarray(one.vertices)) for one in view.surfaces]) for view in cells]
    if link_cameras:
        clouds = [np.concatenate(clouds)] * len(cells)

    def layout(count: int) -> Page:
        return Page(
            size, [(view.title, view.subtitle) for view in cells], min(count, len(cells)), title,
            _legend_entries(cells) if legend else (), colors, scalar_label or _scalar_label(cells), headings,
        )  # fmt: skip

    page = layout(columns or _best_columns(cells[0], clouds[0], len(cells), size))
    rows = -(-len(cells) // page.columns)
    if len(headings) not in (0, rows):
        raise OptionError(f"headings must be one for each of the {rows} rows, or none (got {len(headings)})")
    if page.cell[0] < 48 or page.cell[1] < 48:
        raise OptionError(f"size {size} leaves cells of {page.cell} pixels for {len(cells)} views; make it larger")
    images = []
    with closing(open_painter(page.cell)) as painter:
        for view, cloud in zip(cells, clouds, strict=True):
            aspect = page.cell[0] / page.cell[1]
            camera = frame_points(cloud, view.camera, aspect)
            painter.start(view.surfaces, camera, colors)
            images.append(painter.image())
    return save_picture(page.paint(images), target)


def draw_surfaces(
    path: str | Path, surfaces: Sequence[ShadedSurface], camera: Camera, *, size: tuple[int, int]
) -> Path:
    """Draw surfaces as a placed camera sees them (see `look_at`) into a PNG file, as a frame of a film."""
    target, size = checked_path(path, ".png"), checked_size(size)
    with closing(open_painter(size)) as painter:
        painter.start(surfaces, camera, scalar_colors(surfaces))
        return save_picture(painter.image(), target)


def _best_columns(view: View, cloud: NDArray[np.float64], count: int, size: tuple[int, int]) -> int:
    """Return the number of columns that shows the first view's shapes largest."""
    spread = np.ptp(cloud @ camera_axes(view.camera).T, axis=0)
    width, height = max(spread[0], 1e-12), max(spread[1], 1e-12)

    def scale(columns: int) -> float:
        rows = -(-count // columns)
        return float(min(size[0] / columns / width, 0.85 * size[1] / rows / height))

    return max(range(count, 0, -1), key=scale)


def _legend_entries(views: Sequence[View]) -> list[Entry]:
    """List each pair of label and colour once, in order of appearance."""
    entries: dict[tuple[str, tuple[float, ...]], Entry] = {}
    for view in views:
        for surface in view.surfaces:
            if surface.label and surface.scalars is None:
                color = rgb(surface.color)
                entries.setdefault((surface.label, tuple(color.tolist())), (surface.label, color, surface.opacity))
    return list(entries.values())


def _scalar_label(views: Sequence[View]) -> str | None:
    """The first label of a surface with scalars."""
    valued = (surface for view in views for surface in view.surfaces if surface.scalars is not None)
    return next((surface.label for surface in valued if surface.label), None)


def save_picture(page: NDArray[np.uint8], target: Path) -> Path:
    """Write pixels (height, width, 3) to a PNG in one move, so that a killed run leaves no half picture."""
    from matplotlib.image import imsave

    with replacing(target) as temporary:
        imsave(temporary, page)
    return target
