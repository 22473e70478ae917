"""The sparse pattern of the stiffness matrix, found once, with the place of every element block in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sps
from numpy.typing import NDArray

from modalshell.typing import Array, Index


@dataclass(frozen=True)
class SparsePattern:
    """CSR pattern of a symmetric matrix of 3 x 3 blocks, one block row a vertex.

    Attributes
    ----------
    indptr, indices : ndarray of int32
        CSR structure of the (3n, 3n) matrix, columns sorted.
    strides : ndarray of int64, shape (n,)
        Entries in a matrix row of each vertex.
    diagonal : ndarray of int64, shape (3n,)
        Where the diagonal entries stand.
    free_indptr, free_indices, free_entries : ndarray
        CSR structure of the part that belongs to the free unknowns, and where its entries stand in the whole.
    """

    indptr: NDArray[np.int32]
    indices: NDArray[np.int32]
    strides: Index
    diagonal: Index
    free_indptr: NDArray[np.int32]
    free_indices: NDArray[np.int32]
    free_entries: Index

    def matrix(self, data: Array) -> sps.csr_array:
        """Matrix (3n, 3n) with the entries ``data``."""
        size = self.indptr.size - 1
        return sps.csr_array((data, self.indices, self.indptr), shape=(size, size))

    def free_matrix(self, data: Array) -> sps.csc_array:
        """The free unknowns' part of the matrix; symmetric, so its CSR arrays are handed out as CSC."""
        size = self.free_indptr.size - 1
        return sps.csc_array((data[self.free_entries], self.free_indices, self.free_indptr), shape=(size, size))


def build_pattern(
    vertex_count: int, stencils: Sequence[Index], free_vertices: Index
) -> tuple[SparsePattern, list[Index]]:
    """Pattern that holds every pair of vertices in ``stencils``, and the slots of each stencil array.

    Parameters
    ----------
    vertex_count : int
        Number of vertices n.
    stencils : sequence of (elements, vertices) int arrays
        Vertices of each element.
    free_vertices : ndarray of int
        Vertices that are not held.

    Returns
    -------
    SparsePattern
        The pattern.
    list of ndarray of int64, shape (elements, vertices, vertices)
        For each pair of an element's vertices, where its 3 x 3 block begins in the CSR values.
    """
    keys = [np.arange(vertex_count, dtype=np.int64) * (vertex_count + 1)]
    for stencil in stencils:
        keys.append((stencil[:, :, None] * vertex_count + stencil[:, None, :]).ravel())
    unique = np.unique(np.concatenate(keys))
    block_rows, block_columns = np.divmod(unique, vertex_count)
    degrees = np.bincount(block_rows, minlength=vertex_count)
    block_starts = np.concatenate([[0], np.cumsum(degrees)])
    strides = (3 * degrees).astype(np.int64)

    indptr = np.concatenate([[0], np.cumsum(np.repeat(strides, 3))]).astype(np.int32)
    # Row 3v + i lists the columns 3c, 3c + 1, 3c + 2 of every neighbour c of v.
    row_columns = (3 * block_columns[:, None] + np.arange(3)).ravel()
    starts = 3 * block_starts
    rows = np.repeat(np.arange(vertex_count), 3)
    offsets = np.arange(indptr[-1], dtype=np.int64) - np.repeat(indptr[:-1].astype(np.int64), np.diff(indptr))
    indices = row_columns[np.repeat(starts[rows], np.diff(indptr)) + offsets].astype(np.int32)

    slots = []
    for stencil in stencils:
        pair_keys = stencil[:, :, None] * vertex_count + stencil[:, None, :]
        position = np.searchsorted(unique, pair_keys)
        row = np.broadcast_to(stencil[:, :, None], position.shape)
        slots.append(np.ascontiguousarray(9 * block_starts[row] + 3 * (position - block_starts[row])))

    free_unknowns = (3 * free_vertices[:, None] + np.arange(3)).ravel()
    numbers = sps.csr_array(
        (np.arange(1, indices.size + 1, dtype=np.int64), indices, indptr), shape=(3 * vertex_count, 3 * vertex_count)
    )
    part = numbers[free_unknowns][:, free_unknowns].tocsr()
    part.sort_indices()
    pattern = SparsePattern(
        indptr=indptr,
        indices=indices,
        strides=strides,
        diagonal=np.flatnonzero(indices == np.repeat(np.arange(indptr.size - 1), np.diff(indptr))),
        free_indptr=part.indptr.astype(np.int32),
        free_indices=part.indices.astype(np.int32),
        free_entries=part.data - 1,
    )
    return pattern, slots
