"""Drawing with matplotlib alone: projected triangles painted from far to near, shaded by hand."""

from __future__ import annotations

from collections.abc import Sequence
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from modalshell.render.camera import Camera
from modalshell.render.painter import SUPERSAMPLING, shrink
from modalshell.render.scene import ShadedSurface
from modalshell.render.surfaces import (
    EdgeTable,
    ScalarColors,
    face_normals,
    line_color,
    vertex_colors,
    vertex_normals,
)

# VTK's light kit, simplified: directions to the lights in camera axes (right, up, towards viewer) and strengths.
_LIGHTS = ((np.array([0.11, 0.76, 0.63]), 0.50), (np.array([0.0, 0.0, 1.0]), 0.28), (np.array([-0.6, -0.6, 0.5]), 0.14))
_AMBIENT = 0.26


class MatplotlibPainter:
    """
    The painter's algorithm over one polygon collection; triangles that pierce each other are drawn by their centres.

    Parameters
    ----------
    size : tuple of int
        Width and height of the images [pixels].
    """

    def __init__(self, size: tuple[int, int]) -> None:
        self._size = (size[0] * SUPERSAMPLING, size[1] * SUPERSAMPLING)
        self._surfaces: list[ShadedSurface] = []
        self._vertices: list[NDArray[np.float64]] = []
        self._tables: list[EdgeTable] = []
        self._camera: Camera | None = None
        self._scalar_colors: ScalarColors | None = None

    def start(self, surfaces: Sequence[ShadedSurface], camera: Camera, scalar_colors: ScalarColors | None) -> None:
        """Replace everything shown."""
        self._surfaces = list(surfaces)
        self._vertices = [np.asarray(surface.vertices) for surface in surfaces]
        self._tables = [EdgeTable.of(np.asarray(surface.faces)) for surface in surfaces]
        self._camera, self._scalar_colors = camera, scalar_colors

    def move(self, index: int, vertices: NDArray[np.float64]) -> None:
        """Move the vertices (n, 3) of one surface, keeping its triangles."""
        self._vertices[index] = vertices

    def image(self) -> NDArray[np.uint8]:
        """Draw, and return pixels of shape (height, width, 3)."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.collections import PolyCollection
        from matplotlib.figure import Figure
        from matplotlib.transforms import IdentityTransform

        width, height = self._size
        figure = Figure(figsize=(width / 72.0, height / 72.0), dpi=72, facecolor="white")
        polygons: list[NDArray[np.float64]] = []
        heights, fills, strokes, widths = [], [], [], []
        for index in range(len(self._surfaces)):
            for corners, height_to_camera, fill, stroke, line_width in self._pieces(index):
                polygons.extend(corners)
                heights.append(height_to_camera)
                fills.append(fill)
                strokes.append(stroke)
                widths.append(np.full(len(corners), line_width))
        order = np.argsort(np.concatenate(heights), kind="stable")
        line_widths = np.concatenate(widths)[order]
        collection = PolyCollection(
            [polygons[k] for k in order],
            facecolors=np.concatenate(fills)[order].tolist(),
            edgecolors=np.concatenate(strokes)[order].tolist(),
            linewidths=line_widths.tolist(),
            # Antialiased fills would leave pale seams between neighbours; only lines get it.
            antialiaseds=(line_widths > 0.0).tolist(),
            closed=False,
            transform=IdentityTransform(),
        )
        figure.add_artist(collection)
        canvas: Any = FigureCanvasAgg(figure)
        canvas.draw()
        return shrink(np.asarray(canvas.buffer_rgba()))

    def _pieces(
        self, index: int
    ) -> list[tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], float]]:
        """Return polygons in pixels, heights, fill and stroke colours, line width: the faces, then the lines."""
        surface, vertices, table = self._surfaces[index], self._vertices[index], self._tables[index]
        camera = self._camera
        assert camera is not None
        faces = np.asarray(surface.faces)
        projected = camera.project(vertices)
        pixels = 0.5 * (projected[:, :2] + 1.0) * np.array(self._size)
        depth = projected[faces, 2].mean(axis=1)
        stroke = line_color(surface)
        if surface.style == "wireframe":
            chosen, line_width = np.arange(len(table.edges)), 0.6 * SUPERSAMPLING
        else:
            chosen, line_width = table.outline(vertices, faces, camera), 1.1 * SUPERSAMPLING
        edges = table.edges[chosen]
        # A line lies just above the nearer of its two faces.
        over = np.maximum(depth[table.left[chosen]], depth[table.right[chosen]])
        over = np.nextafter(np.maximum(over, projected[edges, 2].mean(axis=1)), np.inf)
        alpha = min(1.0, 0.35 + surface.opacity) if surface.style == "surface" else surface.opacity
        pieces = [(pixels[edges], over, np.zeros((len(edges), 4)), _with_alpha(stroke, alpha, len(edges)), line_width)]
        if surface.style != "surface":
            return pieces
        shades = self._shade(surface, vertices, faces, camera)
        fill = np.column_stack([shades, np.full(len(faces), surface.opacity)])
        sides = _with_alpha(stroke, surface.opacity, len(faces)) if surface.edges else np.zeros((len(faces), 4))
        return [(pixels[faces], depth, fill, sides, 0.6 * SUPERSAMPLING if surface.edges else 0.0), *pieces]

    def _shade(
        self, surface: ShadedSurface, vertices: NDArray[np.float64], faces: NDArray[np.int64], camera: Camera
    ) -> NDArray[np.float64]:
        """Return the shaded colours of the faces, shape (T, 3), the same from both sides."""
        normals = face_normals(vertices, faces)
        if surface.smooth:
            normals = vertex_normals(vertices, faces)[faces].mean(axis=1)
        toward = np.einsum("ij,ij->i", normals, camera.facing(vertices[faces].mean(axis=1)))
        local = np.where(toward[:, None] < 0.0, -normals, normals) @ camera.axes.T
        light = _AMBIENT + sum(power * np.maximum(local @ direction, 0.0) for direction, power in _LIGHTS)
        colors = vertex_colors(surface, self._scalar_colors)[faces].mean(axis=1)
        return np.clip(colors * np.asarray(light)[:, None], 0.0, 1.0)

    def __enter__(self) -> Self:
        """Open."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Forget the surfaces."""
        self._surfaces, self._vertices, self._tables = [], [], []


def _with_alpha(color: NDArray[np.float64], alpha: float, count: int) -> NDArray[np.float64]:
    return np.asarray(np.tile(np.append(color, alpha), (count, 1)), dtype=np.float64)
