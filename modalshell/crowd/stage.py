"""What stands about a flock in its film: a sky, the ground, and the birds' shadows on it."""

from __future__ import annotations

import math

import numpy as np

from modalshell.core.typing import Array, Index
from modalshell.render import ShadedSurface
from modalshell.render.camera import Camera

_ZENITH, _HORIZON = np.array([0.60, 0.76, 0.93]), np.array([0.94, 0.95, 0.95])
_TILES_COLORS, _SHADOW = ("#cfd8bd", "#d6dfc6"), "#a9b397"
_BANDS = 24
"""Strips of the sky, each of one colour."""
_FAR = 6.0
"""Distance of the sky over that of the camera from what it looks at."""
_TILES = 64
"""Tiles of the ground along each of its sides, an even number."""
_SUN = np.array([0.25, -0.15, 1.0])
"""Direction to the sun."""
_LIFT = 2e-3
"""Height of the shadows over the ground, as a share of the camera's."""
_QUAD = np.array([[0, 1, 2], [0, 2, 3]])


class FlightStage:
    """Sky, ground and shadows as a camera sees them that goes along with the flock.

    All positions are as such a camera sees them: what does not go along with it is moved the other way. Its view is
    horizontal at the start, or down a little. ``rest`` (n, 3) [m] is a bird, x forward, ``ground`` a height [m].
    """

    def __init__(self, camera: Camera, ground: float, rest: Array, birds: int) -> None:
        self._ground, self._eye = ground, camera.position
        forward = -camera.axes[2] * (1.0, 1.0, 0.0)
        self._forward = forward / np.linalg.norm(forward)
        self._right = np.cross(self._forward, (0.0, 0.0, 1.0))
        self._outline = [rest[:, 0].argmax(), rest[:, 1].argmin(), rest[:, 0].argmin(), rest[:, 1].argmax()]
        height = float(self._eye[2]) - ground
        down = math.asin(float(np.clip(camera.axes[2, 2], -1.0, 1.0))) + math.atan(camera.slope)
        self._seen = height / math.tan(min(max(down, 0.1), 1.4))  # how far ahead the ground comes into view
        self._lift = _LIFT * height
        self._far = _FAR * camera.distance
        self._size = 2.1 * self._far * camera.slope * max(camera.aspect, 1.0) / _TILES
        self._shadow_faces: Index = (_QUAD + 4 * np.arange(birds)[:, None, None]).reshape(-1, 3)

    def surfaces(self) -> list[ShadedSurface]:
        """Light tiles, dark tiles and shadows, which :meth:`move` moves; then the strips of the sky, which stay."""
        faces = (_QUAD + 4 * np.arange(_TILES**2 // 2)[:, None, None]).reshape(-1, 3)
        tiles = [
            ShadedSurface(corners, faces, color, lined=False)
            for corners, color in zip(self._tiles(np.zeros(3)), _TILES_COLORS, strict=True)
        ]
        flat = np.tile(self._eye, (2 * len(self._shadow_faces), 1))
        return [*tiles, ShadedSurface(flat, self._shadow_faces, _SHADOW, lined=False), *self._sky()]

    def move(self, positions: Array, shift: Array) -> list[Array]:
        """The tiles and the shadows of birds at ``positions`` (B, n, 3) [m], for a camera moved by ``shift`` (3,)."""
        corners = positions[:, self._outline].astype(np.float64)
        corners -= (corners[..., 2:] - self._ground) / _SUN[2] * _SUN
        corners[..., 2] += self._lift
        return [*self._tiles(shift), corners.reshape(-1, 3) - shift]

    def _tiles(self, shift: Array) -> list[Array]:
        """Corners of the light and of the dark tiles, which begin ahead of the camera and lie still on the ground."""
        size = self._size
        ahead, aside = (float(axis @ shift) % (2.0 * size) for axis in (self._forward, self._right))
        steps = size * np.arange(_TILES + 1.0)
        along = np.maximum(steps + 0.9 * self._seen - ahead, 0.1 * self._seen)
        across = steps - 0.5 * size * _TILES - aside
        base = self._eye + np.array([0.0, 0.0, self._ground - self._eye[2] - shift[2]])
        grid = base + along[:, None, None] * self._forward + across[None, :, None] * self._right
        quads = np.stack([grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]], axis=2)
        dark = np.add.outer(np.arange(_TILES), np.arange(_TILES)) % 2 == 1
        return [quads[~dark].reshape(-1, 3), quads[dark].reshape(-1, 3)]

    def _sky(self) -> list[ShadedSurface]:
        """Strips of a wall far away, paler towards the horizon."""
        middle, across = self._eye + self._far * self._forward, 2.0 * self._far * self._right
        heights = self._far * np.array([-0.5, *np.linspace(0.0, 1.0, _BANDS) ** 1.5])
        strips = []
        for band, share in enumerate(np.linspace(0.0, 1.0, _BANDS)):
            low, high = middle + np.outer(heights[band : band + 2], (0.0, 0.0, 1.0))
            red, green, blue = (1.0 - share) * _HORIZON + share * _ZENITH
            corners = np.array([low - across, low + across, high + across, high - across])
            strips.append(ShadedSurface(corners, _QUAD, (float(red), float(green), float(blue)), lined=False))
        return strips
