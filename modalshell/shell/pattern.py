"""Sparsity pattern of the stiffness matrix, with the location of every element block."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sps
from numpy.typing import NDArray

from modalshell.core.short_repr import short_repr
from modalshell.core.typing import Array, Index
from modalshell.supports import Unknowns

_AT_A_TIME = 100_000
"""Elements whose blocks are looked up at a time."""
_DROPPED = 1e-15
"""Entries of a condensed Hessian that are left out, as a share of the largest."""


@dataclass(frozen=True)
class InternalUnknowns:
    """Unknowns without mass or load that an energy minimises over, such as fold shares; constant among themselves.

    Attributes
    ----------
    indptr, vertices : ndarray of int64
        CSR structure of their coupling to the vertices: one row per internal unknown, three entries per vertex.
    stiffness : csr_array, shape (m, m)
        Second derivatives by these unknowns, positive definite.
    solve : callable
        Solution of ``stiffness f = b`` for right sides (m,) or (m, k).
    """

    indptr: Index
    vertices: Index
    stiffness: sps.csr_array
    solve: Callable[[Array], Array]

    @property
    def count(self) -> int:
        """Number of internal unknowns m."""
        return self.indptr.size - 1

    @property
    def columns(self) -> Index:
        """Positions' unknowns that the entries of the coupling belong to."""
        return np.asarray((3 * self.vertices[:, None] + np.arange(3)).ravel())


@short_repr
@dataclass(frozen=True)
class SparsePattern:
    """CSR pattern of a symmetric matrix of 3 x 3 blocks, one block row per vertex.

    An energy with internal unknowns has the entries of their coupling, then of their own stiffness after those of the
    blocks; its Hessian by positions is the Schur complement, which is dense and is never formed: see :meth:`product`.

    Attributes
    ----------
    indptr, indices : ndarray of int32
        CSR structure of the (3n, 3n) matrix, columns sorted.
    strides : ndarray of int64, shape (n,)
        Entries in a matrix row of each vertex.
    diagonal : ndarray of int64, shape (3n,)
        Positions of the diagonal entries.
    free_indptr, free_indices : ndarray of int32
        CSR structure of the part that belongs to the free unknowns, and to the internal ones after them.
    free_entries : ndarray of bool or of int64, or csr_array
        Which entries of the whole matrix are its entries, or their positions; or the matrix that maps the whole's
        entries to them.
    internal : InternalUnknowns, optional
        Internal unknowns of the energy.
    """

    indptr: NDArray[np.int32]
    indices: NDArray[np.int32]
    strides: Index
    diagonal: Index
    free_indptr: NDArray[np.int32]
    free_indices: NDArray[np.int32]
    free_entries: Index | NDArray[np.bool_] | sps.csr_array
    internal: InternalUnknowns | None = None

    @property
    def size(self) -> int:
        """Number of entries of a Hessian."""
        inner = self.internal
        return self.indices.size + (0 if inner is None else 3 * inner.vertices.size + inner.stiffness.nnz)

    def matrix(self, data: Array) -> sps.csr_array:
        """Matrix (3n, 3n) of the blocks with the entries ``data``, internal unknowns left where they are."""
        size = self.indptr.size - 1
        return sps.csr_array((data[: self.indices.size], self.indices, self.indptr), shape=(size, size))

    def coupling(self, data: Array) -> sps.csr_array:
        """Coupling (m, 3n) of the internal unknowns, which must be there, to the positions."""
        inner = self.internal
        assert inner is not None
        values = data[self.indices.size : self.indices.size + 3 * inner.vertices.size]
        return sps.csr_array((values, inner.columns, 3 * inner.indptr), shape=(inner.count, self.indptr.size - 1))

    def product(self, data: Array, vectors: Array) -> Array:
        """Hessian by positions times vectors (3n,) or (3n, k), internal unknowns following at their minimum."""
        result = np.asarray(self.matrix(data) @ vectors)
        if self.internal is None or (scale := self._internal_scale(data)) == 0.0:
            return result
        coupling = self.coupling(data)
        return np.asarray(result - coupling.T @ self.internal.solve(coupling @ vectors) / scale)

    def internal_form(self, data: Array, vectors: Array) -> Array:
        """What internal unknowns at their minimum take (k, k) from the blocks' ``vectors^T H vectors``; (3n, k)."""
        if self.internal is None or (scale := self._internal_scale(data)) == 0.0:
            return np.zeros((vectors.shape[1], vectors.shape[1]))
        coupled = self.coupling(data) @ vectors
        return np.asarray(coupled.T @ self.internal.solve(coupled) / scale)

    def _internal_scale(self, data: Array) -> float:
        """The stiffness of the internal unknowns in ``data`` over their own; 0 if there is none."""
        inner = self.internal
        if inner is None or inner.count == 0:
            return 0.0
        return float(data[-inner.stiffness.nnz] / inner.stiffness.data[0])

    def condensed(self, data: Array) -> sps.csr_array:
        """Hessian by positions (3n, 3n): the Schur complement, less entries that are rounding.

        Far wider than the pattern, as every internal unknown follows its neighbours: entries fall off by about a factor
        of two an edge. For the solvers use :meth:`free_matrix` or :meth:`product`.
        """
        if self.internal is None or (scale := self._internal_scale(data)) == 0.0:
            matrix = self.matrix(data)
            matrix.indices, matrix.indptr = matrix.indices.copy(), matrix.indptr.copy()  # they are the pattern's own
            return matrix
        coupling = sps.csc_array(self.coupling(data))
        blocks = []
        least = _DROPPED * np.abs(data).max(initial=0.0)
        for start in range(0, coupling.shape[1], 300):
            columns = self.internal.solve(coupling[:, start : start + 300].toarray()) / scale
            columns[np.abs(columns) <= _DROPPED * np.abs(columns).max(initial=0.0)] = 0.0
            block = sps.csc_array(coupling.T @ sps.csc_array(columns))
            block.data[np.abs(block.data) <= least] = 0.0
            block.eliminate_zeros()
            blocks.append(block)
        schur = sps.csr_array(self.matrix(data) - sps.hstack(blocks, format="csr"))
        return sps.csr_array(0.5 * (schur + schur.T))

    def free_matrix(self, data: Array) -> sps.csc_array:
        """Part of the free unknowns and of the internal ones; symmetric, so its CSR arrays are handed out as CSC."""
        size, entries = self.free_indptr.size - 1, self.free_entries
        values = entries @ data if isinstance(entries, sps.csr_array) else data[entries]
        return sps.csc_array((values, self.free_indices, self.free_indptr), shape=(size, size))


