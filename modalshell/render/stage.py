"""The ground that a film's shell stands over, with its soft shadow, and the text in a corner of its frames."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from modalshell.core.typing import Array
from modalshell.render.content import ShadedSurface

if TYPE_CHECKING:
    from PIL.ImageFont import FreeTypeFont

_GROUND, _HALF, _FULL = "#f1eee8", "#dfdbd2", "#cbc7bd"
_GAP = 0.04
"""Distance of the ground below the lowest point of a motion, as a share of the motion's extent."""
_REACH = 0.75
"""Radius of the ground as a share of the extent."""
_RAYS = {(0.06, 0.02): _HALF, (-0.03, 0.06): _HALF, (-0.03, -0.05): _HALF, (0.0, 0.01): _FULL}
"""Slopes (x, y) of the light's rays, with the tone of their shadow: the rim of a lamp of some breadth, and its middle.

Opaque tones in place of transparent ones: each transparent surface takes a layer of its own, and frames take longer.
"""
_LIFT = 5e-4
"""Distance of the shadows above the ground and one another, as a share of the extent."""
_SIDES = 72
"""Sides of the ground's edge."""
_MARGIN = 0.6
"""Distance of the text from the picture's edge, in heights of its letters."""
DOWN = (0.0, 0.0, -1.0)
"""Where the ground is below."""
LOWEST_VIEW = 0.25
"""Height of the camera over its distance below which there is no ground: seen so low it is a dark bar."""


def down_of(gravity: Sequence[float] | None) -> tuple[float, float, float]:
    """The direction along an axis in which things fall, from their ground: along z unless another one has most of it.

    Gravity against z is a load as any other: the ground stays below.
    """
    pull = np.zeros(3) if gravity is None else np.asarray(gravity, dtype=np.float64)
    axis = int(np.abs(pull[[2, 0, 1]]).argmax())  # the first of equals
    x, y, z = np.eye(3)[(2, 0, 1)[axis]] * (-1.0 if axis == 0 else np.sign(pull[axis - 1]))
    return float(x), float(y), float(z)


class Stage:
    """A round ground below a motion (F, n, 3) [m] of triangles (T, 3), and the shadow of the moving surface on it.

    ``down`` is the axis along which the ground is below, see :func:`down_of`.

    Attributes
    ----------
    surfaces : list of ShadedSurface
        The shadows, the highest first, then the ground: what is hidden is not drawn to a pixel.
    motions : list
        For each an array (F, n, 3) (a shadow) or None (the ground).
    """

    def __init__(
        self,
        positions: NDArray[np.floating],
        faces: NDArray[np.integer],
        down: tuple[float, float, float] = DOWN,
    ) -> None:
        upright = _upright(down)
        x = np.asarray(positions, dtype=np.float64)
        x = x if upright is None else x @ upright.T
        low, high = x.min(axis=(0, 1)), x.max(axis=(0, 1))
        extent = float(np.linalg.norm(high - low))
        level = float(low[2]) - _GAP * extent
        middle = 0.5 * (low + high)
        turn = np.linspace(0.0, 2.0 * np.pi, _SIDES, endpoint=False)
        ring = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(_SIDES)]) * _REACH * extent
        disc = np.vstack([np.zeros(3), ring]) + np.array([middle[0], middle[1], level])
        around = np.arange(_SIDES)
        fan = np.column_stack([np.zeros(_SIDES, int), 1 + around, 1 + (around + 1) % _SIDES])
        # Of a small thing that falls far, shadows of one lamp would lie apart.
        breadth = float(np.linalg.norm(np.ptp(x[0], axis=0))) / extent
        self.surfaces: list[ShadedSurface] = []
        self.motions: list[Array | None] = []
        for number, (slope, tone) in reversed(list(enumerate(_RAYS.items(), start=1))):
            shadow = x.copy()
            shadow[..., :2] -= (x[..., 2:] - level) * breadth * np.array(slope)
            shadow[..., 2] = level + number * _LIFT * extent
            self.surfaces.append(ShadedSurface(shadow[0], faces, color=tone, lined=False))
            self.motions.append(shadow)
        self.surfaces.append(ShadedSurface(disc, fan, color=_GROUND, lined=False))
        self.motions.append(None)
        if upright is not None:
            turned = [replace(one, vertices=np.asarray(one.vertices) @ upright) for one in self.surfaces]
            self.surfaces, self.motions = turned, [None if one is None else one @ upright for one in self.motions]


def _upright(down: tuple[float, float, float]) -> Array | None:
    """The rotation (3, 3) that takes the axis ``down`` to -z; None if it is that."""
    if down[2] < 0.0:
        return None
    up = -np.array(down)
    first = np.roll(np.abs(up), 1)
    return np.stack([first, np.cross(up, first), up])


@lru_cache(maxsize=8)
def _font(size: int) -> FreeTypeFont:
    """The font of matplotlib's texts, in pixels."""
    from PIL import ImageFont

    found = find_spec("matplotlib")
    file = Path(found.origin if found and found.origin else "").parent / "mpl-data/fonts/ttf/DejaVuSans.ttf"
    if not file.is_file():  # as in packages of some systems
        from matplotlib.font_manager import FontProperties, findfont  # not at once: it lists all fonts of the system

        file = Path(findfont(FontProperties(family="DejaVu Sans")))
    return ImageFont.truetype(str(file), size)


def with_texts(
    pictures: Iterator[NDArray[np.uint8]], texts: Sequence[str], corner: tuple[int, int], size: float
) -> Iterator[NDArray[np.uint8]]:
    """Frames with a text each, whose lower left is at ``corner`` (column, row), in letters of ``size`` pixels."""
    from PIL import Image, ImageDraw

    shift = _MARGIN * size
    for picture, text in zip(pictures, texts, strict=True):
        image = Image.fromarray(picture)
        place: Any = (corner[0] + shift, corner[1] - shift)
        ImageDraw.Draw(image).text(place, text, fill=(40, 40, 40), font=_font(round(size)), anchor="ls")
        yield np.asarray(image)
