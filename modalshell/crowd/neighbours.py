"""Neighbour sums: what a boid's rules need of its neighbours."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from modalshell.core.typing import Array
from modalshell.crowd.kernels import flock as kernels

Search = Literal["grid", "all_pairs"]


class Neighbourhood(NamedTuple):
    """Sums over each boid's neighbours."""

    separation: Array
    """Sum of ``offset (1 / distance - 1 / neighbour distance)``, the offset from the neighbour to the boid; shape
    (N, 3)."""
    directions: Array
    """Sum of the neighbours' directions; shape (N, 3)."""
    positions: Array
    """Sum of their positions [m]; shape (N, 3)."""
    counts: Array
    """Their number; shape (N,)."""


def gather(
    positions: Array,
    directions: Array,
    distance: float,
    field_of_view: float,
    *,
    search: Search = "grid",
    threads: int = 1,
) -> Neighbourhood:
    """Sums over the neighbours of every boid.

    Returns the same for any number of threads, bit by bit.

    Parameters
    ----------
    positions, directions : ndarray, shape (N, 3)
        Where the boids are [m], and where they head (unit vectors).
    distance : float
        Distance [m] below which boids are neighbours.
    field_of_view : float
        Full angle of the cone about its direction in which a boid sees [rad]; 2 pi is all round.
    search : {"grid", "all_pairs"}
        A grid of cells, whose cost grows as the number of boids at a fixed density; or every pair, to check it.
    threads : int
        Parts that the grid's boids are cut into, each on a thread of numba's if there are as many.
    """
    count = len(positions)
    cosine, sums = view_cosine(field_of_view), np.empty((count, kernels.SUMS))
    if search == "all_pairs":
        kernels.gather_all_pairs(np.ascontiguousarray(positions.T), directions, distance, cosine, sums)
    else:
        cells = sorted_cells(positions, distance)
        order = cells.order
        sorted_data = np.ascontiguousarray(positions[order].T), directions[order], distance, cosine, sums
        if threads == 1:
            kernels.gather_places(0, count, *cells, *sorted_data)
        else:
            kernels.gather_places_parallel(threads, *cells, *sorted_data)
    return split_sums(sums)


class NeighbourSearch(ABC):
    """Interface of neighbour searches, for the ``search`` of a flock."""

    @abstractmethod
    def gather(self, positions: Array, directions: Array, distance: float, field_of_view: float) -> Neighbourhood:
        """What :func:`gather` gives, to rounding."""


class Cells(NamedTuple):
    """Boids sorted by the cells of a grid, as :func:`modalshell.crowd.kernels.flock.sort_by_cell` tells."""

    bits: int
    keys: NDArray[np.int64]
    starts: NDArray[np.int64]
    order: NDArray[np.int64]


def sorted_cells(positions: Array, distance: float) -> Cells:
    """Cells of side ``distance`` [m]: a power of two along each axis, at least four, with one to eight a boid."""
    count = len(positions)
    bits = max(2, math.ceil(math.log2(max(count, 2)) / 3.0))
    keys, order = np.empty((2, count), np.int64)
    starts = np.empty((1 << 3 * bits) + 1, np.int64)
    kernels.sort_by_cell(positions, distance, bits, keys, starts, order)
    return Cells(bits, keys, starts, order)


def view_cosine(field_of_view: float) -> float:
    """Least cosine between the direction of flight and a visible neighbour, for a full viewing angle [rad]."""
    # cos(pi) is exactly -1, but rounding may push the cosine of the boid right behind below it.
    return math.cos(0.5 * field_of_view) if field_of_view < 2.0 * math.pi else -2.0


def split_sums(sums: Array) -> Neighbourhood:
    """The parts of the kernels' sums (N, 10)."""
    return Neighbourhood(sums[:, :3], sums[:, 3:6], sums[:, 6:9], sums[:, 9])
