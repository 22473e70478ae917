"""Spheres, rods and coordinate axes as small triangle meshes, drawn like any other surface."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from modalshell.render.content import Color, ShadedSurface

# Vertices (n, 3) [m] and faces (T, 3).
GlyphMesh = tuple[NDArray[np.float64], NDArray[np.int64]]

AXIS_COLORS: tuple[Color, Color, Color] = ("#d62728", "#2ca02c", "#1f5fd0")
"""Red x, green y, blue z."""


def sphere(center: ArrayLike, radius: float, *, detail: int = 2) -> GlyphMesh:
    """Sphere of `radius` [m] from an icosahedron whose triangles are split in four `detail` times."""
    from trimesh import creation

    ball = creation.icosphere(subdivisions=detail, radius=radius)
    return np.asarray(ball.vertices + np.asarray(center)), np.asarray(ball.faces, dtype=np.int64)


def rod(start: ArrayLike, end: ArrayLike, radii: tuple[float, float], *, sections: int = 16) -> GlyphMesh:
    """Round rod from `start` to `end`, with a radius [m] and a rounded cap at each."""
    from trimesh import creation

    first, last = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    length = float(np.linalg.norm(last - first))
    caps = np.linspace(0.0, 0.5 * np.pi, 5)
    low = np.column_stack([radii[0] * np.sin(caps), -radii[0] * np.cos(caps)])
    high = np.column_stack([radii[1] * np.cos(caps), length + radii[1] * np.sin(caps)])
    return _placed(creation.revolve(_closed(np.vstack([low, high])), sections=sections), first, last - first)


def arrow(start: ArrayLike, end: ArrayLike, radius: float) -> GlyphMesh:
    """Arrow from `start` to `end`: a shaft of `radius` [m] and a cone three times as thick."""
    from trimesh import creation

    first, last = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    length = float(np.linalg.norm(last - first))
    neck = max(length - 8.0 * radius, 0.5 * length)
    outline = np.array([[0.0, 0.0], [radius, 0.0], [radius, neck], [3.0 * radius, neck], [0.0, length]])
    return _placed(creation.revolve(_closed(outline), sections=16), first, last - first)


def axes(origin: ArrayLike, rotation_vector: ArrayLike, length: float, *, opacity: float = 1.0) -> list[ShadedSurface]:
    """Arrows along the x (red), y (green) and z axes (blue) of a frame turned by `rotation_vector` [rad]."""
    start = np.asarray(origin, dtype=np.float64)
    directions = Rotation.from_rotvec(np.asarray(rotation_vector, dtype=np.float64)).as_matrix().T
    shapes = [arrow(start, start + length * direction, length / 30.0) for direction in directions]
    return [
        ShadedSurface(*shape, color=color, opacity=opacity, lined=False)
        for shape, color in zip(shapes, AXIS_COLORS, strict=True)
    ]


def joined(shapes: Sequence[GlyphMesh]) -> GlyphMesh:
    """Several shapes as one."""
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in shapes)])
    faces = [faces + start for (_, faces), start in zip(shapes, starts, strict=False)]
    return np.concatenate([vertices for vertices, _ in shapes]), np.concatenate(faces)


def _closed(outline: NDArray[np.float64]) -> NDArray[np.float64]:
    """The outline (radius, height) with its ends exactly on the axis, as `revolve` needs them."""
    outline[[0, -1], 0] = 0.0
    return outline


def _placed(mesh: Any, start: NDArray[np.float64], direction: NDArray[np.float64]) -> GlyphMesh:
    """A shape along +z turned into `direction` and moved to `start`."""
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int64)
    if np.linalg.norm(direction) > 0.0:
        turn, _ = Rotation.align_vectors(direction[None], [[0.0, 0.0, 1.0]])
        vertices = turn.apply(vertices)
    return vertices + start, faces
