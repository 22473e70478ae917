"""Sums over the neighbours of every boid, by brute force or by a periodic grid of cells.

The neighbours of boid i are the others nearer than a distance, within its field of view. Every boid gathers its own
sums, so that the result does not depend on the threads.
"""

import math

import numpy as np
from numba import prange

from modalshell.kernels.compiler import njit

SUMS = 10
"""Numbers a boid gathers: separation, sum of directions, sum of positions (three each), count of neighbours."""

_kernel = njit(error_model="numpy", fastmath=False)


_CHUNK = 128
"""Candidates whose distances are taken at once."""


@_kernel
def _gather(near, squared, position, direction, first, last, positions, directions, reach, cosine, sums):  # type: ignore[no-untyped-def]
    """Add to ``sums`` (10,) what the boids ``first`` to ``last - 1`` are to one at ``position``.

    ``positions`` are (3, N), ``directions`` (N, 3). A boid in the same place, as the boid itself, is no neighbour: it
    has no side to turn to. Most candidates are too far away; these are sifted out without branches that a processor
    would predict wrongly, by way of ``near`` and ``squared``, (_CHUNK,) each.
    """
    x, y, z = position
    farthest = reach * reach
    # Sums in registers, taken up where the last cells left them.
    separation, heading, middle = (sums[0], sums[1], sums[2]), (sums[3], sums[4], sums[5]), (sums[6], sums[7], sums[8])
    neighbours = 0
    for start in range(first, last, _CHUNK):
        count = min(_CHUNK, last - start)
        for i in range(count):
            dx, dy, dz = positions[0, start + i] - x, positions[1, start + i] - y, positions[2, start + i] - z
            squared[i] = dx * dx + dy * dy + dz * dz
        found = 0
        for i in range(count):
            near[found] = i
            found += (not squared[i] >= farthest) & (squared[i] != 0.0)  # so that NaN goes on and shows
        for i in range(found):
            other = start + near[i]
            dx, dy, dz = positions[0, other] - x, positions[1, other] - y, positions[2, other] - z
            distance = math.sqrt(squared[near[i]])
            if direction[0] * dx + direction[1] * dy + direction[2] * dz < cosine * distance:
                continue
            away = 1.0 / reach - 1.0 / distance
            separation = separation[0] + away * dx, separation[1] + away * dy, separation[2] + away * dz
            heading = (
                heading[0] + directions[other, 0],
                heading[1] + directions[other, 1],
                heading[2] + directions[other, 2],
            )
            middle = middle[0] + positions[0, other], middle[1] + positions[1, other], middle[2] + positions[2, other]
            neighbours += 1
    for axis in range(3):
        sums[axis], sums[3 + axis], sums[6 + axis] = separation[axis], heading[axis], middle[axis]
    sums[9] += neighbours


@_kernel
def gather_all_pairs(positions, directions, reach, cosine, sums):  # type: ignore[no-untyped-def]
    """Sums (N, 10) over all pairs of boids, ``positions`` (3, N) and ``directions`` (N, 3): the check of the grid."""
    sums[:] = 0.0
    near, squared = np.empty(_CHUNK, np.int64), np.empty(_CHUNK)
    count = positions.shape[1]
    for i in range(count):
        at = positions[0, i], positions[1, i], positions[2, i]
        _gather(near, squared, at, directions[i], 0, count, positions, directions, reach, cosine, sums[i])


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
    """Sums of the boids at the places ``first`` to ``last - 1``; positions (3, N) and directions (N, 3) are so sorted.

    At least four cells an axis keep the 27 cells around a boid distinct.
    """
    near, squared = np.empty(_CHUNK, np.int64), np.empty(_CHUNK)
    mask = (1 << bits) - 1
    for place in range(first, last):
        boid = order[place]
        key = keys[boid]
        a, b, c = key >> (2 * bits), (key >> bits) & mask, key & mask
        at, heading, own = (
            (positions[0, place], positions[1, place], positions[2, place]),
            directions[place],
            sums[boid],
        )
        own[:] = 0.0
        for da in range(-1, 2):
            for db in range(-1, 2):
                row = ((((a + da) & mask) << bits) | ((b + db) & mask)) << bits
                if 0 < c < mask:  # the three cells lie side by side
                    begin, end = starts[row + c - 1], starts[row + c + 2]
                    _gather(near, squared, at, heading, begin, end, positions, directions, reach, cosine, own)
                    continue
                for dc in range(-1, 2):
                    cell = row | ((c + dc) & mask)
                    begin, end = starts[cell], starts[cell + 1]
                    _gather(near, squared, at, heading, begin, end, positions, directions, reach, cosine, own)


@njit(error_model="numpy", fastmath=False, parallel=True)
def gather_places_parallel(parts, bits, keys, starts, order, positions, directions, reach, cosine, sums):  # type: ignore[no-untyped-def]
    """:func:`gather_places` over as many equal parts, each on a thread."""
    count = positions.shape[1]
    for part in prange(parts):
        begin, end = part * count // parts, (part + 1) * count // parts
        gather_places(begin, end, bits, keys, starts, order, positions, directions, reach, cosine, sums)
