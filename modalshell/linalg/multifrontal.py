"""Numeric multifrontal Cholesky factorisation [duff1983; liu1992], compiled; with signs, of indefinite matrices too."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from modalshell.core.typing import Array, Index
from modalshell.kernels.compiler import njit
from modalshell.linalg.blas import Blas, address, call
from modalshell.linalg.panel_layout import lay_out

_CACHED = 2**17
"""Numbers of the widest update that is formed in a buffer of its own: 1 MB, what a second cache holds."""
PANEL = 96
"""Unknowns of a panel, a multiple of 3: wider supernodes are several panels, each without the rows above it."""


class Supernodes(NamedTuple):
    """Columns, rows, tree and panels of a factor's supernodes, in blocks."""

    block: int
    """Unknowns of a block."""
    first: Index
    """First column of each supernode; shape (s + 1,)."""
    row_starts: Index
    """Where the rows of each begin, its own columns first; shape (s + 1,)."""
    relative: Index
    """Where each of these rows stands among those of the parent."""
    parent: Index
    """The supernode that takes the update of each, -1 at roots; shape (s,)."""
    first_panel: Index
    """First panel of each; shape (s + 1,)."""
    panels: Index
    """Where the numbers of each panel begin while they are column-major; shape (p,)."""
    ends: Index
    """Where those of each supernode end, behind the begin of the next one's; shape (s,)."""
    laid_out: Index
    """Where those of each panel begin once they are laid out; shape (p,)."""


class Entries(NamedTuple):
    """Which entries of a matrix go where in the panels, and where those of each supernode (s + 1,) begin."""

    sources: Any
    places: Any
    begins: Index


@njit
def factorise(
    data: Array,
    entries: Entries,
    supernodes: Supernodes,
    values: Array,
    buffer: int,
    numbers: Any,
    signs: Array,
    blas: Blas,
) -> int:
    """Factorise into ``values``; returns -1, or the first unknown, in elimination order, whose pivot is not positive.

    With room for ``signs`` (N,) of pivots, in elimination order, negative ones are taken as they come: the matrix is
    ``L S L^T``, and the unknown is one whose pivot is zero or no number. Without (0,), it is ``L L^T``.

    A supernode's panels hold its columns of L, column-major until its update is formed, then closer together, as
    :mod:`modalshell.linalg.panel_layout` says. Its update matrix is formed from ``values[buffer]`` on,
    which stays in the processor's cache, or where the room is too small behind the panels. It waits for its parent, the
    lower triangle packed, on a stack that grows down from there, where no panel is yet: children are contiguous in
    postorder, so that a supernode finds theirs on top. ``numbers`` (7,) has room for the sizes that the BLAS reads.
    """
    block, first, row_starts, relative, parent, first_panel, panels, ends, laid_out = supernodes
    sources, places, entry_begins = entries
    begins = np.empty(len(parent), np.int64)  # of the updates on the stack
    waiting = np.empty(len(parent), np.int64)
    runs = np.empty((len(relative) + 1, 2), np.int64)
    depth, top, highest = 0, buffer, 0
    for s in range(len(parent)):
        highest = max(highest, row_starts[s + 1] - row_starts[s])
    room = np.empty(8 * highest * block, values.dtype)
    for s in range(len(parent)):
        width = (first[s + 1] - first[s]) * block
        below = (row_starts[s + 1] - row_starts[s]) * block - width
        panel, behind = panels[first_panel[s]], ends[s]
        _clear(values, panel, behind)
        for e in range(entry_begins[s], entry_begins[s + 1]):
            values[places[e]] = data[sources[e]]
        update = buffer if below * below <= len(values) - buffer else behind
        has_children = depth > 0 and parent[waiting[depth - 1]] == s
        if has_children:
            for j in range(below):
                begin = update + j * below
                _clear(values, begin + j, begin + below)
        while depth > 0 and parent[waiting[depth - 1]] == s:
            depth -= 1
            top = _gather(supernodes, waiting[depth], values, begins[depth], update, runs)
        if width == 1 and signs.size == 0:  # arithmetic that calls would cost more than
            if not values[panel] > 0.0:
                return int(first[s] * block)
            top -= below * (below + 1) // 2
            _eliminate_one(values, panel, below, update, has_children, top)
        else:
            wrong = _eliminate(supernodes, s, values, update, has_children, numbers, signs, blas)
            if wrong >= 0:
                return wrong
            top = _stack(values, top, update, below)
            for p in range(first_panel[s], first_panel[s + 1]):
                above = (p - first_panel[s]) * PANEL
                lay_out(values, panels[p], min(PANEL, width - above), width + below - above, laid_out[p], room)
        if below > 0:
            waiting[depth], begins[depth] = s, top
            depth += 1
    return -1


