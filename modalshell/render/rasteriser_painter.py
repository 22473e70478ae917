"""Built-in rasteriser: projects, shades and draws triangles by compiled kernels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from modalshell.render.camera import NEAREST, Camera
from modalshell.render.content import ShadedSurface
from modalshell.render.painter import LIGHTS, LINE_WIDTH, MESH_LINE_WIDTH, SUPERSAMPLING, line_opacity, reflectance
from modalshell.render.raster import draw_triangles, flatten, flatten_one, shade
from modalshell.render.surfaces import EdgeTable, ScalarColors, Sides, line_color, vertex_colors

_LIGHTS = np.array([[*np.array(direction) / np.linalg.norm(direction), power] for direction, power in LIGHTS])


class Triangles(NamedTuple):
    """Triangles in the picture, of one opacity.

    ``corners`` (T, 3, 2) are columns and rows [pixels], where pixel (i, j) has its centre at (i + 0.5, j + 0.5);
    ``nearness`` (T, 3) is anything linear over the picture that grows towards the camera; ``colors`` (T, 3, 3) are
    those at the corners, in [0, 1].
    """

    corners: NDArray[np.float64]
    nearness: NDArray[np.float64]
    colors: NDArray[np.float64]
    opacity: float


@final
class Canvas:
    """Layers of pixels, each of which keeps the nearest of the triangles that are drawn to it.

    ``size`` is the picture's (width, height) [pixels]; pixels are drawn ``factor`` times smaller each way, and
    averaged.
    """

    def __init__(self, size: tuple[int, int], layers: int, factor: int) -> None:
        self._factor = factor
        shape = (layers, size[1] * factor, size[0] * factor)
        self._near = np.full(shape, -np.inf)
        self._color, self._alpha = np.empty((*shape, 3), np.float32), np.empty(shape, np.float32)
        # What stands still: its nearness and the colours of its pixels, and its picture.
        still = shape[1:] if layers == 1 else (0, 0)
        self._behind, self._pixels = np.full(still, -np.inf), np.full((*still, 3), 255, np.uint8)
        self._page = np.full((size[1], size[0], 3), 255, np.uint8)
        self._box = np.empty(4, np.int64)
        self._begin()

    def _begin(self) -> None:
        self._box[:] = self._near.shape[1], -1, self._near.shape[2], -1

    def draw(self, layer: int, triangles: Triangles) -> None:
        """Draw triangles to a layer."""
        *parts, opacity = triangles
        arrays = [np.ascontiguousarray(part, dtype=np.float64) for part in parts]
        target = self._near[layer], self._color[layer], self._alpha[layer]
        draw_triangles(*arrays, np.float32(opacity), *target, self._box)

    def keep(self) -> None:
        """Let what has been drawn, to an only layer, stand still in all later images, in place of what did."""
        near = self._near[0].copy()
        self._behind[:], self._pixels[:], self._page[:] = -np.inf, 255, 255
        self._flatten_one(1, self._pixels)
        self._near[0] = near
        self._page = self.take_image()
        self._behind[:] = near

    def take_image(self) -> NDArray[np.uint8]:
        """The layers over white, from far to near, pixel by pixel (height, width, 3); they are empty afterwards."""
        image = self._page.copy()
        if len(self._near) == 1:
            self._flatten_one(self._factor, image)
        else:
            flatten(self._near, self._color, self._alpha, self._box, self._factor, image)
        self._begin()
        return image

    def _flatten_one(self, factor: int, image: NDArray[np.uint8]) -> None:
        still = self._behind, self._pixels
        flatten_one(self._near[0], self._color[0], self._alpha[0], self._box, factor, *still, image)


class RasteriserPainter:
    """The built-in rasteriser as a painter of images of a ``size`` (width, height) [pixels].

    Of a transparent surface only the sheet nearest to the camera is drawn; several surfaces blend in their true order
    at every pixel. Opaque surfaces that have not moved are drawn once.
    """

    threaded = True

    def __init__(self, size: tuple[int, int]) -> None:
        self._picture = size
        self._size = (size[0] * SUPERSAMPLING, size[1] * SUPERSAMPLING)
        self._canvas: Canvas | None = None
        self._surfaces: list[ShadedSurface] = []
        self._vertices: list[NDArray[np.float64]] = []
        self._tables: dict[int, EdgeTable] = {}
        self._clear: list[int] = []
        self._moved: set[int] = set()
        self._still: list[int] = []
        self._camera: Camera | None = None
        self._scalar_colors: ScalarColors | None = None

    def start(self, surfaces: Sequence[ShadedSurface], camera: Camera, scalar_colors: ScalarColors | None) -> None:
        """Replace everything shown."""
        self._surfaces = list(surfaces)
        self._vertices = [np.asarray(surface.vertices) for surface in surfaces]
        self._tables = {
            index: EdgeTable.of(np.asarray(surface.vertices), np.asarray(surface.faces))
            for index, surface in enumerate(surfaces)
            if surface.lined or surface.edges or surface.style != "surface"
        }
        self._camera, self._scalar_colors = camera, scalar_colors
        self._clear = [index for index, surface in enumerate(surfaces) if surface.opacity < 1.0]
        self._moved, self._still = set(), []
        self._canvas = Canvas(self._picture, 1 + len(self._clear), SUPERSAMPLING)

    def move(self, index: int, vertices: NDArray[np.float64], scalars: NDArray[np.float64] | None = None) -> None:
        """Move the vertices (n, 3) of one surface, keeping its triangles; and give it other scalars (n,), if any."""
        self._vertices[index] = vertices
        self._moved.add(index)
        if scalars is not None:
            self._surfaces[index] = replace(self._surfaces[index], scalars=scalars)

    def image(self) -> NDArray[np.uint8]:
        """Draw, and return pixels of shape (height, width, 3)."""
        assert self._canvas is not None
        every = range(len(self._surfaces))
        still = [index for index in every if index not in self._moved] if self._moved and not self._clear else []
        if still != self._still:
            self._draw(still)
            self._canvas.keep()
            self._still = still
        self._draw([index for index in every if index not in still])
        return self._canvas.take_image()

    def _draw(self, chosen: Sequence[int]) -> None:
        """Draw surfaces, all opaque ones to one layer and each transparent one to its own."""
        assert self._camera is not None
        assert self._canvas is not None
        for index in chosen:
            for triangles in self._pieces(index, self._camera):
                self._canvas.draw(self._clear.index(index) + 1 if index in self._clear else 0, triangles)

    def _pieces(self, index: int, camera: Camera) -> list[Triangles]:
        """Return the faces, then the lines, as triangles in the picture."""
        surface, vertices = self._surfaces[index], self._vertices[index]
        faces = np.asarray(surface.faces)
        pixels, nearness = self._place(vertices, camera, 0.0)
        sides = Sides.of(vertices, faces, camera)
        pieces = []
        if surface.style == "surface":
            shades = self._shade(surface, sides, faces, camera)
            pieces.append(Triangles(pixels[faces], nearness[faces], shades, surface.opacity))
        if index not in self._tables:
            return pieces
        table = self._tables[index]
        # Lines float a little above the faces so that they are never half hidden.
        pixels, nearness = self._place(vertices, camera, 0.004 * float(np.ptp(vertices, axis=0).max()))
        color = line_color(surface)
        if surface.edges and surface.style == "surface":
            opacity = surface.opacity
            pieces.append(_lines(pixels, nearness, table.edges, color, MESH_LINE_WIDTH * SUPERSAMPLING, opacity))
        if surface.lined or surface.style == "outline":
            edges = table.edges[table.outline(sides)]
            pieces.append(_lines(pixels, nearness, edges, color, LINE_WIDTH * SUPERSAMPLING, line_opacity(surface)))
        return pieces

    def _place(
        self, vertices: NDArray[np.float64], camera: Camera, lift: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return columns and rows (n, 2) of vertices and their nearness (n,) after a lift to the camera [m]."""
        projected = camera.project(vertices)
        pixels = 0.5 * (projected[:, :2] * (1.0, -1.0) + 1.0) * np.array(self._size)
        height = projected[:, 2] + lift
        # In perspective not the height but one over the distance is linear over the picture.
        return pixels, 1.0 / np.maximum(camera.distance - height, NEAREST * camera.distance)

    def _shade(
        self, surface: ShadedSurface, sides: Sides, faces: NDArray[np.int64], camera: Camera
    ) -> NDArray[np.float64]:
        """Return the shaded colours at the corners of the faces, shape (T, 3, 3), the same from both sides."""
        out = np.empty((len(faces), 3, 3))
        normals = sides.smooth if surface.smooth else sides.flat
        colors = np.ascontiguousarray(vertex_colors(surface, self._scalar_colors))
        ambient, diffuse = reflectance(surface)
        lights = np.column_stack([_LIGHTS[:, :3] @ camera.axes, diffuse * _LIGHTS[:, 3]])
        shade(faces, normals, surface.smooth, sides.seen, colors, lights, ambient, out)
        return out

    def close(self) -> None:
        """Forget the surfaces."""
        self._surfaces, self._vertices, self._tables, self._canvas = [], [], {}, None


def _lines(
    pixels: NDArray[np.float64],
    nearness: NDArray[np.float64],
    edges: NDArray[np.int64],
    color: NDArray[np.float64],
    width: float,
    opacity: float,
) -> Triangles:
    """Return edges (E, 2) as pairs of triangles `width` pixels wide."""
    ends, near = pixels[edges], nearness[edges]
    along = ends[:, 1] - ends[:, 0]
    along *= 0.5 * width / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    aside = np.column_stack([-along[:, 1], along[:, 0]])
    # Half a width longer at each end, which closes the gaps where lines meet at an angle.
    a, b = ends[:, 0] - along, ends[:, 1] + along
    lower, upper = [a - aside, b - aside, b + aside], [a - aside, b + aside, a + aside]
    corners = np.concatenate([np.stack(lower, axis=1), np.stack(upper, axis=1)])
    heights = np.concatenate([near[:, [0, 1, 1]], near[:, [0, 1, 0]]])
    return Triangles(corners, heights, np.broadcast_to(color, (len(corners), 3, 3)), opacity)
