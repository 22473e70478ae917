"""Sparse block Cholesky factorisation: one symbolic analysis per pattern, many factors.

The blocks are ordered, not the unknowns: a shell's vertices; see :mod:`modalshell.linalg.ordering`.
"""

from __future__ import annotations

import functools
from typing import final

import numpy as np
import scipy.sparse as sps
from threadpoolctl import ThreadpoolController

from modalshell.core.errors import SolverError
from modalshell.core.typing import Array, Index
from modalshell.kernels.packed import LANES
from modalshell.linalg import analysis, multifrontal
from modalshell.linalg.blas import BLAS, SINGLE_BLAS
from modalshell.linalg.conjugate_gradients import Preconditioner, Rows, Stop, solve_near
from modalshell.linalg.known_analyses import known_analysis
from modalshell.linalg.ordering import best_elimination, row_lists
from modalshell.linalg.panel_layout import laid_out
from modalshell.linalg.triangular_solves import solve

_PRODUCTS_A_READ = 0.043
"""Time of an operation of a factorisation over that of reading an entry of the factor twice, as a solve does."""


_NONE, _NO_FLIPS = np.empty((3, 0, 3)), np.empty(0, np.int64)
_FULL = 0.6
"""Share of entries that are not zero up to which :func:`without_zeros` leaves the others out."""
_ONE_BY_ONE = 2
"""Right sides up to which one after the other is faster than a register of them."""


@final
class NotPositiveDefiniteError(SolverError):
    """The matrix is not positive definite, as far as its rounded pivots tell.

    Attributes
    ----------
    unknown : int
        Unknown whose pivot is not positive.
    """

    def __init__(self, unknown: int, size: int) -> None:
        super().__init__(f"the matrix ({size} unknowns) is not positive definite: pivot {unknown} is not positive")
        self.unknown = unknown