def build_pattern(
    vertex_count: int, stencils: Sequence[Index], unknowns: Unknowns, internal: InternalUnknowns | None = None
) -> tuple[SparsePattern, list[Index]]:
    """Pattern that holds every pair of vertices in ``stencils``, and the slots of each stencil array.

    Parameters
    ----------
    vertex_count : int
        Number of vertices n.
    stencils : sequence of (elements, vertices) int arrays
        Vertices of each element; those outside the range 0 to n - 1 have no place in the matrix.
    unknowns : Unknowns
        What is free to move.
    internal : InternalUnknowns, optional
        Internal unknowns, which come after the vertices' ones.

    Returns
    -------
    SparsePattern
        The pattern.
    list of ndarray of int64, shape (elements, vertices, vertices)
        For each pair of an element's vertices, where its 3 x 3 block begins in the CSR values; -1 where it has none.
    """
    starts, columns = _blocks(vertex_count, stencils)
    degrees = np.diff(starts)
    strides = 3 * degrees.astype(np.int64)
    rows = np.repeat(np.arange(vertex_count, dtype=np.int32), degrees)
    free_entries: Index | NDArray[np.bool_] | sps.csr_array
    if unknowns.matrix is None and internal is None:
        free = np.zeros(3 * vertex_count, dtype=bool)
        free[unknowns.values(np.arange(3 * vertex_count))] = True
        kept = free[3 * rows] & free[3 * columns]
        whole = _expanded(starts, columns, kept)
        free_entries = whole.data
        number = np.cumsum(free[::3], dtype=np.int32) - 1
        before = np.concatenate([np.zeros(1, np.int32), np.cumsum(kept, dtype=np.int32)])[starts]
        part = _expanded(before[np.append(free[::3], True)], number[columns[kept]], kept[kept])
    else:
        whole = _expanded(starts, columns, np.ones(columns.size, dtype=bool))
        whole.data = np.arange(1, whole.nnz + 1, dtype=np.int64)
        numbers = whole if internal is None else _bordered(whole, internal)
        extra = 0 if internal is None else internal.count
        if unknowns.matrix is None:
            inner = 3 * vertex_count + np.arange(extra)
            free_unknowns = np.concatenate([unknowns.values(np.arange(3 * vertex_count)), inner])
            part = numbers[free_unknowns][:, free_unknowns].tocsr()
            part.sort_indices()
            free_entries = part.data - 1
        else:
            part, free_entries = _mapped(numbers, unknowns.matrix, extra)

    # A block begins at the entries of the rows before it, and after those of the blocks before it in its first row.
    begins = 6 * starts[rows].astype(np.int64) + 3 * np.arange(columns.size)
    positions = sps.csr_matrix((np.arange(columns.size, dtype=np.int32), columns, starts), (vertex_count, vertex_count))
    on_diagonal = begins[columns == rows]
    pattern = SparsePattern(
        indptr=whole.indptr,
        indices=whole.indices,
        strides=strides,
        diagonal=(on_diagonal[:, None] + np.arange(3) * (strides[:, None] + 1)).ravel(),
        free_indptr=part.indptr.astype(np.int32, copy=False),
        free_indices=part.indices.astype(np.int32, copy=False),
        free_entries=free_entries,
        internal=internal,
    )
    return pattern, [_slots(stencil, positions, begins) for stencil in stencils]


