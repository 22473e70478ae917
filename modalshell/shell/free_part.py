"""Matrices of the free unknowns, and of the internal ones after them, out of the entries of a whole Hessian."""

from __future__ import annotations

import functools
from typing import Protocol, final

import numpy as np
import scipy.sparse as sps
from numpy.typing import NDArray

from modalshell.core.thread_safety import read_only
from modalshell.core.typing import Array, Mask
from modalshell.shell.kernels.patterns import free_values

_SMALL = 200_000
"""Entries of a whole Hessian up to which NumPy takes those of the free unknowns: a kernel takes a second to compile."""


class FreePart(Protocol):
    """The part of a sparsity pattern that belongs to the free unknowns."""

    def matrix(self, data: Array) -> sps.csc_array:
        """Its matrix with the entries ``data`` of the whole; symmetric, so its CSR arrays are handed out as CSC."""


@final
class VertexPart:
    """The free unknowns where vertices are free or held as a whole.

    Parameters
    ----------
    blocks : csr_array of bool, shape (n, n)
        Blocks of 3 x 3 entries.
    free : ndarray of bool, shape (n,)
        Vertices that are free.
    coupling : csr_array of bool, shape (m, n)
        Vertices that the internal unknowns are coupled to.
    own : csr_array, shape (m, m)
        Pattern of the internal unknowns among themselves.
    """

    def __init__(self, blocks: sps.csr_array, free: Mask, coupling: sps.csr_array, own: sps.csr_array) -> None:
        self._blocks, self._free, self._coupling, self._own = blocks, free, coupling, own
        places = np.arange(coupling.nnz, dtype=np.int32)
        meeting = sps.csc_array((places, coupling.indices, coupling.indptr), shape=coupling.shape[::-1]).tocsr()
        self._meeting = meeting.indptr, meeting.data

    @functools.cached_property
    def _structure(self) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Columns and row starts, made when first a matrix is wanted."""
        chosen = np.flatnonzero(self._free)
        blocks, wide = expanded(self._blocks[chosen][:, chosen]), expanded(self._coupling[:, chosen], (1, 3))
        own = sps.csr_array((np.ones(self._own.nnz, dtype=bool), self._own.indices, self._own.indptr), self._own.shape)
        above = sps.hstack([blocks, wide.T.tocsr()], format="csr")
        whole = sps.vstack([above, sps.hstack([wide, own], format="csr")], format="csr")
        return whole.indices, whole.indptr

    @functools.cached_property
    def _places(self) -> NDArray[np.int64]:
        """Where the values of the free unknowns' matrix stand among those of the whole, row by row."""
        chosen, blocks, coupling = np.flatnonzero(self._free), self._blocks, self._coupling
        ends = 9 * blocks.nnz, 9 * blocks.nnz + 3 * coupling.nnz
        lengths = np.diff(blocks.indptr).astype(np.int64)
        begins = np.repeat(6 * blocks.indptr[:-1].astype(np.int64), lengths) + 3 * np.arange(blocks.nnz)
        of_rows = np.repeat(3 * lengths, lengths)[:, None, None] * np.arange(3)[:, None] + np.arange(3)
        of_rows += begins[:, None, None]
        # Counted from 1, as zeros might be taken for entries that are not stored.
        square = sps.bsr_array((1 + of_rows, blocks.indices, blocks.indptr), shape=(3 * blocks.shape[0],) * 2)
        wide = np.arange(ends[0], ends[1]).reshape(-1, 1, 3)
        shape = coupling.shape[0], 3 * coupling.shape[1]
        coupled = sps.bsr_array((1 + wide, coupling.indices, coupling.indptr), shape=shape)
        unknowns = (3 * chosen[:, None] + np.arange(3)).ravel()
        numbers = 1 + ends[1] + np.arange(self._own.nnz)
        own = sps.csr_array((numbers, self._own.indices, self._own.indptr), self._own.shape)
        kept = coupled.tocsr()[:, unknowns]
        above = sps.hstack([square.tocsr()[unknowns][:, unknowns], kept.T.tocsr()], format="csr")
        whole = sps.vstack([above, sps.hstack([kept, own], format="csr")], format="csr")
        return read_only(np.asarray(whole.data, dtype=np.int64) - 1)

    def matrix(self, data: Array) -> sps.csc_array:
        """See :class:`FreePart`."""
        indices, indptr = self._structure
        if data.size <= _SMALL:
            return sps.csc_array((data[self._places], indices, indptr), shape=(indptr.size - 1,) * 2)
        values = np.empty(indices.size)
        blocks, coupling = self._blocks, self._coupling
        structure = blocks.indptr, blocks.indices, coupling.indptr, coupling.indices, *self._meeting, self._own.indptr
        free_values(data, self._free, *structure, values)
        return sps.csc_array((values, indices, indptr), shape=(indptr.size - 1,) * 2)


@final
class MappedPart:
    """The unknowns y of ``x = P y`` after those of the vertices, with an identity for the internal ones.

    Parameters
    ----------
    numbers : csr_array, shape (N, N)
        The whole matrix, internal unknowns after those of the vertices; its values are entries, counted from 1.
    matrix : csr_array, shape (3n, N)
        P.
    """

    def __init__(self, numbers: sps.csr_array, matrix: sps.csr_array) -> None:
        extra = numbers.shape[0] - matrix.shape[0]
        whole = sps.csr_array(sps.block_diag([matrix, sps.eye_array(extra)], format="csr") if extra else matrix)
        self._size, used = whole.shape[1], np.diff(whole.indptr).astype(np.int64)
        starts = whole.indptr.astype(np.int64)
        rows, columns = np.repeat(np.arange(whole.shape[0]), np.diff(numbers.indptr)), numbers.indices
        source = numbers.data.astype(np.int64) - 1
        # Each entry of K goes to every pair of the unknowns of its row and its column.
        pairs = used[rows] * used[columns]
        entry = np.repeat(np.arange(pairs.size), pairs)
        place = np.arange(entry.size) - np.repeat(np.cumsum(pairs) - pairs, pairs)
        first, second = np.divmod(place, used[columns][entry])
        first, second = starts[rows[entry]] + first, starts[columns[entry]] + second
        keys = whole.indices[first].astype(np.int64) * self._size + whole.indices[second]
        keys, slots = np.unique(keys, return_inverse=True)
        weights = whole.data[first] * whole.data[second]
        shape = (keys.size, int(source.max(initial=-1)) + 1)
        self._entries = sps.csr_array(sps.coo_array((weights, (slots, source[entry])), shape=shape))
        row, column = np.divmod(keys, self._size)
        self._indices = column.astype(np.int32)
        self._indptr = np.searchsorted(row, np.arange(self._size + 1)).astype(np.int32)

    def matrix(self, data: Array) -> sps.csc_array:
        """See :class:`FreePart`."""
        return sps.csc_array((self._entries @ data, self._indices, self._indptr), shape=(self._size, self._size))


def expanded(pattern: sps.csr_array, block: tuple[int, int] = (3, 3)) -> sps.csr_array:
    """CSR pattern of entries of one of blocks."""
    shape = pattern.shape[0] * block[0], pattern.shape[1] * block[1]
    ones = np.ones((pattern.nnz, *block), dtype=bool)
    return sps.csr_array(sps.bsr_array((ones, pattern.indices, pattern.indptr), shape=shape))
