"""Numeric multifrontal Cholesky factorisation and its triangular solves [duff1983; liu1992], compiled."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from modalshell.linalg.blas import GEMM, GEMV, POTRF, SYRK, TRSM, TRSV, address, call
from modalshell.typing import Array, Index


@numba.njit(cache=True)
def factorise(
    data: Array,
    places: Index,
    block: int,
    first: Index,
    row_starts: Index,
    relative: Index,
    parent: Index,
    panels: Index,
    values: Array,
    stack: Array,
    numbers: Any,
    addresses: Index,
    letters: Any,
    scalars: Array,
) -> int:
    """Factorise into ``values``; returns -1, or the first unknown, in elimination order, whose pivot is not positive.

    Each supernode's panel holds its columns of L, column-major. Its update matrix, lower triangle, waits on ``stack``
    for its parent: children are contiguous in postorder, so that a supernode finds theirs on top.
    """
    values[:] = 0.0
    for e in range(len(data)):
        if places[e] >= 0:
            values[places[e]] += data[e]
    lower, no = address(letters), address(letters) + 1
    transposed, right = address(letters) + 2, address(letters) + 3
    p_width, p_height, p_below = (address(numbers), address(numbers) + 4, address(numbers) + 8)
    p_info = address(numbers) + 12
    p_one, p_minus, p_zero = (address(scalars), address(scalars) + 8, address(scalars) + 16)
    base, stack_base = address(values), address(stack)
    count = len(parent)
    begins = np.empty(count, np.int64)  # of the updates on the stack
    waiting = np.empty(count, np.int64)
    depth, top = 0, 0
    for s in range(count):
        columns = first[s + 1] - first[s]
        width, height = columns * block, (row_starts[s + 1] - row_starts[s]) * block
        below = height - width
        panel = panels[s]
        update = top
        has_children = depth > 0 and parent[waiting[depth - 1]] == s
        if has_children:
            for j in range(below):
                stack[update + j * below + j : update + (j + 1) * below] = 0.0
        bottom = top
        while depth > 0 and parent[waiting[depth - 1]] == s:
            depth -= 1
            child, bottom = waiting[depth], begins[depth]
            entries = row_starts[child] + first[child + 1] - first[child]
            blocks = row_starts[child + 1] - entries
            size = blocks * block
            for jb in range(blocks):
                target = relative[entries + jb]
                for dj in range(block):
                    source = bottom + (jb * block + dj) * size
                    if target < columns:
                        into, column = values, panel + (target * block + dj) * height
                    else:
                        into, column = stack, update + ((target - columns) * block + dj) * below - width
                    for di in range(dj, block):
                        into[column + target * block + di] += stack[source + jb * block + di]
                    for ib in range(jb + 1, blocks):
                        row = column + relative[entries + ib] * block
                        for di in range(block):
                            into[row + di] += stack[source + ib * block + di]
        numbers[0], numbers[1], numbers[2] = width, height, below
        at = base + 8 * panel
        call(addresses[POTRF], (lower, p_width, at, p_height, p_info))
        if numbers[3] != 0:
            return int(first[s] * block + numbers[3] - 1)
        if below > 0:
            under, own = at + 8 * width, stack_base + 8 * update
            call(
                addresses[TRSM], (right, lower, transposed, no, p_below, p_width, p_one, at, p_height, under, p_height)
            )
            beta = p_one if has_children else p_zero
            call(addresses[SYRK], (lower, no, p_below, p_width, p_minus, under, p_height, beta, own, p_below))
            if bottom < update:  # over the children's updates, which are done with
                for k in range(below * below):
                    stack[bottom + k] = stack[update + k]
            waiting[depth], begins[depth] = s, bottom
            depth += 1
            top = bottom + below * below
        else:
            top = bottom
    return -1


@numba.njit(cache=True)
def solve(
    values: Array,
    block: int,
    first: Index,
    row_starts: Index,
    rows: Index,
    panels: Index,
    right_sides: Array,
    work: Array,
    numbers: Any,
    addresses: Index,
    letters: Any,
    scalars: Array,
) -> None:
    """Solve ``L L^T x = b`` in place for permuted right sides (r, N), each a row; ``work`` has room for (r, rows)."""
    lower, no = address(letters), address(letters) + 1
    transposed, left = address(letters) + 2, address(letters)
    p_width, p_height, p_below = (address(numbers), address(numbers) + 4, address(numbers) + 8)
    p_count, p_size, p_unit = (address(numbers) + 12, address(numbers) + 16, address(numbers) + 20)
    p_one, p_minus, p_zero = (address(scalars), address(scalars) + 8, address(scalars) + 16)
    count, size = right_sides.shape
    numbers[3], numbers[4], numbers[5] = count, size, 1
    base, x, w = address(values), address(right_sides), address(work)
    supernodes = len(first) - 1
    for s in range(supernodes):
        width, height = (first[s + 1] - first[s]) * block, (row_starts[s + 1] - row_starts[s]) * block
        below = height - width
        numbers[0], numbers[1], numbers[2] = width, height, below
        at, own = base + 8 * panels[s], x + 8 * first[s] * block
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
    for s in range(supernodes - 1, -1, -1):
        width, height = (first[s + 1] - first[s]) * block, (row_starts[s + 1] - row_starts[s]) * block
        below = height - width
        numbers[0], numbers[1], numbers[2] = width, height, below
        at, own = base + 8 * panels[s], x + 8 * first[s] * block
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


@numba.njit(cache=True)
def stack_size(first: Index, row_starts: Index, parent: Index, block: int) -> int:
    """Most numbers that updates take at a time on the stack of :func:`factorise`."""
    most, top, depth = 0, 0, 0
    begins = np.empty(len(parent), np.int64)
    waiting = np.empty(len(parent), np.int64)
    for s in range(len(parent)):
        below = (row_starts[s + 1] - row_starts[s] - (first[s + 1] - first[s])) * block
        most = max(most, top + below * below)
        bottom = top
        while depth > 0 and parent[waiting[depth - 1]] == s:
            depth -= 1
            bottom = begins[depth]
        if below > 0:
            waiting[depth], begins[depth] = s, bottom
            depth += 1
        top = bottom + below * below
    return most
