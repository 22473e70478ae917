"""Normals, contour lines and colours of a surface, shared by both renderers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modalshell.core.checks import shown
from modalshell.core.errors import OptionError
from modalshell.render import raster as kernel
from modalshell.render.camera import Camera
from modalshell.render.content import ShadedSurface, rgb

# Neighbouring faces whose normals differ by more than this at the start meet in a line that is drawn.
CREASE_ANGLE = math.radians(25.0)


@dataclass(frozen=True)
class ScalarColors:
    """One colour map and range for all scalars of a picture."""

    colormap: str
    low: float
    high: float

    def __call__(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Map values (n,) to colours (n, 3) in [0, 1]."""
        import matplotlib

        span = self.high - self.low
        unit = (values - self.low) / span if span > 0.0 else np.full(len(values), 0.5)
        return np.asarray(matplotlib.colormaps[self.colormap](np.clip(unit, 0.0, 1.0)))[:, :3]


def scalar_colors(
    surfaces: Sequence[ShadedSurface], colormap: str = "viridis", limits: tuple[float, float] | None = None
) -> ScalarColors | None:
    """Return the colours common to all scalars of some surfaces; None without scalars."""
    valued = [surface for surface in surfaces if surface.scalars is not None]
    if not valued and colormap == "viridis":
        return None
    import matplotlib  # not before there are scalars: its import takes long

    if colormap not in matplotlib.colormaps:
        raise OptionError(f"colormap must be the name of a matplotlib colour map (got {shown(colormap)})")
    if not valued:
        return None
    values = np.concatenate([np.asarray(surface.scalars) for surface in valued])
    low, high = (float(values.min()), float(values.max())) if limits is None else limits
    if not (np.isfinite(low) and np.isfinite(high) and low <= high):
        raise OptionError(f"scalar_range must be two finite numbers in order (got {shown(limits)})")
    return ScalarColors(colormap, low, high)


@dataclass(frozen=True)
class EdgeTable:
    """Undirected edges of a triangle set."""

    edges: NDArray[np.int64]
    """Vertex indices; shape (E, 2)."""
    left: NDArray[np.int64]
    right: NDArray[np.int64]
    """Two of the faces at each edge, the same face twice at the border; shape (E,)."""
    drawn: NDArray[np.bool_]
    """Border edges and creases, which belong to the outline from every side; shape (E,)."""

    @classmethod
    def of(cls, vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> EdgeTable:
        """Build the table of `faces` (T, 3), with the creases of `vertices` (n, 3) kept for later positions."""
        pairs = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
        owners = np.tile(np.arange(len(faces)), 3)
        order = np.lexsort((owners, pairs[:, 1], pairs[:, 0]))
        pairs, owners = pairs[order], owners[order]
        starts = np.flatnonzero(np.r_[True, (pairs[1:] != pairs[:-1]).any(axis=1)])
        ends = np.r_[starts[1:], len(pairs)] - 1
        left, right = owners[starts], owners[ends]
        flat, _ = normals(vertices, faces)
        agreement = np.abs(np.einsum("ij,ij->i", flat[left], flat[right]))
        return cls(pairs[starts], left, right, (left == right) | (agreement < math.cos(CREASE_ANGLE)))

    def outline(self, sides: Sides) -> NDArray[np.int64]:
        """Return the numbers of edges at the border, at creases, or between a face seen and a face turned away."""
        shown = np.empty(len(self.left), dtype=np.bool_)
        kernel.outline(self.left, self.right, self.drawn, sides.flat, sides.seen, shown)
        return np.flatnonzero(shown)


@dataclass(frozen=True)
class Sides:
    """How the faces of a surface lie to a camera."""

    flat: NDArray[np.float64]
    """Unit normals of the faces; zero for a face without area. Shape (T, 3)."""
    smooth: NDArray[np.float64]
    """Unit normals at the vertices, averaged over faces by area; shape (n, 3)."""
    seen: NDArray[np.int64]
    """1 for a face that looks towards the camera, -1 for one that is turned away; shape (T,)."""

    @classmethod
    def of(cls, vertices: NDArray[np.float64], faces: NDArray[np.int64], camera: Camera) -> Sides:
        """Sides of the faces (T, 3) at ``vertices`` (n, 3)."""
        points, seen = np.require(vertices, np.float64, ("C", "W")), np.empty(len(faces), np.int64)
        flat, smooth = normals(points, faces)
        kernel.seen_faces(points, faces, flat, camera.position, seen)
        return cls(flat, smooth, seen)


def normals(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Unit normals of the faces (T, 3), zero without area, and at the vertices (n, 3), averaged by area."""
    flat, smooth = np.empty((len(faces), 3)), np.zeros((len(vertices), 3))
    # A read-only array would compile the kernel once more.
    kernel.unit_normals(np.require(vertices, np.float64, ("C", "W")), faces, flat, smooth)
    return flat, smooth


def vertex_colors(surface: ShadedSurface, scalar_colors: ScalarColors | None) -> NDArray[np.float64]:
    """Return the colours of the vertices before shading, shape (n, 3) in [0, 1]."""
    if surface.scalars is not None and scalar_colors is not None:
        return scalar_colors(np.asarray(surface.scalars))
    return np.tile(rgb(surface.color), (len(np.asarray(surface.vertices)), 1))


def line_color(surface: ShadedSurface) -> NDArray[np.float64]:
    """Return the colour of a surface's outline (3,): its own, darker; grey over scalars."""
    if surface.style != "surface":
        return rgb(surface.color)
    return np.full(3, 0.25) if surface.scalars is not None else 0.45 * rgb(surface.color)
