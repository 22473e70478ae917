"""Nested dissection of a graph, compiled: level cuts between far vertices, improved by minimum vertex separators.

In loops throughout: NumPy's functions of whole arrays would take as long to compile as all the rest.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from modalshell.core.typing import Index
from modalshell.kernels.compiler import njit
from modalshell.linalg.analysis import distances

_LEAST = 0.3
"""Share of a part's vertices that each side of a level cut has at least, and half of it once its separator is found."""
_BAND = 0.1
"""Share of a part's vertices on either side of a level cut among which the minimum separator is sought."""


@njit
def dissect(starts: Index, neighbours: Index, leaf: int) -> tuple[Index, Index]:
    """Nested dissection order (n,) of a graph [george1973], and where the small part of each of its places begins.

    Parts of at most ``leaf`` vertices, and connected ones that no cut halves, are left as they are; the places (n,) of
    separators are in no part: -1.
    """
    n = len(starts) - 1
    order = _sorted(distances(starts, neighbours, 0))  # neighbours are near in memory
    part_begin, number = np.empty(n, np.int64), np.empty(n, np.int64)
    for v in range(n):
        number[v] = -1
    stack = np.empty((n + 1, 2), np.int64)
    stack[0, 0], stack[0, 1] = 0, n
    depth = 1
    while depth > 0:
        depth -= 1
        begin, end = stack[depth, 0], stack[depth, 1]
        for place in range(begin, end):
            part_begin[place] = begin
        if end - begin <= leaf:
            continue
        vertices = np.empty(end - begin, np.int64)
        for i in range(end - begin):
            vertices[i] = order[begin + i]
        part = _subgraph(starts, neighbours, vertices, number)
        side, across = _cut(*part)
        lower_size, upper_size = 0, 0
        for i in range(len(side)):
            lower_size += side[i] == 0
            upper_size += side[i] == 1
        separated = lower_size + upper_size < len(side)
        if min(lower_size, upper_size) < (0.5 * _LEAST * len(side) if separated else 1):
            continue
        upper, place = begin + lower_size, begin + lower_size + upper_size
        stack[depth, 0], stack[depth, 1] = begin, upper
        stack[depth + 1, 0], stack[depth + 1, 1] = upper, place
        depth += 2
        low, high, last = begin, upper, place
        along = _sorted(across)
        for k in range(len(side)):
            if side[k] == 0:
                order[low] = vertices[k]
                low += 1
            elif side[k] == 1:
                order[high] = vertices[k]
                high += 1
            i = along[k]  # separators from one end to the other
            if side[i] == 2:
                order[last], part_begin[last] = vertices[i], -1
                last += 1
    return order, part_begin


@njit
def _range(levels: Index) -> tuple[int, int]:
    """The least and the largest of some numbers."""
    least, most = levels[0], levels[0]
    for i in range(len(levels)):
        least, most = min(least, levels[i]), max(most, levels[i])
    return least, most


@njit
def _sorted(levels: Index) -> Index:
    """Order (m,) that sorts whole numbers of a narrow range, stable."""
    least, most = _range(levels)
    begins = np.zeros(most - least + 2, np.int64)
    for level in levels:
        begins[level - least + 1] += 1
    for level in range(1, len(begins)):
        begins[level] += begins[level - 1]
    order = np.empty(len(levels), np.int64)
    for i in range(len(levels)):
        order[begins[levels[i] - least]] = i
        begins[levels[i] - least] += 1
    return order


@njit
def _subgraph(starts: Index, neighbours: Index, vertices: Index, number: Index) -> tuple[Index, Index]:
    """The graph of some vertices, without their entries on the diagonal; ``number`` (n,) is -1 before and after.

    Its neighbours end where its last vertex has them; there may be room after that.
    """
    most = 0
    for i in range(len(vertices)):
        number[vertices[i]] = i
        most += starts[vertices[i] + 1] - starts[vertices[i]]
    own_starts, own = np.empty(len(vertices) + 1, np.int64), np.empty(most, np.int64)
    own_starts[0] = count = 0
    for i in range(len(vertices)):
        v = vertices[i]
        for e in range(starts[v], starts[v + 1]):
            j = number[neighbours[e]]
            if j >= 0 and j != i:
                own[count] = j
                count += 1
        own_starts[i + 1] = count
    for i in range(len(vertices)):
        number[vertices[i]] = -1
    return own_starts, own


