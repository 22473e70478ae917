"""Meshes of sheets that meet: strips along the segments of a plane frame, a tube with webs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

import modalshell as ms

Place = tuple[float, float]
"""A point (x, z) [m] of a cross-section."""
Surface = tuple[NDArray[np.float64], NDArray[np.int64]]
"""Vertices (n, 3) [m] and triangles (T, 3)."""


def strip(start: Place, end: Place, width: float, cells: tuple[int, int], family: str = "alternating") -> Surface:
    """Vertices and faces of a strip from ``start`` to ``end`` (x, z) [m], of ``width`` along y.

    Diagonals alternate or go one way; jittered vertices are moved by up to a fifth of a cell, but not on the edges.
    """
    along, across = cells
    i, j = (index.ravel() for index in np.meshgrid(np.arange(along + 1), np.arange(across + 1), indexing="ij"))
    points = np.column_stack([i / along, width * (j / across - 0.5)])
    if family == "jittered":
        inner = (i > 0) & (i < along) & (j > 0) & (j < across)
        moves = np.random.default_rng(1).uniform(-0.2, 0.2, (inner.sum(), 2))
        points[inner] += moves * [1.0 / along, width / across]
    faces: list[list[int]] = []
    for a in range(along):
        for b in range(across):
            p, q, r, s = (across + 1) * a + b + np.array([0, across + 1, across + 2, 1])
            straight = family == "one-way" or (a + b) % 2 == 0
            faces += [[p, q, r], [p, r, s]] if straight else [[p, q, s], [q, r, s]]
    path = (1.0 - points[:, :1]) * np.asarray(start, dtype=float) + points[:, :1] * np.asarray(end, dtype=float)
    return np.column_stack([path[:, 0], points[:, 1], path[:, 1]]), np.array(faces)


def joined(*sheets: Surface) -> ms.TriangleMesh:
    """One mesh of (vertices, faces), welded where they coincide."""
    starts = np.cumsum([0] + [len(points) for points, _ in sheets])
    faces = [triangles + start for (_, triangles), start in zip(sheets, starts, strict=False)]
    return ms.TriangleMesh.from_soup(np.vstack([points for points, _ in sheets]), np.vstack(faces))


def frame(
    ends: Sequence[Place], width: float = 0.2, cells: tuple[int, int] = (8, 4), family: str = "alternating"
) -> ms.TriangleMesh:
    """Strips from the origin to each of ``ends`` (x, z), joined in one junction."""
    return joined(*(strip((0.0, 0.0), end, width, cells, family) for end in ends))


def cellular_box(
    side: float = 0.2, length: float = 1.0, cells: tuple[int, int] = (4, 40), family: str = "jittered"
) -> ms.TriangleMesh:
    """A square tube along y, of outer side ``side``, with two webs that part it into four cells."""
    across, along = cells
    half = side / 2.0
    corners = [(-half, -half), (half, -half), (half, half), (-half, half)]
    middles = [(0.0, -half), (half, 0.0), (0.0, half), (-half, 0.0)]
    walls = [(a, b) for k in range(4) for a, b in ((corners[k], middles[k]), (middles[k], corners[(k + 1) % 4]))]
    webs = [((0.0, 0.0), middle) for middle in middles]
    return joined(*(strip(a, b, length, (across, along), family) for a, b in walls + webs))
