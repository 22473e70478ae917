"""Sparsity pattern of the stiffness matrix, with the location of every element block."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sps
from numpy.typing import NDArray

from modalshell.core.short_repr import short_repr
from modalshell.core.typing import Array, Index
from modalshell.shell.free_part import FreePart, MappedPart, VertexPart, expanded
from modalshell.shell.kernels.patterns import find_blocks
from modalshell.supports import Unknowns

_DROPPED = 1e-15
"""Entries of a condensed Hessian that are left out, as a share of the largest."""


@dataclass(frozen=True)
class InternalUnknowns:
    """Unknowns without mass or load that an energy minimises over, such as fold shares; constant among themselves."""

    vertices: sps.csr_array
    """Vertices that each is coupled to, by three entries; shape (m, n)."""
    stiffness: sps.csr_array
    """Second derivatives by these unknowns, positive definite; shape (m, m)."""
    solve: Callable[[Array], Array]
    """Solution of ``stiffness f = b`` for right sides (m,) or (m, k)."""

    @property
    def count(self) -> int:
        """Number of internal unknowns m."""
        return int(self.vertices.shape[0])

    @property
    def entries(self) -> int:
        """Number of entries of their coupling, and of their own stiffness."""
        return int(3 * self.vertices.nnz + self.stiffness.nnz)


@short_repr
@dataclass(frozen=True)
class SparsePattern:
    """CSR pattern of a symmetric matrix of 3 x 3 blocks, one block row per vertex.

    An energy with internal unknowns has the entries of their coupling, then of their own stiffness after those of the
    blocks; its Hessian by positions is the Schur complement, which is dense and is never formed: see :meth:`product`.
    """

    blocks: sps.csr_array
    """Which vertices (n, n) share a block, columns sorted."""
    strides: Index
    """Entries in a matrix row of each vertex; shape (n,)."""
    diagonal: Index
    """Positions of the diagonal entries; shape (3n,)."""
    free: FreePart
    """What belongs to the free unknowns, and to the internal ones after them."""
    internal: InternalUnknowns | None = None
    """Internal unknowns of the energy."""

    @property
    def block_size(self) -> int:
        """Number of entries of the blocks: of a Hessian without what belongs to internal unknowns."""
        return 9 * int(self.blocks.nnz)

    @property
    def internal_count(self) -> int:
        """Number of internal unknowns."""
        return 0 if self.internal is None else self.internal.count

    @property
    def size(self) -> int:
        """Number of entries of a Hessian."""
        return self.block_size + (0 if self.internal is None else self.internal.entries)

    @functools.cached_property
    def structure(self) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """CSR columns, sorted, and row starts of the (3n, 3n) matrix: long lists, made when first a matrix is wanted.

        Implicit steps and statics want :meth:`free_matrix` alone.
        """
        whole = expanded(self.blocks)
        return whole.indices, whole.indptr

    def matrix(self, data: Array) -> sps.csr_array:
        """Matrix (3n, 3n) of the blocks with the entries ``data``, internal unknowns left where they are."""
        return sps.csr_array((data[: self.block_size], *self.structure), shape=(3 * len(self.strides),) * 2)

    def coupling(self, data: Array) -> sps.csr_array:
        """Coupling (m, 3n) of the internal unknowns, which must be there, to the positions."""
        inner = self.internal
        assert inner is not None
        pattern = expanded(inner.vertices, (1, 3))
        values = data[self.block_size : self.block_size + pattern.nnz]
        return sps.csr_array((values, pattern.indices, pattern.indptr), shape=pattern.shape)

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
        if inner is None or not inner.count:
            return 0.0
        return float(data[-inner.stiffness.nnz] / inner.stiffness.data[0])

    def block_diagonal(self, blocks: Array) -> Array:
        """Entries of a Hessian with symmetric parts of ``blocks`` (n, 3, 3) on its diagonal, one for each vertex."""
        data, axis = np.zeros(self.size), np.arange(3)
        data[self.diagonal.reshape(-1, 3, 1) + axis - axis[:, None]] = 0.5 * (blocks + blocks.transpose(0, 2, 1))
        return data

    def condensed(self, data: Array) -> sps.csr_array:
        """Hessian by positions (3n, 3n): the Schur complement, less entries that are rounding.

        Far wider than the pattern, as every internal unknown follows its neighbours: entries fall off by about a factor
        of two an edge. For the solvers use :meth:`free_matrix` or :meth:`product`.
        """
        if self.internal is None or (scale := self._internal_scale(data)) == 0.0:
            matrix = self.matrix(data)
            matrix.indices, matrix.indptr = matrix.indices.copy(), matrix.indptr.copy()  # they are the pattern's own
            return matrix
        coupling = self.coupling(data)
        by_column, blocks = sps.csc_array(coupling), []
        least = _DROPPED * np.abs(data).max(initial=0.0)
        for start in range(0, coupling.shape[1], 300):
            columns = self.internal.solve(by_column[:, start : start + 300].toarray()) / scale
            near = np.flatnonzero(columns.any(axis=1))  # a block of columns reaches some edges far
            columns = columns[near]
            columns[np.abs(columns) <= _DROPPED * np.abs(columns).max(initial=0.0)] = 0.0
            block = sps.csc_array(coupling[near].T @ sps.csc_array(columns))
            block.data[np.abs(block.data) <= least] = 0.0
            block.eliminate_zeros()
            blocks.append(block)
        schur = sps.csr_array(self.matrix(data) - sps.hstack(blocks, format="csr"))
        return sps.csr_array(0.5 * (schur + schur.T))

    def free_matrix(self, data: Array) -> sps.csc_array:
        """Part of the free unknowns and of the internal ones; symmetric, so its CSR arrays are handed out as CSC."""
        return self.free.matrix(data)


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
    list of ndarray of int32, shape (elements, vertices, vertices)
        For each pair of an element's vertices, where its 3 x 3 block begins in the CSR values; -1 where it has none.
        Those of patterns beyond the range of int32 are int64.
    """
    blocks, slots = _blocks(vertex_count, stencils, 0 if internal is None else internal.entries)
    strides = 3 * np.diff(blocks.indptr).astype(np.int64)
    rows = np.repeat(np.arange(vertex_count, dtype=np.int32), np.diff(blocks.indptr))
    # A block begins at the entries of the rows before it, and after those of the blocks before it in its first row.
    own = np.flatnonzero(blocks.indices == rows)
    on_diagonal = 6 * blocks.indptr[:-1].astype(np.int64) + 3 * own
    if internal is None:
        coupling, among = sps.csr_array((0, vertex_count), dtype=bool), sps.csr_array((0, 0), dtype=bool)
    else:
        coupling, among = internal.vertices, internal.stiffness
    free: FreePart = VertexPart(blocks, ~unknowns.held, coupling, among)
    if unknowns.matrix is not None:
        every = VertexPart(blocks, np.ones(vertex_count, dtype=bool), coupling, among)
        entries = np.arange(1.0, 9 * blocks.nnz + 3 * coupling.nnz + among.nnz + 1)
        free = MappedPart(every.matrix(entries).T, unknowns.matrix)
    pattern = SparsePattern(
        blocks=blocks,
        strides=strides,
        diagonal=(on_diagonal[:, None] + np.arange(3) * (strides[:, None] + 1)).ravel(),
        free=free,
        internal=internal,
    )
    return pattern, slots