@njit
def _clear(values: Array, begin: int, end: int) -> None:
    """Write zeros; a slice, which numba compiles slowly, would do no more."""
    start = np.uintp(begin)
    for i in range(np.uintp(end - begin)):
        values[start + i] = 0.0


@njit
def _gather(supernodes: Supernodes, child: int, values: Array, source: int, update: int, runs: Index) -> int:
    """Add a child's update, packed from ``values[source]`` on, to its parent's panels and update; returns its end."""
    block, first, row_starts, relative, parent, first_panel, panels, _, _ = supernodes
    s = parent[child]
    width, height = (first[s + 1] - first[s]) * block, (row_starts[s + 1] - row_starts[s]) * block
    below = height - width
    rows = row_starts[child] + first[child + 1] - first[child]
    size = (row_starts[child + 1] - rows) * block
    found = _runs(relative, rows, row_starts[child + 1], block, runs)
    run = 0
    for j in range(size):
        run += j == runs[run + 1, 0]
        column = runs[run, 1] + j - runs[run, 0]
        if column < width:
            above = column // PANEL * PANEL
            begin = panels[first_panel[s] + column // PANEL] + (column - above) * (height - above) - above
        else:
            begin = update + (column - width) * below - width
        _add_column(values, source - j, j, run, found, runs, begin)
        source += size - j
    return source


@njit
def _eliminate(
    supernodes: Supernodes,
    s: int,
    values: Array,
    update: int,
    has_children: bool,
    numbers: Any,
    signs: Array,
    blas: Blas,
) -> int:
    """Factorise the panels of a supernode, and subtract their products from its update.

    Returns -1, or the first unknown whose pivot does not serve. What children left in the update is kept.
    """
    block, first, row_starts, _, _, first_panel, panels, _, _ = supernodes
    width, height = (first[s + 1] - first[s]) * block, (row_starts[s + 1] - row_starts[s]) * block
    below = height - width
    base, sizes, wide = address(values), address(numbers), np.int64(values.itemsize)
    p_width, p_height, p_below = sizes, sizes + 4, sizes + 8
    p_info, p_rest, p_columns, p_single = sizes + 12, sizes + 16, sizes + 20, sizes + 24
    lower, no, transposed, one, minus = blas.lower, blas.no, blas.transposed, blas.one, blas.minus
    beta = one if has_children else blas.zero
    for p in range(first_panel[s], first_panel[s + 1]):
        above = (p - first_panel[s]) * PANEL
        columns, rows = min(PANEL, width - above), height - above
        numbers[0], numbers[1], numbers[2], numbers[4] = columns, rows, below, rows - columns
        at = base + wide * panels[p]
        under = at + wide * columns
        begin = first[s] * block + above
        if signs.size == 0:
            call(blas.potrf, (lower, p_width, at, p_height, p_info))
        else:
            numbers[3], numbers[6] = _signed_block(values, panels[p], columns, rows, signs, begin), 1
        if numbers[3] != 0:
            return int(begin + numbers[3] - 1)
        if rows == columns:
            continue
        call(blas.trsm, (blas.right, lower, transposed, no, p_rest, p_width, one, at, p_height, under, p_height))
        negative = 0 if signs.size == 0 else _flip(values, panels[p], columns, rows, signs, begin)
        for q in range(p + 1, first_panel[s + 1]):
            numbers[4], numbers[5] = rows - (q - p) * PANEL, min(PANEL, width - above - (q - p) * PANEL)
            factors = (under, p_height, under, p_height, one, base + wide * panels[q], p_rest)
            call(blas.gemm, (no, transposed, p_rest, p_columns, p_width, minus, *factors))
            for k in range(columns if negative else 0):  # those of negative pivots are added: twice, to what was taken
                for _ in range(2 if signs[begin + k] < 0.0 else 0):
                    own = under + wide * k * rows
                    call(
                        blas.gemm,
                        (no, transposed, p_rest, p_columns, p_single, one, own, p_height, own, p_height, *factors[4:]),
                    )
            under += wide * PANEL
        if below > 0:
            under = at + wide * (rows - below)
            target = base + wide * update
            call(blas.syrk, (lower, no, p_below, p_width, minus, under, p_height, beta, target, p_below))
            beta = one
            for k in range(columns if negative else 0):
                for _ in range(2 if signs[begin + k] < 0.0 else 0):
                    own = under + wide * k * rows
                    call(blas.syrk, (lower, no, p_below, p_single, one, own, p_height, one, target, p_below))
    return -1


@njit
def _signed_block(values: Array, at: int, columns: int, height: int, signs: Array, begin: int) -> int:
    """Factorise a diagonal block as ``L S L^T``; returns 0, or the number of the pivot that is zero or no number."""
    for k in range(columns):
        own = at + k * height
        pivot = values[own + k]
        if not 0.0 < abs(pivot) < np.inf:
            return k + 1
        signs[begin + k] = 1.0 if pivot > 0.0 else -1.0
        root = np.sqrt(abs(pivot))
        values[own + k] = root
        for i in range(k + 1, columns):
            values[own + i] *= signs[begin + k] / root
        for j in range(k + 1, columns):
            factor, start, under = signs[begin + k] * values[own + j], np.uintp(at + j * height + j), np.uintp(own + j)
            for i in range(np.uintp(columns - j)):
                values[start + i] -= factor * values[under + i]
    return 0


@njit
def _flip(values: Array, at: int, columns: int, height: int, signs: Array, begin: int) -> int:
    """Give what is below a diagonal block, which is ``L S`` there, the signs of L; returns the negative pivots."""
    negative = 0
    for k in range(columns):
        if signs[begin + k] < 0.0:
            negative += 1
            for i in range(columns, height):
                values[at + k * height + i] *= -1.0
    return negative


@njit
def _stack(values: Array, top: int, update: int, below: int) -> int:
    """Pack the lower triangle of an update before ``values[top]``; returns where it begins."""
    top -= below * (below + 1) // 2
    target = top
    for j in range(below):
        begin = update + j * below
        to, source = np.uintp(target), np.uintp(begin + j)
        for i in range(np.uintp(below - j)):
            values[to + i] = values[source + i]
        target += below - j
    return top


@njit
def _runs(relative: Index, begin: int, end: int, block: int, runs: Index) -> int:
    """Part rows of unknowns where those of the parent are not contiguous; returns the number of runs.

    ``runs`` receives where each begins, and its first row in the parent; then the end of the last.
    """
    found = 0
    for e in range(begin, end):
        if e == begin or relative[e] != relative[e - 1] + 1:
            runs[found, 0], runs[found, 1] = (e - begin) * block, relative[e] * block
            found += 1
    runs[found, 0] = (end - begin) * block
    return found


@njit
def _add_column(values: Array, source: int, j: int, run: int, found: int, runs: Index, column: int) -> None:
    """Add rows from ``j`` on of the column whose row 0 would be at ``values[source]`` to that at ``values[column]``."""
    begin = j
    for k in range(run, found):
        start, shift = np.uintp(source + begin), np.uintp(column + runs[k, 1] + begin - runs[k, 0])
        for i in range(np.uintp(runs[k + 1, 0] - begin)):
            values[shift + i] += values[start + i]
        begin = runs[k + 1, 0]


@njit
def _eliminate_one(values: Array, panel: int, below: int, update: int, has_children: bool, top: int) -> None:
    """Eliminate one unknown, and put its packed update at ``top``: what it adds to that of children at ``update``."""
    values[panel] = np.sqrt(values[panel])
    zero, inverse = values.dtype.type(0.0), values.dtype.type(1.0 / values[panel])
    column = np.uintp(panel + 1)
    for i in range(np.uintp(below)):
        values[column + i] *= inverse
    target = np.uintp(top)
    for j in range(below):
        size, under, entry = np.uintp(below - j), column + np.uintp(j), -values[panel + 1 + j]
        if has_children:
            own = np.uintp(update + j * below + j)
            for i in range(size):
                values[target + i] = values[own + i] + entry * values[under + i]
        else:
            for i in range(size):
                values[target + i] = zero + entry * values[under + i]
        target += size


@njit
def storage(supernodes: Supernodes) -> tuple[int, int]:
    """How many numbers :func:`factorise` needs for panels, updates and those that wait, and in its buffer."""
    block, first, row_starts, _, parent, _, _, ends, _ = supernodes
    most, widest, top, depth = 0, 0, 0, 0
    sizes = np.empty(len(parent), np.int64)
    waiting = np.empty(len(parent), np.int64)
    for s in range(len(parent)):
        below = (row_starts[s + 1] - row_starts[s] - (first[s + 1] - first[s])) * block
        if below * below <= _CACHED:
            widest, behind = max(widest, below), ends[s]
        else:
            behind = ends[s] + below * below
        most = max(most, behind + top)
        while depth > 0 and parent[waiting[depth - 1]] == s:
            depth -= 1
            top -= sizes[depth]
        if below > 0:
            waiting[depth], sizes[depth] = s, below * (below + 1) // 2
            depth += 1
            top += below * (below + 1) // 2
            most = max(most, behind + top)
    return most, widest * widest
