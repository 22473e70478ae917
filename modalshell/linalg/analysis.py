"""Symbolic analysis of a sparse Cholesky factorisation: elimination tree, relaxed supernodes and their rows."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from modalshell.core.typing import Index
from modalshell.kernels.compiler import njit

_ALWAYS, _OFTEN, _SOMETIMES = 12, 24, 72
"""Widths [unknowns] of a merged supernode up to which zeros are accepted freely, by a third, or by a tenth."""
_ZEROS_OFTEN, _ZEROS_SOMETIMES, _ZEROS_RARELY = 0.3, 0.1, 0.01
"""Shares of explicit zeros in a merged supernode of these widths, and of wider ones."""


@njit
def elimination_tree(starts: Index, neighbours: Index) -> Index:
    """Parent of each column (n,) in the elimination tree, -1 at roots [liu1990]; rows in compressed form."""
    n = len(starts) - 1
    parent = np.full(n, -1, np.int64)
    ancestor = np.full(n, -1, np.int64)
    for i in range(n):
        for e in range(starts[i], starts[i + 1]):
            k = neighbours[e]
            while k != -1 and k < i:
                following = ancestor[k]
                ancestor[k] = i
                if following == -1:
                    parent[k] = i
                k = following
    return parent


@njit
def postorder(parent: Index) -> Index:
    """Columns (n,) in an order in which every column follows its descendants, and these are contiguous."""
    n = len(parent)
    first_child = np.full(n, -1, np.int64)
    sibling = np.full(n, -1, np.int64)
    for j in range(n - 1, -1, -1):
        if parent[j] >= 0:
            sibling[j] = first_child[parent[j]]
            first_child[parent[j]] = j
    order = np.empty(n, np.int64)
    count = 0
    stack = np.empty(n, np.int64)
    for root in range(n):
        if parent[root] >= 0:
            continue
        stack[0], depth = root, 1
        while depth > 0:
            j = stack[depth - 1]
            child = first_child[j]
            if child >= 0:
                first_child[j] = sibling[child]
                stack[depth] = child
                depth += 1
            else:
                order[count] = j
                count += 1
                depth -= 1
    return order


@njit
def column_counts(starts: Index, neighbours: Index, parent: Index, sizes: Index) -> Index:
    """Entries (n,) in each column of the factor, the diagonal included: every row's subtree is walked.

    A row counts for as many as its size (n,) says.
    """
    n = len(parent)
    counts = sizes.copy()
    mark = np.full(n, -1, np.int64)
    for i in range(n):
        mark[i] = i
        for e in range(starts[i], starts[i + 1]):
            k = neighbours[e]
            while k < i and mark[k] != i:
                counts[k] += sizes[i]
                mark[k] = i
                k = parent[k]
    return counts


@njit
def supernodes(parent: Index, counts: Index, block: int) -> Index:
    """First columns (s + 1,) of relaxed supernodes of a postordered tree, a column being one of ``block`` unknowns.

    Chains of equal structure are joined; then a supernode joins the one that follows it, its parent, where that adds
    few explicit zeros.
    """
    n = len(parent)
    children = np.zeros(n, np.int64)
    for j in range(n):
        if parent[j] >= 0:
            children[parent[j]] += 1
    first = np.empty(n + 1, np.int64)
    count = 0
    for j in range(n):
        chained = j > 0 and parent[j - 1] == j and counts[j - 1] == counts[j] + 1 and children[j] == 1
        if not chained:
            first[count] = j
            count += 1
    first[count] = n
    counts = counts.copy()
    merged = np.empty(n + 1, np.int64)
    merged_zeros = np.zeros(n + 1)
    top = 0
    for s in range(count):
        begin, end = first[s], first[s + 1]
        merged[top] = begin
        merged_zeros[top] = 0.0
        top += 1
        while top > 1:
            before = merged[top - 2]
            if parent[merged[top - 1] - 1] != merged[top - 1]:
                break
            # The earlier columns would get the rows of the supernode that follows them.
            middle = merged[top - 1]
            width_low, width_high = middle - before, end - middle
            rows_low, rows_high = counts[before], counts[middle]
            width = width_low + width_high
            extra = width_low * (width_low + rows_high - rows_low)
            wasted = merged_zeros[top - 2] + merged_zeros[top - 1] + extra
            rows = width_low + rows_high
            total = width * (rows - 0.5 * (width - 1))
            share = wasted / total
            join = (
                block * width <= _ALWAYS
                or (block * width <= _OFTEN and share < _ZEROS_OFTEN)
                or (block * width <= _SOMETIMES and share < _ZEROS_SOMETIMES)
                or share < _ZEROS_RARELY
            )
            if not join:
                break
            merged_zeros[top - 2] = wasted
            counts[before] = rows
            top -= 1
    merged[top] = n
    return merged[: top + 1].copy()


@njit
def supernode_rows(starts: Index, neighbours: Index, first: Index, parent: Index) -> tuple[Index, Index, Index]:
    """Where the rows of each supernode begin (s + 1,), the rows, sorted, its own columns first, and its parent (s,).

    Row i is in every supernode on the way from those of its neighbours before it up to its own. The parent takes the
    update of a supernode; that of roots is -1.
    """
    count, n = len(first) - 1, len(starts) - 1
    of = np.empty(n, np.int64)
    above = np.full(count, -1, np.int64)
    for s in range(count):
        for j in range(first[s], first[s + 1]):
            of[j] = s
    for s in range(count):
        last = parent[first[s + 1] - 1]
        if last >= 0:
            above[s] = of[last]
    row_starts = np.zeros(count + 1, np.int64)
    rows = np.empty(0, np.int64)
    sizes = np.empty(count, np.int64)
    for filling in range(2):
        for s in range(count):
            sizes[s] = first[s + 1] - first[s]
            for k in range(filling * sizes[s]):
                rows[row_starts[s] + k] = first[s] + k
        mark = np.full(count, -1, np.int64)
        for i in range(n):
            for e in range(starts[i], starts[i + 1]):
                if neighbours[e] >= i:
                    continue
                s = of[neighbours[e]]
                while s != of[i] and mark[s] != i:
                    mark[s] = i
                    if filling == 1:
                        rows[row_starts[s] + sizes[s]] = i
                    sizes[s] += 1
                    s = above[s]
        if filling == 0:
            for s in range(count):
                row_starts[s + 1] = row_starts[s] + sizes[s]
            rows = np.empty(row_starts[count], np.int64)
    return row_starts, rows, above


@njit
def relative_rows(first: Index, row_starts: Index, rows: Index, above: Index) -> Index:
    """Where each row below a supernode's own columns stands among the rows of the one above; aligned with ``rows``."""
    relative = np.full(len(rows), -1, np.int64)
    for s in range(len(above)):
        if above[s] < 0:
            continue
        k = row_starts[above[s]]
        for e in range(row_starts[s] + first[s + 1] - first[s], row_starts[s + 1]):
            while rows[k] != rows[e]:
                k += 1
            relative[e] = k - row_starts[above[s]]
    return relative


