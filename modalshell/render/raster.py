"""Depth-buffered triangle rasteriser with exact coverage and so without seams."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from modalshell.kernels.raster import draw_triangles, flatten


@final
@dataclass(frozen=True)
class Triangles:
    """
    Triangles in the picture.

    Attributes
    ----------
    corners : ndarray, shape (T, 3, 2)
        Columns and rows [pixels]; pixel (i, j) has its centre at (i + 0.5, j + 0.5).
    nearness : ndarray, shape (T, 3)
        Anything linear over the picture that grows towards the camera.
    colors : ndarray, shape (T, 3, 3)
        Colour at each corner, in [0, 1].
    opacity : float
        One opacity for all.
    """

    corners: NDArray[np.float64]
    nearness: NDArray[np.float64]
    colors: NDArray[np.float64]
    opacity: float


@final
class Canvas:
    """
    Layers of pixels, each of which keeps the nearest of the triangles that are drawn to it.

    Parameters
    ----------
    size : tuple of int
        Width and height of the picture [pixels].
    layers : int
        How many.
    factor : int
        Pixels are drawn this many times smaller each way, and averaged.
    """

    def __init__(self, size: tuple[int, int], layers: int, factor: int) -> None:
        self._size, self._factor = size, factor
        shape = (layers, size[1] * factor, size[0] * factor)
        self._near = np.full(shape, -np.inf)
        self._color, self._alpha = np.empty((*shape, 3), np.float32), np.empty(shape, np.float32)
        self._box = np.empty(4, np.int64)
        self._begin()

    def _begin(self) -> None:
        self._box[:] = self._near.shape[1], -1, self._near.shape[2], -1

    def draw(self, layer: int, triangles: Triangles) -> None:
        """Draw triangles to a layer."""
        parts = (triangles.corners, triangles.nearness, triangles.colors)
        arrays = [np.ascontiguousarray(part, dtype=np.float64) for part in parts]
        target = self._near[layer], self._color[layer], self._alpha[layer]
        draw_triangles(*arrays, np.float32(triangles.opacity), *target, self._box)

    def take_image(self) -> NDArray[np.uint8]:
        """The layers over white, from far to near, pixel by pixel (height, width, 3); they are empty afterwards."""
        image = np.empty((self._size[1], self._size[0], 3), np.uint8)
        flatten(self._near, self._color, self._alpha, self._box, self._factor, image)
        self._begin()
        return image
