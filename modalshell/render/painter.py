"""Abstract base of renderers, with the light and lines that both share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from modalshell.render import raster as kernel
from modalshell.render.camera import Camera
from modalshell.render.content import ShadedSurface
from modalshell.render.surfaces import ScalarColors

# Pictures are drawn this many times larger in each direction and averaged: even edges with any OpenGL.
SUPERSAMPLING = 2
# Directions to the lights in camera axes (right, up, towards the viewer) and their strengths: a white key light from
# above, a head light and a fill from below, soft enough that no face goes black and no colour is tinted.
LIGHTS = (((0.15, 0.77, 0.62), 0.43), ((0.0, 0.0, 1.0), 0.26), ((-0.6, -0.6, 0.5), 0.12))
# Widths of outlines and of the sides of triangles [pixels].
LINE_WIDTH = 1.1
MESH_LINE_WIDTH = 0.6
"""Width of the lines along edges [pixels]."""


class Painter(Protocol):
    """Draws surfaces into images of one size."""

    threaded: bool
    """Whether another thread than the one that made it may draw, and others of its kind at the same time."""

    def start(self, surfaces: Sequence[ShadedSurface], camera: Camera, scalar_colors: ScalarColors | None) -> None:
        """Replace everything shown."""

    def move(self, index: int, vertices: NDArray[np.float64], scalars: NDArray[np.float64] | None = None) -> None:
        """Move the vertices (n, 3) of one surface, keeping its triangles; and give it other scalars (n,), if any."""

    def image(self) -> NDArray[np.uint8]:
        """Draw, and return pixels of shape (height, width, 3)."""

    def close(self) -> None:
        """Free the window, if there is one."""


def reflectance(surface: ShadedSurface) -> tuple[float, float]:
    """Return the ambient and diffuse parts of the light; colours that mean values are shaded less."""
    return (0.65, 0.45) if surface.scalars is not None else (0.38, 1.0)


def line_opacity(surface: ShadedSurface) -> float:
    """Return the opacity of a surface's outline, which stays readable around a transparent surface."""
    return min(1.0, 0.35 + surface.opacity) if surface.style == "surface" else surface.opacity


def shrink(pixels: NDArray[np.uint8], factor: int = SUPERSAMPLING) -> NDArray[np.uint8]:
    """Average blocks of `factor` x `factor` pixels, (h, w, 3) to (h / factor, w / factor, 3)."""
    out = np.empty((pixels.shape[0] // factor, pixels.shape[1] // factor, 3), dtype=np.uint8)
    kernel.shrink(np.ascontiguousarray(pixels), factor, out)
    return out
