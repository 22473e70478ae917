"""Kernels of sparsity patterns: where element blocks stand in them, and the entries of the free unknowns."""

from __future__ import annotations

from typing import Any

import numpy as np

from modalshell.kernels.compiler import njit


@njit(fastmath=False)
def find_blocks(rows: Any, columns: Any, starts: Any, indices: Any, lead: int, shift: int, slots: Any) -> int:
    """Write ``lead starts[row] + 3 place + shift`` of every pair of an element's rows and columns into ``slots``.

    ``rows`` (elements, r) and ``columns`` (elements, c) are of a CSR pattern of blocks, columns sorted; of a pair that
    it does not have the slot (elements, r, c) is -1. Returns the number of those that a square pattern could have.
    """
    count, lacking = starts.size - 1, 0
    for element in range(rows.shape[0]):
        for i in range(rows.shape[1]):
            row = rows[element, i]
            start, size = 0, 0
            if 0 <= row < count:
                start, size = starts[row], starts[row + 1] - starts[row]
            for j in range(columns.shape[1]):
                column = columns[element, j]
                if size == 0:
                    slots[element, i, j] = -1
                    lacking += 0 <= row < count and 0 <= column < count
                    continue
                # Halved without branches, which a processor would guess wrong every other time.
                low, left = start, size
                while left > 1:
                    half = left // 2
                    low = low + half if indices[low + half] <= column else low
                    left -= half
                slots[element, i, j] = lead * start + 3 * low + shift
                if indices[low] != column:
                    slots[element, i, j] = -1
                    lacking += 0 <= column < count
    return lacking


@njit(fastmath=False)
def free_values(
    data: Any,
    free: Any,
    starts: Any,
    columns: Any,
    coupling_starts: Any,
    coupled: Any,
    meeting_starts: Any,
    meeting: Any,
    own_starts: Any,
    out: Any,
) -> None:
    """Write the entries of the ``free`` (n,) vertices' unknowns and of the internal ones into ``out``, row by row.

    ``starts`` and ``columns`` are the vertices' blocks, ``coupling_starts`` and ``coupled`` the vertices that every
    internal unknown is coupled to, ``meeting_starts`` and ``meeting`` where each vertex stands in ``coupled``, and
    ``own_starts`` the row starts of the internal unknowns' own matrix.
    """
    at, begin = 0, 0
    coupling, own = 9 * columns.size, 9 * columns.size + 3 * coupled.size
    for vertex in range(free.size):
        width = 3 * (starts[vertex + 1] - starts[vertex])
        if not free[vertex]:
            begin += 3 * width
            continue
        kept = 0
        for place in range(starts[vertex], starts[vertex + 1]):
            kept += 3 * free[columns[place]]
        for axis in range(3):
            if kept == width:
                target, source = np.uintp(at), np.uintp(begin)  # signed ones are checked for counts from the end
                for k in range(np.uintp(width)):
                    out[target + k] = data[source + k]
                at += width
            else:
                for k in range(width):
                    if free[columns[starts[vertex] + k // 3]]:
                        out[at] = data[begin + k]
                        at += 1
            begin += width
            for place in range(meeting_starts[vertex], meeting_starts[vertex + 1]):
                out[at] = data[coupling + 3 * meeting[place] + axis]
                at += 1
    for unknown in range(own_starts.size - 1):
        for place in range(coupling_starts[unknown], coupling_starts[unknown + 1]):
            if free[coupled[place]]:
                begin = coupling + 3 * place
                out[at], out[at + 1], out[at + 2] = data[begin], data[begin + 1], data[begin + 2]
                at += 3
        for place in range(own_starts[unknown], own_starts[unknown + 1]):
            out[at] = data[own + place]
            at += 1