@njit
def _cut(starts: Index, neighbours: Index) -> tuple[Index, Index]:
    """Side (m,) of each vertex, 0, 1 or, in the separator, 2; and a coordinate (m,) along the separator.

    Coordinates are differences of the distances from four far vertices. The best cut between their levels that leaves
    enough vertices on both sides gives the band in which the minimum separator is found, as in inertial flow
    [schild2015].
    """
    side, apart = _apart(starts, neighbours)
    if apart:
        return side, side
    axes = _coordinates(starts, neighbours)
    fewest, chosen, low, high = np.inf, -1, 0, 0
    for k in range(4):
        cost, below, above = _level_cut(starts, neighbours, axes[k])
        if cost < fewest:
            fewest, chosen, low, high = cost, k, below, above
    if chosen >= 0:
        for i in range(len(side)):
            side[i] = 0 if axes[chosen, i] <= low else 1 if axes[chosen, i] >= high else 2
        minimum_separator(starts, neighbours, axes[chosen], side)
    return side, axes[chosen ^ 1]


@njit
def _apart(starts: Index, neighbours: Index) -> tuple[Index, bool]:
    """Sides (m,) of the pieces of a graph, as even as their order allows; and whether there are several."""
    m = len(starts) - 1
    found, queue = np.zeros(m, np.bool_), np.empty(m, np.int64)
    count, k, middle = 0, 0, 0
    for vertex in range(m):
        if found[vertex]:
            continue
        if abs(2 * count - m) < abs(2 * middle - m):
            middle = count
        found[vertex], queue[count] = True, vertex
        count += 1
        while k < count:
            for e in range(starts[queue[k]], starts[queue[k] + 1]):
                j = neighbours[e]
                if not found[j]:
                    found[j], queue[count] = True, j
                    count += 1
            k += 1
    side = np.zeros(m, np.int64)
    for k in range(middle, m if middle > 0 else 0):
        side[queue[k]] = 1
    return side, middle > 0


@njit
def _coordinates(starts: Index, neighbours: Index) -> Index:
    """Four coordinates (4, m), the first two and the last two across each other."""
    nearest = distances(starts, neighbours, 0)
    axes = np.empty((4, len(nearest)), np.int64)
    for k in range(4):
        furthest = 0
        for i in range(len(nearest)):
            if nearest[i] > nearest[furthest]:
                furthest = i
        found = distances(starts, neighbours, furthest)
        for i in range(len(nearest)):
            axes[k, i] = found[i]
            nearest[i] = found[i] if k == 0 else min(nearest[i], found[i])
    for i in range(len(nearest)):
        first, second = axes[0, i] - axes[1, i], axes[2, i] - axes[3, i]
        axes[0, i], axes[1, i], axes[2, i], axes[3, i] = first, second, first + second, first - second
    return axes


@njit
def _level_cut(starts: Index, neighbours: Index, along: Index) -> tuple[float, int, int]:
    """Cost of the best cut between levels of a coordinate, inf without one, and the levels that bound its band.

    The cost is the number of vertices that separate the two sides, more where these are uneven.
    """
    m = len(along)
    least, most = _range(along)
    levels = most - least + 1
    counts = np.zeros(levels + 1, np.int64)
    lower, upper = np.zeros(levels + 1, np.int64), np.zeros(levels + 1, np.int64)
    for i in range(m):
        own = lowest = highest = along[i] - least
        for e in range(starts[i], starts[i + 1]):
            other = along[neighbours[e]] - least
            lowest, highest = min(lowest, other), max(highest, other)
        counts[own] += 1
        # Cuts after the levels from this one on to its highest neighbour's have it as an end on their lower side.
        lower[own] += 1
        lower[highest] -= 1
        upper[lowest] += 1
        upper[own] -= 1
    best, cut, below, lower_ends, upper_ends = np.inf, 0, 0, 0, 0
    for level in range(levels):
        below += counts[level]
        lower_ends += lower[level]
        upper_ends += upper[level]
        if min(below, m - below) >= _LEAST * m:
            cost = (min(lower_ends, upper_ends) + 1) / (below * (m - below))
            if cost < best:
                best, cut = cost, below
    first, last = max(cut - _BAND * m, _LEAST * m), min(cut + _BAND * m, m - _LEAST * m)
    low, high, below = 0, levels - 1, 0
    for level in range(levels - 1, -1, -1):
        if m - below >= last:
            high = min(levels - 1, level + 1)
        below += counts[level]
        if m - below >= first:
            low = max(0, level - 1)
    return best, low + least, high + least


