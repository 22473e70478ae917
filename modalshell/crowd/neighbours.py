"""What a boid's neighbours add up to: the sums that the rules of a flock are made of."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from modalshell.kernels import flock as kernels

Array = NDArray[np.float64]

Search = Literal["grid", "all_pairs"]


class Neighbourhood(NamedTuple):
    """Sums over each boid's neighbours.

    Attributes
    ----------
    separation : ndarray, shape (N, 3)
        Sum of ``offset (1 / distance - 1 / neighbour distance)``, the offset from the neighbour to the boid.
    directions : ndarray, shape (N, 3)
        Sum of the neighbours' directions.
    positions : ndarray, shape (N, 3)
        Sum of their positions [m].
    counts : ndarray, shape (N,)
        Their number.
    """

    separation: Array
    directions: Array
    positions: Array
    counts: Array


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

    Parameters
    ----------
    positions, directions : ndarray, shape (N, 3)
        Where the boids are [m], and where they head (unit vectors).
    distance : float
        Neighbours are nearer than this [m].
    field_of_view : float
        Full angle of the cone about its direction in which a boid sees [rad]; 2 pi is all round.
    search : {"grid", "all_pairs"}
        A grid of cells, whose cost grows as the number of boids at a fixed density; or every pair, to check it.
    threads : int
        Parts that the grid's boids are cut into, each on a thread of numba's if there are as many.

    Returns
    -------
    Neighbourhood
        The same for any number of threads, bit by bit.
    """
    # cos(pi) is exactly -1, but rounding may push the cosine of the boid right behind below it.
    cosine = math.cos(0.5 * field_of_view) if field_of_view < 2.0 * math.pi else -2.0
    count = len(positions)
    sums = np.empty((count, kernels.SUMS))
    if search == "all_pairs":
        kernels.gather_all_pairs(np.ascontiguousarray(positions.T), directions, distance, cosine, sums)
    else:
        # A power of two an axis, at least four, with one to eight cells a boid.
        bits = max(2, math.ceil(math.log2(max(count, 2)) / 3.0))
        keys, order = np.empty((2, count), np.int64)
        starts = np.empty((1 << 3 * bits) + 1, np.int64)
        kernels.sort_by_cell(positions, distance, bits, keys, starts, order)
        sorted_data = np.ascontiguousarray(positions[order].T), directions[order], distance, cosine, sums
        if threads == 1:
            kernels.gather_places(0, count, bits, keys, starts, order, *sorted_data)
        else:
            kernels.gather_places_parallel(threads, bits, keys, starts, order, *sorted_data)
    return Neighbourhood(sums[:, :3], sums[:, 3:6], sums[:, 6:9], sums[:, 9])
