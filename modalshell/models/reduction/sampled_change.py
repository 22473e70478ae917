"""How a modal force changes over a short way, by a sample of vertices or triangles that feel the load as all do."""

from __future__ import annotations

import numpy as np

from modalshell.core.typing import Array, Index
from modalshell.kernels.frame import TILE

VERTICES, TRIANGLES = TILE, 2 * TILE
"""Vertices or triangles in a sample: of triangles, fewer feel the load unlike all."""
_LEAST = 1024
"""Vertices or triangles from which a sample pays: two forces on it, and their overhead, against one on all."""
_ALIKE = 0.4
"""Distance of a sample's force from the whole one, as a share of it, up to which it tells how that changes."""


def sample_of(count: int, size: int) -> Index | None:
    """Numbers (size,) of a sample of ``count``, one drawn from each of as many equal parts; None of few."""
    if count < _LEAST:
        return None
    drawn = np.arange(size) + np.random.default_rng(0).random(size)
    return np.asarray((drawn * (count / size)).astype(np.int64))


def in_tiles(rows: Array) -> Array:
    """Values (size, ..., 6) of a sample in the order of modal data, (size / 128, ..., 6 * 128)."""
    tiles = rows.reshape(-1, TILE, *rows.shape[1:])
    return np.moveaxis(tiles, 1, -1).reshape(*tiles.shape[:1], *rows.shape[1:-1], -1).copy()


def change_of(whole: Array, sampled: Array, near: Array) -> Array | None:
    """Change of a modal force (m,), ``whole`` where the sample's is ``sampled``, to where that is ``near``; or None.

    None where the sample does not feel the load as all do: one at few vertices, say.
    """
    off = sampled - whole
    return near - sampled if off @ off <= _ALIKE**2 * (whole @ whole) else None