@njit
def neighbour_sums(starts: Any, neighbours: Any, numbers: Any) -> Any:
    """Sum (n,) of the unsigned ``numbers`` of each vertex's neighbours, modulo 2^64."""
    sums = np.zeros(len(numbers), np.uint64)
    for i in range(len(numbers)):
        for e in range(starts[i], starts[i + 1]):
            sums[i] += numbers[neighbours[e]]
    return sums


@njit
def distances(starts: Index, neighbours: Index, vertex: int) -> Index:
    """Edges (n,) on the shortest way from a vertex; n to another part of a graph that is not connected."""
    n = len(starts) - 1
    found = np.full(n, n, np.int64)
    queue = np.empty(n, np.int64)
    found[vertex], queue[0], count, k = 0, vertex, 1, 0
    while k < count:
        i = queue[k]
        k += 1
        for e in range(starts[i], starts[i + 1]):
            j = neighbours[e]
            if found[j] == n:
                found[j] = found[i] + 1
                queue[count] = j
                count += 1
    return found


class Panels(NamedTuple):
    """Panels of a factor: where each begins, its columns and its rows, in blocks."""

    block: int
    """Unknowns of a block."""
    first: Index
    """First column of each panel; shape (p + 1,)."""
    row_starts: Index
    row_ends: Index
    """Where the rows of each begin and end in ``rows``; shape (p,)."""
    rows: Index
    """Rows of all supernodes."""
    begins: Index
    """Where the numbers of each panel begin; shape (p,)."""


@njit
def entry_places(
    starts: Index,
    indices: Index,
    order: Index,
    panels: Panels,
    sources: Any,
    places: Any,
) -> Index:
    """Write where the stored entries on and below the diagonal go in column-major panels, one after the other.

    ``starts`` and ``indices`` are the matrix's columns, ``order`` (n,) its blocks in the order of elimination.
    ``sources`` receives the entries, ``places`` where they go; returns where those of each panel begin (p + 1,).
    """
    block, first, row_starts, row_ends, rows, panel_begins = panels
    position = np.empty(len(order), np.int64)
    for j in range(len(order)):
        position[order[j]] = j
    local = np.empty(len(order), np.int64)
    found = np.full(len(order) * block, -1, np.int64)  # the last column with an entry in each row
    begins = np.zeros(len(first), np.int64)
    count = 0
    for s in range(len(first) - 1):
        for e in range(row_starts[s], row_ends[s]):
            local[rows[e]] = e - row_starts[s]
        height = (row_ends[s] - row_starts[s]) * block
        for j in range(first[s], first[s + 1]):
            for d in range(block):
                column = order[j] * block + d
                begin = panel_begins[s] + (local[j] * block + d) * height
                for e in range(starts[column], starts[column + 1]):
                    if found[indices[e]] == column:
                        raise ValueError("the matrix must store every entry once")
                    found[indices[e]] = column
                    i = position[indices[e] // block]
                    if i > j or (i == j and indices[e] >= column):
                        sources[count] = e
                        places[count] = begin + local[i] * block + indices[e] % block
                        count += 1
        begins[s + 1] = count
    return begins
