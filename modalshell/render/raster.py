"""Depth-buffered triangle rasteriser in NumPy, with exact coverage and so without seams."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# Pixels worked on at a time, which bounds the memory of one call to some 200 MB.
_CHUNK = 2_000_000


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


@dataclass
class Layer:
    """
    The nearest of some triangles at each pixel.

    Attributes
    ----------
    nearness : ndarray, shape (height * width,)
        Minus infinity where nothing is drawn.
    color : ndarray of float32, shape (height * width, 3)
        Colours in [0, 1].
    opacity : ndarray of float32, shape (height * width,)
        Zero where nothing is drawn.
    """

    nearness: NDArray[np.float64]
    color: NDArray[np.float32]
    opacity: NDArray[np.float32]

    @classmethod
    def empty(cls, size: tuple[int, int]) -> Layer:
        """Make a layer of `size` (width, height) with nothing in it."""
        count = size[0] * size[1]
        return cls(np.full(count, -np.inf), np.zeros((count, 3), np.float32), np.zeros(count, np.float32))

    def draw(self, triangles: Triangles, size: tuple[int, int]) -> None:
        """Draw triangles, keeping at each pixel what is nearest."""
        corners = triangles.corners
        spans = _spans(corners, size)
        gradient = _gradients(corners, np.concatenate([triangles.nearness[..., None], triangles.colors], axis=2))
        lengths = spans[:, 3] - spans[:, 2]
        ends = np.cumsum(lengths)
        start = 0
        while start < len(spans):
            stop = max(start + 1, int(np.searchsorted(ends, (ends[start - 1] if start else 0) + _CHUNK)))
            part, count = spans[start:stop], lengths[start:stop]
            which = np.repeat(np.arange(len(part)), count)
            column = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count) + part[which, 2]
            triangle, row = part[which, 0], part[which, 1]
            across, down = column + 0.5 - corners[triangle, 0, 0], row + 0.5 - corners[triangle, 0, 1]
            pixel = row * size[0] + column
            slopes = gradient[triangle, 0]
            near = triangles.nearness[triangle, 0] + across * slopes[:, 0] + down * slopes[:, 1]
            np.maximum.at(self.nearness, pixel, near)
            won = near == self.nearness[pixel]
            pixel, triangle = pixel[won], triangle[won]
            tilt = gradient[triangle, 1:]
            shade = triangles.colors[triangle, 0] + across[won, None] * tilt[..., 0] + down[won, None] * tilt[..., 1]
            self.color[pixel] = np.clip(shade, 0.0, 1.0)
            self.opacity[pixel] = triangles.opacity
            start = stop


def blend(layers: list[Layer], size: tuple[int, int]) -> NDArray[np.uint8]:
    """Lay layers over white from far to near, pixel by pixel; shape (height, width, 3)."""
    nearness = np.stack([layer.nearness for layer in layers])
    used = np.flatnonzero(np.isfinite(nearness).any(axis=0))
    order = np.argsort(nearness[:, used], axis=0, kind="stable")
    page = np.ones((len(used), 3), np.float32)
    for rank in order:
        for index, layer in enumerate(layers):
            chosen = np.flatnonzero(rank == index)
            at = used[chosen]
            opacity = layer.opacity[at, None]
            page[chosen] = (1.0 - opacity) * page[chosen] + opacity * layer.color[at]
    image = np.full((size[1] * size[0], 3), 255, np.uint8)
    image[used] = np.round(255.0 * page)
    return image.reshape(size[1], size[0], 3)


def _gradients(corners: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the slopes per column and row of corner values (T, 3, k), shape (T, k, 2); zero without area."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    inverse = np.divide(1.0, area, out=np.zeros_like(area), where=np.abs(area) > 1e-12)[:, None]
    rise, climb = values[:, 1] - values[:, 0], values[:, 2] - values[:, 0]
    across = (rise * second[:, 1:] - climb * first[:, 1:]) * inverse
    down = (climb * first[:, :1] - rise * second[:, :1]) * inverse
    return np.stack([across, down], axis=2)


def _spans(corners: NDArray[np.float64], size: tuple[int, int]) -> NDArray[np.int64]:
    """List rows of covered pixel centres as (triangle, row, first column, column after the last), shape (R, 4)."""
    width, height = size
    top = np.clip(np.ceil(corners[:, :, 1].min(axis=1) - 0.5), 0, height).astype(np.int64)
    foot = np.clip(np.ceil(corners[:, :, 1].max(axis=1) - 0.5), 0, height).astype(np.int64)
    count = np.maximum(foot - top, 0)
    triangle = np.repeat(np.arange(len(corners)), count)
    row = np.arange(len(triangle)) - np.repeat(np.cumsum(count) - count, count) + top[triangle]
    middle = row + 0.5
    left, right = np.full(len(row), np.inf), np.full(len(row), -np.inf)
    for start, end in ((0, 1), (1, 2), (2, 0)):
        a, b = corners[triangle, start], corners[triangle, end]
        # Neighbours walk a common side in opposite directions: order its ends so that both find the same column.
        swap = a[:, 1] > b[:, 1]
        low, high = np.where(swap[:, None], b, a), np.where(swap[:, None], a, b)
        crossed = (low[:, 1] <= middle) & (middle < high[:, 1])
        rise = np.where(crossed, high[:, 1] - low[:, 1], 1.0)
        column = low[:, 0] + (middle - low[:, 1]) / rise * (high[:, 0] - low[:, 0])
        left = np.where(crossed, np.minimum(left, column), left)
        right = np.where(crossed, np.maximum(right, column), right)
    first = np.clip(np.ceil(np.where(left <= right, left, 0.0) - 0.5), 0, width).astype(np.int64)
    after = np.clip(np.ceil(np.where(left <= right, right, 0.0) - 0.5), 0, width).astype(np.int64)
    kept = after > first
    return np.column_stack([triangle, row, first, after])[kept]
