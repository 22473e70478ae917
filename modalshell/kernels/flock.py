"""Sums over the neighbours of every boid: by brute force, and by a grid of cells that wraps round.

The neighbours of boid i are the others nearer than a distance, within its field of view. Every boid gathers its own
sums, so that the result does not depend on the threads.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

SUMS = 10
"""Numbers a boid gathers: separation, sum of directions, sum of positions (three each), count of neighbours."""

_kernel = njit(cache=True, error_model="numpy", fastmath=False)


@_kernel
def _gather(x, y, z, direction, first, last, positions, directions, reach, cosine, sums):  # type: ignore[no-untyped-def]
    """Add to ``sums`` (10,) what the boids ``first`` to ``last - 1`` are to one at (x, y, z).

    A boid in the same place, as the boid itself, is no neighbour: it has no side to turn to.
    """
    for other in range(first, last):
        dx, dy, dz = positions[other, 0] - x, positions[other, 1] - y, positions[other, 2] - z
        squared = dx * dx + dy * dy + dz * dz
        if squared >= reach * reach or squared == 0.0:
            continue
        distance = math.sqrt(squared)
        if direction[0] * dx + direction[1] * dy + direction[2] * dz < cosine * distance:
            continue
        away = 1.0 / reach - 1.0 / distance
        sums[0] += away * dx
        sums[1] += away * dy
        sums[2] += away * dz
        for axis in range(3):
            sums[3 + axis] += directions[other, axis]
            sums[6 + axis] += positions[other, axis]
        sums[9] += 1.0


@_kernel
def gather_all_pairs(positions, directions, reach, cosine, sums):  # type: ignore[no-untyped-def]
    """Sums (N, 10) over all pairs of boids: the check of the grid."""
    sums[:] = 0.0
    count = positions.shape[0]
    for i in range(count):
        x, y, z = positions[i]
        _gather(x, y, z, directions[i], 0, count, positions, directions, reach, cosine, sums[i])


@_kernel
def sort_by_cell(positions, reach, bits, keys, starts, order):  # type: ignore[no-untyped-def]
    """Counting sort of the boids into cells of side ``reach``, 2^bits of them along each axis and then from the start.

    The grid wraps round, so that it has as many cells as boids wherever these are; boids that share a cell from afar
    fail the test of their distance. ``keys`` (N,) are the cells, ``starts`` (cells + 1,) the first place of each,
    ``order`` (N,) the boid at each place, ascending within a cell.
    """
    mask = (1 << bits) - 1
    starts[:] = 0
    for i in range(positions.shape[0]):
        key = 0
        for axis in range(3):
            key = (key << bits) | (np.int64(math.floor(positions[i, axis] / reach)) & mask)
        keys[i] = key
        starts[key + 1] += 1
    for cell in range(starts.size - 1):
        starts[cell + 1] += starts[cell]
    # Filled from the back, each count ends as the first place of its cell.
    for i in range(positions.shape[0] - 1, -1, -1):
        starts[keys[i] + 1] -= 1
        order[starts[keys[i] + 1]] = i
    for cell in range(starts.size - 1):
        starts[cell] = starts[cell + 1]
    starts[starts.size - 1] = positions.shape[0]


@_kernel
def gather_places(first, last, bits, keys, starts, order, positions, directions, reach, cosine, sums):  # type: ignore[no-untyped-def]
    """Sums of the boids at the places ``first`` to ``last - 1``; positions and directions are in the cells' order.

    At least four cells an axis keep the 27 cells around a boid distinct.
    """
    mask = (1 << bits) - 1
    for place in range(first, last):
        boid = order[place]
        key = keys[boid]
        a, b, c = key >> (2 * bits), (key >> bits) & mask, key & mask
        x, y, z = positions[place]
        sums[boid] = 0.0
        for da in range(-1, 2):
            for db in range(-1, 2):
                row = ((((a + da) & mask) << bits) | ((b + db) & mask)) << bits
                if 0 < c < mask:  # the three cells lie side by side
                    begin, end = starts[row + c - 1], starts[row + c + 2]
                    _gather(x, y, z, directions[place], begin, end, positions, directions, reach, cosine, sums[boid])
                    continue
                for dc in range(-1, 2):
                    cell = row | ((c + dc) & mask)
                    begin, end = starts[cell], starts[cell + 1]
                    _gather(x, y, z, directions[place], begin, end, positions, directions, reach, cosine, sums[boid])


@njit(cache=True, error_model="numpy", fastmath=False, parallel=True)
def gather_places_parallel(parts, bits, keys, starts, order, positions, directions, reach, cosine, sums):  # type: ignore[no-untyped-def]
    """:func:`gather_places` over as many equal parts, each on a thread."""
    count = positions.shape[0]
    for part in prange(parts):
        begin, end = part * count // parts, (part + 1) * count // parts
        gather_places(begin, end, bits, keys, starts, order, positions, directions, reach, cosine, sums)