def incidence(stencil: Index, count: int) -> sps.csr_array:
    """Which of ``count`` members (elements, count) each element has; members out of range are nobody's."""
    inside = (stencil >= 0) & (stencil < count)
    ends = np.concatenate([[0], np.cumsum(inside.sum(axis=1))]).astype(np.int32)
    members = stencil[inside].astype(np.int32)
    return sps.csr_array((np.ones(members.size, dtype=bool), members, ends), shape=(len(stencil), count))


def block_slots(rows: Index, columns: Index, blocks: sps.csr_array, lead: int, shift: int, size: int) -> Index:
    """Slots (elements, r, c), among ``size`` entries, of the elements' rows and columns; see :func:`find_blocks`.

    They are int32 where that is enough.
    """
    return _found_blocks(rows, columns, blocks, lead, shift, size)[0]


def _found_blocks(
    rows: Index, columns: Index, blocks: sps.csr_array, lead: int, shift: int, size: int
) -> tuple[Index, int]:
    """:func:`block_slots`, and how many pairs a square pattern lacks."""
    kind: Any = np.int32 if size < 2**31 else np.int64
    slots: Index = np.empty((*rows.shape, columns.shape[1]), kind)
    # A read-only one compiles it again.
    rows, columns = (np.require(a, requirements=("C", "W")) for a in (rows, columns))
    return slots, find_blocks(rows, columns, blocks.indptr, blocks.indices, lead, shift, slots)


def _blocks(vertex_count: int, stencils: Sequence[Index], inner: int) -> tuple[sps.csr_array, list[Index]]:
    """All pairs of vertices that share an element, and the diagonal; slots, with ``inner`` entries after the blocks.

    The stencils with most pairs mostly hold those of the others, so only elements that lack one are added.
    """
    nobody = np.empty((0, 1), dtype=np.int64)
    blocks = _pairs(vertex_count, max(stencils, key=lambda own: own.size * own.shape[1], default=nobody))
    added = [np.flatnonzero(np.diff(blocks.indptr) == 0)[:, None]]
    slots = []
    for stencil in stencils:
        own, lacking = _found_blocks(stencil, stencil, blocks, 6, 0, 9 * blocks.nnz + inner)
        slots.append(own)
        added += [_incomplete(stencil, own, vertex_count)] if lacking else []
    if added := [elements for elements in added if len(elements)]:
        blocks = sps.csr_array(sum((_pairs(vertex_count, elements) for elements in added), blocks))
        blocks.sort_indices()
        slots = [block_slots(stencil, stencil, blocks, 6, 0, 9 * blocks.nnz + inner) for stencil in stencils]
    return blocks, slots


def _pairs(vertex_count: int, stencil: Index) -> sps.csr_array:
    """Vertices (n, n) that share an element of one stencil, columns sorted."""
    elements = incidence(stencil, vertex_count)
    pairs = sps.csr_array(elements.T.tocsr() @ elements)
    pairs.sort_indices()
    return pairs


def _incomplete(stencil: Index, slots: Index, vertex_count: int) -> Index:
    """Elements of a stencil that have no slot for a pair of their vertices."""
    there = (stencil >= 0) & (stencil < vertex_count)
    absent = (slots < 0) & there[:, :, None] & there[:, None, :]
    return stencil[absent.any(axis=(1, 2))]
