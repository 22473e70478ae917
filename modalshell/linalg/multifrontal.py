"""Numeric multifrontal Cholesky factorisation and its triangular solves [duff1983; liu1992], compiled."""

from __future__ import annotations

from typing import Any

import numpy as np

from modalshell.core.typing import Array, Index
from modalshell.kernels.compiler import njit
from modalshell.linalg.analysis import Panels
from modalshell.linalg.blas import GEMM, GEMV, POTRF, SYRK, TRSM, TRSV, address, call

_CACHED = 2**17
"""Numbers of the widest update that is formed in a buffer of its own: 1 MB, what a second cache holds."""
PANEL = 96
"""Unknowns of a panel, a multiple of 3: wider supernodes are several panels, each without the rows above it."""


@njit
def factorise(
    data: Array,
    sources: Any,
    places: Any,
    entries: Index,
    block: int,
    first: Index,
    row_starts: Index,
    relative: Index,
    parent: Index,
    first_panel: Index,
    panels: Index,
    values: Array,
    work: Array,
    numbers: Any,
    addresses: Index,
    letters: Any,
    scalars: Array,
) -> int:
    """Factorise into ``values``; returns -1, or the first unknown, in elimination order, whose pivot is not positive.

    A supernode's panels, from ``first_panel[s]`` on, hold its columns of L, column-major; its entries of the matrix are
    ``data[sources]`` from ``entries[s]`` on. Its update matrix is formed in ``work``, which stays in the processor's
    cache, or where that is too small behind the panels. It waits for its parent, the lower triangle packed, on a stack
    that grows down from the end of ``values``, where no panel is yet: children are contiguous in postorder, so that a
    supernode finds theirs on top.
    """
    lower, no = address(letters), address(letters) + 1
    transposed, right = address(letters) + 2, address(letters) + 3
    p_width, p_height, p_below = (address(numbers), address(numbers) + 4, address(numbers) + 8)
    p_info, p_rest, p_columns = (address(numbers) + 12, address(numbers) + 16, address(numbers) + 20)
    p_one, p_minus, p_zero = (address(scalars), address(scalars) + 8, address(scalars) + 16)
    base, cached = address(values), address(work)
    count = len(parent)
    begins = np.empty(count, np.int64)  # of the updates on the stack
    waiting = np.empty(count, np.int64)
    runs, targets = np.empty(len(relative) + 1, np.int64), np.empty(len(relative), np.int64)
    depth, top = 0, len(values)
    for s in range(count):
        width, height = (first[s + 1] - first[s]) * block, (row_starts[s + 1] - row_starts[s]) * block
        below = height - width
        panel, behind = panels[first_panel[s]], panels[first_panel[s + 1]]
        values[panel:behind] = 0.0
        for e in range(entries[s], entries[s + 1]):
            values[places[e]] = data[sources[e]]
        small = below * below <= len(work)
        update = 0 if small else behind
        has_children = depth > 0 and parent[waiting[depth - 1]] == s
        if has_children:
            for j in range(below):
                begin = update + j * below
                if small:
                    work[begin + j : begin + below] = 0.0
                else:
                    values[begin + j : begin + below] = 0.0
        while depth > 0 and parent[waiting[depth - 1]] == s:
            depth -= 1
            child, source = waiting[depth], begins[depth]
            rows = row_starts[child] + first[child + 1] - first[child]
            size = (row_starts[child + 1] - rows) * block
            found = _runs(relative, rows, row_starts[child + 1], block, runs, targets)
            run = 0
            for j in range(size):
                run += j == runs[run + 1]
                column = targets[run] + j - runs[run]
                if column < width:
                    above = column // PANEL * PANEL
                    begin = panels[first_panel[s] + column // PANEL] + (column - above) * (height - above) - above
                    _add_column(values, source - j, j, run, found, runs, targets, values, begin)
                elif small:
                    begin = (column - width) * below - width
                    _add_column(values, source - j, j, run, found, runs, targets, work, begin)
                else:
                    begin = update + (column - width) * below - width
                    _add_column(values, source - j, j, run, found, runs, targets, values, begin)
                source += size - j
            top = source
        if width == 1:  # arithmetic that calls would cost more than
            if not values[panel] > 0.0:
                return int(first[s] * block)
            top -= below * (below + 1) // 2
            if small:
                _eliminate_one(values, panel, below, work, 0, has_children, top)
            else:
                _eliminate_one(values, panel, below, values, update, has_children, top)
            if below > 0:
                waiting[depth], begins[depth] = s, top
                depth += 1
            continue
        own = cached if small else base + 8 * update
        beta = p_one if has_children else p_zero
        for p in range(first_panel[s], first_panel[s + 1]):
            above = (p - first_panel[s]) * PANEL
            columns, rows = min(PANEL, width - above), height - above
            numbers[0], numbers[1], numbers[2], numbers[4] = columns, rows, below, rows - columns
            at = base + 8 * panels[p]
            under = at + 8 * columns
            call(addresses[POTRF], (lower, p_width, at, p_height, p_info))
            if numbers[3] != 0:
                return int(first[s] * block + above + numbers[3] - 1)
            if rows == columns:
                continue
            call(addresses[TRSM], (right, lower, transposed, no, p_rest, p_width, p_one, at, p_height, under, p_height))
            for q in range(p + 1, first_panel[s + 1]):
                numbers[4], numbers[5] = rows - (q - p) * PANEL, min(PANEL, width - above - (q - p) * PANEL)
                factors = (under, p_height, under, p_height, p_one, base + 8 * panels[q], p_rest)
                call(addresses[GEMM], (no, transposed, p_rest, p_columns, p_width, p_minus, *factors))
                under += 8 * PANEL
            if below > 0:
                under = at + 8 * (rows - below)
                call(addresses[SYRK], (lower, no, p_below, p_width, p_minus, under, p_height, beta, own, p_below))
                beta = p_one
        if below > 0:
            top -= below * (below + 1) // 2
            waiting[depth], begins[depth] = s, top
            depth += 1
            target = top
            for j in range(below):
                begin = update + j * below
                if small:
                    values[target : target + below - j] = work[begin + j : begin + below]
                else:
                    values[target : target + below - j] = values[begin + j : begin + below]
                target += below - j
    return -1


@njit
def _runs(relative: Index, begin: int, end: int, block: int, runs: Index, targets: Index) -> int:
    """Part rows of unknowns where those of the parent are not contiguous; returns the number of runs.

    ``runs`` receives where each begins, and the end of the last, ``targets`` the first row of each in the parent.
    """
    found = 0
    for e in range(begin, end):
        if e == begin or relative[e] != relative[e - 1] + 1:
            runs[found], targets[found] = (e - begin) * block, relative[e] * block
            found += 1
    runs[found] = (end - begin) * block
    return found


@njit
def _add_column(
    values: Array, source: int, j: int, run: int, found: int, runs: Index, targets: Index, out: Array, column: int
) -> None:
    """Add rows from ``j`` on of the column whose row 0 would be at ``values[source]`` to that at ``out[column]``."""
    begin = j
    for k in range(run, found):
        start, shift = np.uintp(source + begin), np.uintp(column + targets[k] + begin - runs[k])
        for i in range(np.uintp(runs[k + 1] - begin)):
            out[shift + i] += values[start + i]
        begin = runs[k + 1]


@njit
def _eliminate_one(
    values: Array, panel: int, below: int, work: Array, update: int, has_children: bool, top: int
) -> None:
    """Eliminate one unknown, and put its packed update at ``top``: what it adds to that of children in ``work``."""
    values[panel] = np.sqrt(values[panel])
    inverse = 1.0 / values[panel]
    column = np.uintp(panel + 1)
    for i in range(np.uintp(below)):
        values[column + i] *= inverse
    target = np.uintp(top)
    for j in range(below):
        size, under, entry = np.uintp(below - j), column + np.uintp(j), -values[panel + 1 + j]
        if has_children:
            own = np.uintp(update + j * below + j)
            for i in range(size):
                values[target + i] = work[own + i] + entry * values[under + i]
        else:
            for i in range(size):
                values[target + i] = 0.0 + entry * values[under + i]
        target += size


@njit
def solve(
    values: Array,
    panels: Panels,
    right_sides: Array,
    work: Array,
    numbers: Any,
    addresses: Index,
    letters: Any,
    scalars: Array,
) -> None:
    """Solve ``L L^T x = b`` in place for permuted right sides (r, N), each a row; ``work`` has room for (r, rows)."""
    block, first, row_starts, row_ends, rows, begins = panels
    lower, no = address(letters), address(letters) + 1
    transposed, left = address(letters) + 2, address(letters)
    p_width, p_height, p_below = (address(numbers), address(numbers) + 4, address(numbers) + 8)
    p_count, p_size, p_unit = (address(numbers) + 12, address(numbers) + 16, address(numbers) + 20)
    p_one, p_minus, p_zero = (address(scalars), address(scalars) + 8, address(scalars) + 16)
    count, size = right_sides.shape
    numbers[3], numbers[4], numbers[5] = count, size, 1
    base, x, w = address(values), address(right_sides), address(work)
    count_panels = len(first) - 1
    for s in range(count_panels):
        width, height = (first[s + 1] - first[s]) * block, (row_ends[s] - row_starts[s]) * block
        below = height - width
        numbers[0], numbers[1], numbers[2] = width, height, below
        at, own = base + 8 * begins[s], x + 8 * first[s] * block
        under = at + 8 * width
        if count == 1:
            call(addresses[TRSV], (lower, no, no, p_width, at, p_height, own, p_unit))
        else:
            call(addresses[TRSM], (left, lower, no, no, p_width, p_count, p_one, at, p_height, own, p_size))
        if below == 0:
            continue
        if count == 1:
            call(addresses[GEMV], (no, p_below, p_width, p_one, under, p_height, own, p_unit, p_zero, w, p_unit))
        else:
            call(
                addresses[GEMM],
                (no, no, p_below, p_count, p_width, p_one, under, p_height, own, p_size, p_zero, w, p_below),
            )
        entries = row_starts[s] + first[s + 1] - first[s]
        flat = work.reshape(-1)
        for r in range(count):
            for ib in range(below // block):
                row = rows[entries + ib] * block
                for di in range(block):
                    right_sides[r, row + di] -= flat[r * below + ib * block + di]
    for s in range(count_panels - 1, -1, -1):
        width, height = (first[s + 1] - first[s]) * block, (row_ends[s] - row_starts[s]) * block
        below = height - width
        numbers[0], numbers[1], numbers[2] = width, height, below
        at, own = base + 8 * begins[s], x + 8 * first[s] * block
        under = at + 8 * width
        if below > 0:
            entries = row_starts[s] + first[s + 1] - first[s]
            flat = work.reshape(-1)
            for r in range(count):
                for ib in range(below // block):
                    row = rows[entries + ib] * block
                    for di in range(block):
                        flat[r * below + ib * block + di] = right_sides[r, row + di]
            if count == 1:
                call(
                    addresses[GEMV],
                    (transposed, p_below, p_width, p_minus, under, p_height, w, p_unit, p_one, own, p_unit),
                )
            else:
                sizes = (transposed, no, p_width, p_count, p_below)
                call(addresses[GEMM], (*sizes, p_minus, under, p_height, w, p_below, p_one, own, p_size))
        if count == 1:
            call(addresses[TRSV], (lower, transposed, no, p_width, at, p_height, own, p_unit))
        else:
            call(addresses[TRSM], (left, lower, transposed, no, p_width, p_count, p_one, at, p_height, own, p_size))


@njit
def storage(first: Index, row_starts: Index, parent: Index, ends: Index, block: int) -> tuple[int, int]:
    """How many numbers :func:`factorise` needs for panels, updates and those that wait, and as ``work``.

    ``ends`` (s,) is where the panels of each supernode end.
    """
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
