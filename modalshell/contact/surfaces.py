"""Triangles of colliders, for pictures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from modalshell.core.typing import Array, Index

Surface = tuple[Array, Index]
"""Vertices (k, 3) [m] and triangles (T, 3)."""
_ROUND = 48
"""Vertices around a round body."""


def grid_triangles(rows: int, columns: int, *, closed: bool = False) -> Index:
    """Triangles of a grid of vertices, its columns ``closed`` to a ring if asked for."""
    row, column = np.meshgrid(np.arange(rows - 1), np.arange(columns if closed else columns - 1), indexing="ij")
    after = (column + 1) % columns
    a, b = row * columns + column, row * columns + after
    c, d = a + columns, b + columns
    return np.concatenate([np.stack([a, c, b], -1).reshape(-1, 3), np.stack([b, c, d], -1).reshape(-1, 3)])


def ball() -> Surface:
    """Directions (k, 3) of a ball about z, and its triangles; none lies in a plane of the axes."""
    polar = np.linspace(0.0, np.pi, _ROUND // 2)
    around = (np.arange(_ROUND) + 0.5) * (2.0 * np.pi / _ROUND)
    sine, cosine = np.sin(polar)[:, None], np.cos(polar)[:, None] * np.ones(_ROUND)
    directions = np.stack([sine * np.cos(around), sine * np.sin(around), cosine], axis=-1).reshape(-1, 3)
    return directions, grid_triangles(polar.size, _ROUND, closed=True)


def tube(a: Array, b: Array, radii: Sequence[float], shares: Sequence[float]) -> Surface:
    """A body of revolution about the axis from a to b (3,): its ``radii`` [m] at ``shares`` of the way."""
    axis = (b - a) / np.linalg.norm(b - a)
    first = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    first /= np.linalg.norm(first)
    around = np.arange(_ROUND) * (2.0 * np.pi / _ROUND)
    circle = np.cos(around)[:, None] * first + np.sin(around)[:, None] * np.cross(axis, first)
    rings = [a + share * (b - a) + radius * circle for radius, share in zip(radii, shares, strict=True)]
    return np.concatenate(rings), grid_triangles(len(rings), _ROUND, closed=True)


def square(point: Array, normal: Array, corners: Array) -> Surface:
    """A rectangle of a plane below ``corners`` (k, 3) [m]."""
    first = np.eye(3)[int(np.argmin(np.abs(normal)))]
    first = first - normal * (first @ normal)
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    along, across = (corners - point) @ first, (corners - point) @ second
    ends = [point + u * first + v * second for u in (along.min(), along.max()) for v in (across.min(), across.max())]
    return np.array(ends), grid_triangles(2, 2)
