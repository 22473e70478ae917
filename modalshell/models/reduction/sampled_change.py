"""How a modal force changes over a short way, by a sample of vertices or triangles that feel the load as all do."""

from __future__ import annotations

import numpy as np

from modalshell.core.typing import Array, Index
from modalshell.kernels.frame import TILE

LEAST = 1024
"""Vertices or triangles from which a sample pays: two forces on it, and their overhead, against one on all."""


def samples_of(count: int, draws: int = 1) -> Index:
    """Numbers (draws, 128) of samples of ``count``, as of :func:`spread_samples`; none (0, 128) of few."""
    return spread_samples(count, TILE, draws if count >= LEAST else 0)


def spread_samples(count: int, size: int, draws: int = 1) -> Index:
    """Numbers (draws, size) of samples of ``count``, one drawn from each of as many equal parts.

    At random, so that no pattern of a mesh is met by its own period.
    """
    drawn = np.arange(size) + np.random.default_rng(0).random((draws, size))
    return np.asarray((drawn * (count / size)).astype(np.int64))


def as_tile(rows: Array) -> Array:
    """Values (128, ..., 6) of a sample in the order of modal data, (1, ..., 6 * 128)."""
    return np.moveaxis(rows, 0, -1).reshape(1, *rows.shape[1:-1], -1).copy()