@njit
def minimum_separator(starts: Index, neighbours: Index, along: Index, side: Any) -> int:
    """The fewest vertices that separate those of side 0 from those of side 1; ``side`` (m,) is 2 for others.

    Vertices of these, and of side 0 next to side 1, go to a side or stay 2, in the separator. It is as large as the
    most paths between the sides that share no vertex [even1975]: these are found by depth-first search, up the
    coordinate ``along`` (m,) first. Returns its size.
    """
    m, order = len(side), _sorted(along)
    for i in range(m):
        for e in range(starts[i], starts[i + 1]):
            if side[i] == 0 and side[neighbours[e]] == 1:
                side[i] = 2
    between, count = np.empty(m, np.int64), 0
    for k in range(m):
        if side[order[k]] == 2:
            between[count] = order[k]
            count += 1
    source, sink = np.zeros(m, np.bool_), np.zeros(m, np.bool_)
    near, ends = np.empty(len(neighbours), np.int64), np.empty(m, np.int64)
    for i in range(m):
        ends[i] = starts[i]
    for k in range(count - 1, -1, -1):  # neighbours between the sides, the highest first
        i = between[k]
        for e in range(starts[i], starts[i + 1]):
            j = neighbours[e]
            near[ends[j]] = i
            ends[j] += 1
            source[i] |= side[j] == 0
            sink[i] |= side[j] == 1
    before, came, arc = np.empty(m, np.int64), np.zeros(2 * m + 2, np.int64), np.empty(m, np.int64)
    for i in range(m):
        before[i] = -1
    size, more = 0, 1
    while more > 0:
        more = 0
        for k in range(count):
            i = between[k]
            arc[i] = starts[i]
            came[2 * i] = came[2 * i + 1] = -1
        for k in range(count):
            i = between[k]
            if source[i] and came[2 * i] < 0:
                more += _augment(near, ends, sink, before, came, arc, i)
        size += more
    for k in range(count):
        i = between[k]
        side[i] = 0 if came[2 * i + 1] >= 0 else 2 if came[2 * i] >= 0 else 1
    return size


@njit
def _augment(near: Index, ends: Index, sink: Any, before: Index, came: Index, arc: Index, start: int) -> bool:
    """Find one more path from a vertex to the sink through states not reached yet, and take it.

    A vertex i is two states, 2 i entered and 2 i + 1 left; ``came`` (2m + 2,) is the state each was reached from, 2 m
    or more outside. ``before`` (m,) is the vertex before each on its path, m at the path's start, -1 on none: a vertex
    on another path can only be entered to turn back along that, or left because that turned back.
    """
    outside = 2 * len(before)
    state, came[2 * start] = 2 * start, outside
    while state < outside and not (state % 2 == 1 and sink[state // 2]):
        i = state // 2
        if state % 2 == 0:
            following = state + 1 if before[i] < 0 else 2 * before[i] + 1
        else:
            following = state - 1
            while came[following] >= 0 and arc[i] < ends[i]:
                following = 2 * near[arc[i]]
                arc[i] += 1
        if came[following] < 0:
            came[following], state = state, following
        else:
            state = came[state]
    reached = state < outside
    while state < outside:
        if state % 2 == 0:  # no path goes through a vertex that was left before it was entered
            before[state // 2] = -1 if came[state] == state + 1 else came[state] // 2
        state = came[state]
    return reached
