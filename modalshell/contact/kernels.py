"""Compiled: turns of vertices' unknowns and prescribed ones in a Hessian, on its own pattern."""

from modalshell.kernels.compiler import njit


@njit(fastmath=False)
def _place(indices, begin, end, row):  # type: ignore[no-untyped-def]
    """Where ``row`` stands among sorted indices."""
    while begin < end:
        middle = (begin + end) // 2
        if indices[middle] < row:
            begin = middle + 1
        else:
            end = middle
    return begin


@njit(fastmath=False)
def turn(indptr, indices, data, starts, sizes, frames):  # type: ignore[no-untyped-def]
    """Replace a matrix by ``Q^T H Q``, Q the ``frames`` (k, 3, 3) of the unknowns from ``starts`` on.

    The unknowns of a vertex have one pattern, as the Hessian has whole blocks.
    """
    for v in range(starts.size):
        j, size = starts[v], sizes[v]
        entries = indptr[j + 1] - indptr[j]
        for half in range(2):
            for p in range(indptr[j], indptr[j + 1]):
                if half == 0:  # columns of the vertex
                    first, step = p, entries
                else:  # its rows, in the columns that meet it: those of its own pattern
                    column = indices[p]
                    first, step = _place(indices, indptr[column], indptr[column + 1], j), 1
                a = data[first]
                b = data[first + step] if size > 1 else 0.0
                c = data[first + 2 * step] if size > 2 else 0.0
                for k in range(size):
                    data[first + k * step] = a * frames[v, 0, k] + b * frames[v, 1, k] + c * frames[v, 2, k]


@njit(fastmath=False)
def add_blocks(indptr, indices, data, starts, sizes, blocks):  # type: ignore[no-untyped-def]
    """Add ``blocks`` (k, 3, 3) to the diagonal blocks of the unknowns from ``starts`` on."""
    for v in range(starts.size):
        j = starts[v]
        for column in range(sizes[v]):
            first = _place(indices, indptr[j + column], indptr[j + column + 1], j)
            for row in range(sizes[v]):
                data[first + row] += blocks[v, row, column]


@njit(fastmath=False)
def prescribe(indptr, indices, data, unknowns, values, diagonal, right_side):  # type: ignore[no-untyped-def]
    """Prescribe the ``values`` of unknowns: their rows and columns become those of ``diagonal`` times the identity."""
    for u in range(unknowns.size):
        j = unknowns[u]
        for p in range(indptr[j], indptr[j + 1]):
            row = indices[p]
            right_side[row] -= data[p] * values[u]
            data[p] = 0.0
            data[_place(indices, indptr[row], indptr[row + 1], j)] = 0.0
        data[_place(indices, indptr[j], indptr[j + 1], j)] = diagonal
    for u in range(unknowns.size):
        right_side[unknowns[u]] = diagonal * values[u]