def _blocks(vertex_count: int, stencils: Sequence[Index]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Row starts and columns of all pairs of vertices that share an element, and of the diagonal."""
    pairs = sps.csr_array(sps.eye_array(vertex_count, dtype=bool, format="csr"))
    for stencil in stencils:
        inside = (stencil >= 0) & (stencil < vertex_count)
        ends = np.concatenate([[0], np.cumsum(inside.sum(axis=1))]).astype(np.int32)
        vertices = stencil[inside].astype(np.int32)
        shape = len(stencil), vertex_count
        elements = sps.csr_array((np.ones(vertices.size, dtype=bool), vertices, ends), shape=shape)
        pairs = sps.csr_array(pairs + elements.T.tocsr() @ elements)
    pairs.sort_indices()
    return pairs.indptr.astype(np.int32, copy=False), pairs.indices.astype(np.int32, copy=False)


def _expanded(starts: NDArray[np.int32], columns: NDArray[np.int32], values: NDArray[np.bool_]) -> sps.csr_array:
    """CSR matrix of 3 x 3 blocks, all entries of a block with one value."""
    size = 3 * (starts.size - 1)
    blocks = np.repeat(values, 9).reshape(-1, 3, 3)
    return sps.csr_array(sps.bsr_array((blocks, columns, starts), shape=(size, size)))


def _slots(stencil: Index, positions: sps.csr_matrix, begins: Index) -> Index:
    """Where the blocks of each element begin (elements, vertices, vertices), -1 if there is none."""
    count, width = stencil.shape
    slots = np.full((count, width, width), -1)
    for first in range(0, count, _AT_A_TIME):
        some = stencil[first : first + _AT_A_TIME]
        inside = (some >= 0) & (some < positions.shape[0])
        rows, columns = np.broadcast_arrays(some[:, :, None], some[:, None, :])
        both = inside[:, :, None] & inside[:, None, :]
        slots[first : first + _AT_A_TIME][both] = begins[positions[rows[both], columns[both]].A1]
    return slots


def _mapped(numbers: sps.csr_array, matrix: sps.csr_array, extra: int) -> tuple[sps.csr_array, sps.csr_array]:
    """Pattern of ``P^T K P``, P the matrix and an identity after it, and the matrix of its entries by those of K.

    Entries of K are those of ``numbers``, counted from 1.
    """
    whole = sps.csr_array(sps.block_diag([matrix, sps.eye_array(extra)], format="csr") if extra else matrix)
    size, starts, used = whole.shape[1], whole.indptr.astype(np.int64), np.diff(whole.indptr).astype(np.int64)
    rows, columns = np.repeat(np.arange(whole.shape[0]), np.diff(numbers.indptr)), numbers.indices
    # Each entry of K goes to every pair of the unknowns of its row and its column.
    pairs = used[rows] * used[columns]
    entry = np.repeat(np.arange(pairs.size), pairs)
    place = np.arange(entry.size) - np.repeat(np.cumsum(pairs) - pairs, pairs)
    first, second = np.divmod(place, used[columns][entry])
    first, second = starts[rows[entry]] + first, starts[columns[entry]] + second
    keys, slots = np.unique(whole.indices[first].astype(np.int64) * size + whole.indices[second], return_inverse=True)
    weights = whole.data[first] * whole.data[second]
    shape = (keys.size, int(numbers.data.max(initial=0)))
    entries = sps.csr_array(sps.coo_array((weights, (slots, numbers.data[entry] - 1)), shape=shape))
    row, column = np.divmod(keys, size)
    indptr = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=size))])
    return sps.csr_array((np.ones(keys.size), column, indptr), shape=(size, size)), entries


def _bordered(numbers: sps.csr_array, internal: InternalUnknowns) -> sps.csr_array:
    """Entry numbers, counted from 1, with rows and columns of the internal unknowns; both sides share their entries."""
    first = numbers.nnz + 1
    columns = internal.columns
    entries = np.arange(first, first + columns.size, dtype=np.int64)
    shape = (internal.count, numbers.shape[1])
    coupling = sps.csr_array((entries, columns, 3 * internal.indptr), shape=shape)
    first += columns.size
    stiffness = internal.stiffness
    entries = np.arange(first, first + stiffness.nnz, dtype=np.int64)
    own = sps.csr_array((entries, stiffness.indices, stiffness.indptr), shape=stiffness.shape)
    return sps.csr_array(sps.block_array([[numbers, coupling.T], [coupling, own]], format="csr"))