@final
class CholeskyAnalysis:
    """Elimination order, supernodes and storage of a symmetric pattern (N, N), both of whose triangles are stored.

    Where a single factor is wanted (``once``), the best order is worth less.

    Attributes
    ----------
    block : int
        3 where the pattern consists of 3 x 3 blocks, else 1.
    entries, panels : int, Panels
        Stored numbers of a factor, and where they are.
    height : int
        Rows of the highest panel.
    solves_a_factorisation : float
        Solves that take the time of a factorisation, about: 8 at 2,500 vertices of a sheet, 13 at 10,000.
    """

    def __init__(self, matrix: sps.csc_array, *, once: bool = False) -> None:
        self.size = matrix.shape[0]
        self.block, graph = symmetric_block_graph(matrix)
        order, graph, tree, counts, products = best_elimination(graph, once=once)
        first = analysis.supernodes(tree, counts, self.block)
        row_starts, rows, parent = analysis.supernode_rows(*row_lists(graph), first, tree)
        relative = analysis.relative_rows(first, row_starts, rows, parent)
        # Panels: the first of each supernode, and of each panel its supernode, columns and rows.
        wide = multifrontal.PANEL // self.block
        first_panel = np.concatenate([[0], np.cumsum(-(-np.diff(first) // wide))])
        of = np.repeat(np.arange(parent.size), np.diff(first_panel))
        above = wide * (np.arange(of.size) - first_panel[of])
        columns = np.append(first[of] + above, first[-1])
        row_begins, row_ends = row_starts[of] + above, row_starts[of + 1]
        widths, heights = np.diff(columns) * self.block, (row_ends - row_begins) * self.block
        # A supernode's panels are laid out once all of them are factorised: the next one begins where they end then.
        finished = np.concatenate([[0], np.cumsum(laid_out(widths, heights))])
        by_columns = np.concatenate([[0], np.cumsum(widths * heights)])
        shifts = (finished - by_columns)[first_panel]
        panels, ends = by_columns[:-1] + shifts[of], by_columns[first_panel[1:]] + shifts[:-1]
        self.height = int(heights.max(initial=0))
        self.entries = int(finished[-1])
        self.solves_a_factorisation = _PRODUCTS_A_READ * products * self.block**3 / max(self.entries, 1)
        self._supernodes = multifrontal.Supernodes(
            self.block, first, row_starts, relative, parent, first_panel, panels, ends, finished[:-1]
        )
        self._buffer, size = multifrontal.storage(self._supernodes)
        self._storage = max(self._buffer + size, self.entries + 2 * LANES)
        self.order = (self.block * order[:, None] + np.arange(self.block)).ravel()
        pattern = matrix.indptr.astype(np.int64), matrix.indices.astype(np.int64)
        kind = np.int32 if self._storage < 2**31 else np.int64
        sources, places = np.empty((2, (matrix.nnz + self.size) // 2), kind)
        self.panels = analysis.Panels(self.block, columns, row_begins, row_ends, rows, finished[:-1])
        begins = analysis.entry_places(*pattern, order, self.panels._replace(begins=panels), sources, places)
        self._entries = multifrontal.Entries(sources, places, begins[first_panel])

    @classmethod
    def known(cls, matrix: sps.csc_array, *, once: bool = False) -> CholeskyAnalysis:
        """The analysis of the pattern of ``matrix``, that of an earlier matrix where one had the same."""
        return known_analysis(f"cholesky, once: {once}", matrix, lambda: cls(matrix, once=once))

    def factorise(self, matrix: sps.csc_array, *, single: bool = False, signed: bool = False) -> BlockCholesky:
        """Factor of a matrix with this pattern; NotPositiveDefiniteError where a pivot is not positive.

        A factor in ``single`` precision takes half the memory and about half the time. A ``signed`` one takes pivots
        in their order whatever their sign, as profile factors do; NotPositiveDefiniteError where one is zero.
        """
        values, sizes = np.empty(self._storage, np.float32 if single else np.float64), np.empty(7, np.int32)
        signs = np.ones(self.size if signed else 0)
        with _blas().limit(limits=1, user_api="blas"):
            wrong = multifrontal.factorise(
                matrix.data,
                self._entries,
                self._supernodes,
                values,
                self._buffer,
                sizes,
                signs,
                SINGLE_BLAS if single else BLAS,
            )
        if wrong >= 0:
            raise NotPositiveDefiniteError(int(self.order[wrong]), self.size)
        values.resize(self.entries + 2 * LANES, refcheck=False)  # no more room for updates
        values[self.entries :] = 0.0  # solves read them
        return BlockCholesky(self, values, np.flatnonzero(signs < 0.0) if signed else _NO_FLIPS)


@final
class BlockCholesky:
    """A factor ``A = P^T L S L^T P``; S is the identity but for -1 at the ``negative`` pivots below zero.

    There are as many of these as negative eigenvalues. ``solves_a_factorisation`` is that of the analysis, which is not
    kept: the places of a matrix's entries in it take nearly a tenth of the factor's memory.
    """

    def __init__(self, analysis: CholeskyAnalysis, values: Array, flips: Index) -> None:
        self.solves_a_factorisation = analysis.solves_a_factorisation
        self._panels, self._order, self._height = analysis.panels, analysis.order, analysis.height
        self._values, self._flips = values, flips
        self.negative = flips.size

    def solve(self, right_side: Array) -> Array:
        """Solution of ``A x = right_side`` for (N,) or (N, r) right sides."""
        right_side, order, values = np.asarray(right_side), self._order, self._values
        columns = right_side[:, None] if right_side.ndim == 1 else right_side
        solution = np.empty(columns.shape)
        lanes = LANES * 8 // values.itemsize
        start, work = 0, np.zeros((self._height + 1) * lanes, values.dtype)
        permuted = np.zeros((order.size, lanes if columns.shape[1] > _ONE_BY_ONE else 1), values.dtype)
        while start < columns.shape[1]:
            sides = lanes if columns.shape[1] - start > _ONE_BY_ONE else 1
            if sides != permuted.shape[1]:
                permuted = np.zeros((order.size, sides), values.dtype)
            some = columns[order, start : start + sides]
            permuted[:, : some.shape[1]] = some
            solve(values, self._panels, permuted.reshape(-1), sides, work, self._flips)
            solution[order, start : start + sides] = permuted[:, : some.shape[1]]
            start += sides
        return solution.reshape(right_side.shape)

    def solve_near(
        self, matrix: sps.csc_array, right_side: Array, stop: Stop, axes: Array | None = None
    ) -> tuple[Array, int, bool]:
        """Solution (N,) for another symmetric matrix, the solves it took, and whether it meets the accuracy.

        See :func:`modalshell.linalg.conjugate_gradients.solve_near`.
        """
        rows, turned = Rows(matrix.indptr, matrix.indices, matrix.data), _NONE if axes is None else axes
        factor = Preconditioner(self._values, self._panels, self._order, self._height, self._flips, turned)
        found, iterations, served = solve_near(factor, rows, right_side, stop)
        return found, int(iterations), bool(served)


@functools.cache
def _blas() -> ThreadpoolController:
    """The BLAS in this process: held to one thread, whose sums do not depend on how many there are."""
    return ThreadpoolController()


def block_graph(matrix: sps.csc_array) -> tuple[int, sps.csr_array]:
    """Block size, 3 or 1, and the graph of the blocks."""
    block, rows, starts = 1, matrix.indices.copy(), matrix.indptr  # a copy: sorted without their entries below
    if matrix.shape[0] % 3 == 0 and matrix.nnz % 9 == 0:
        blocks = sps.csr_array((np.ones(rows.size, bool), rows, starts), matrix.shape).tobsr((3, 3))
        if blocks.nnz == matrix.nnz:
            block, rows, starts = 3, blocks.indices, blocks.indptr
    size = matrix.shape[0] // block
    graph = sps.csr_array((np.ones(rows.size, dtype=np.int32), rows, starts), shape=(size, size))
    graph.sort_indices()
    return block, graph


def symmetric_block_graph(matrix: sps.csc_array) -> tuple[int, sps.csr_array]:
    """:func:`block_graph` of a matrix whose pattern is symmetric; ValueError for any other."""
    if matrix.shape[0] != matrix.shape[1]:
        raise ValueError(f"the matrix must be square (got {matrix.shape[0]} rows and {matrix.shape[1]} columns)")
    block, graph = block_graph(matrix)
    other = sps.coo_array(graph - graph.T)  # of numbers of entries, all alike
    if other.data.any():
        wrong = block * int(other.row[other.data != 0].min())
        raise ValueError(
            f"the matrix must store both triangles of a symmetric pattern (got other entries in row {wrong} "
            f"than in column {wrong})"
        )
    return block, graph


def without_zeros(matrix: sps.csc_array) -> sps.csc_array:
    """A symmetric matrix without its stored zeros where these are many; itself where they are few.

    Flat sheets along the axes have them, as their bending meets no force in their plane: two of three entries are zero.
    """
    if np.count_nonzero(matrix.data) > _FULL * matrix.nnz:
        return matrix
    other = sps.csc_array(matrix.T)
    other.sort_indices()
    if not (matrix.has_sorted_indices and np.array_equal(matrix.indices, other.indices)):
        return matrix
    kept = np.flatnonzero((matrix.data != 0.0) | (other.data != 0.0))
    starts = np.searchsorted(kept, matrix.indptr).astype(matrix.indptr.dtype)
    return sps.csc_array((matrix.data[kept], matrix.indices[kept], starts), shape=matrix.shape)
