"""Sparse factorisation of symmetric matrices: one place that takes the best back end present and says which.

SuperLU comes with SciPy and needs no dependency. CHOLMOD (scikit-sparse) solves fastest with one factor, PARDISO
(pypardiso) factorises fastest again and again on one pattern; both take positive definite matrices only, as used here.
"""

from __future__ import annotations

import ctypes
import functools
import importlib.util
import threading
import weakref
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import scipy.sparse as sps
import scipy.sparse.linalg as spla
from numpy.typing import NDArray

from modalshell.errors import OptionError, SolverError
from modalshell.typing import Array
from modalshell.work import count_factorisation, count_solves

Use = Literal["solve", "refactor"]
"""Whether one factor serves many solves, or one pattern many factors."""


class Factor(ABC):
    """A factorised symmetric matrix.

    Attributes
    ----------
    backend : str
        Name of the library that holds the factor.
    """

    backend: str

    def solve(self, right_side: Array) -> Array:
        """Solution of ``A x = right_side`` for (N,) or (N, k) right sides."""
        count_solves(len(right_side), right_side.size // max(len(right_side), 1))
        return self._solve(right_side)

    @abstractmethod
    def _solve(self, right_side: Array) -> Array: ...

    def is_definite(self) -> bool:
        """Whether A is positive definite, by the signs of its pivots; Cholesky factors exist for no other."""
        return True


@dataclass(frozen=True)
class _Ordering:
    """SuperLU's order of one pattern: the permuted pattern, and which entry of the matrix goes where in it.

    Found before the first matrix, so that this is factorised to the same bits as every later one with its entries.
    """

    order: NDArray[np.int64]
    permuted: sps.csc_array

    @classmethod
    def of(cls, matrix: sps.csc_array) -> _Ordering:
        size = _block_size(matrix)
        blocks = sps.csc_matrix(sps.csc_array((np.ones(matrix.nnz), matrix.indices, matrix.indptr), matrix.shape))
        graph = sps.csc_matrix(blocks[::size, ::size])
        degrees = np.diff(graph.indptr).astype(np.float64)
        definite = sps.csc_matrix(sps.diags(2.0 * degrees + 1.0, format="csc") - graph)
        first = size * np.argsort(_symmetric_lu(definite, "MMD_AT_PLUS_A").perm_c)
        order = (first[:, None] + np.arange(size)).ravel()
        numbers = sps.csc_array((np.arange(1, matrix.data.size + 1), matrix.indices, matrix.indptr), matrix.shape)
        permuted = sps.csc_array(numbers[order][:, order])
        permuted.sort_indices()  # now: SuperLU would sort the shared indices in place, and leave the numbers behind
        return cls(order, permuted)

    def apply(self, matrix: sps.csc_array) -> sps.csc_matrix:
        pattern = self.permuted
        return sps.csc_matrix((matrix.data[pattern.data - 1], pattern.indices, pattern.indptr), shape=matrix.shape)


def _block_size(matrix: sps.csc_array) -> int:
    """3 where the pattern consists of 3 x 3 blocks, as a shell's does: the order of its vertices is found faster."""
    if matrix.shape[0] % 3 or matrix.nnz % 9:
        return 1
    columns = np.repeat(np.arange(matrix.shape[1]), np.diff(matrix.indptr))
    blocks = np.unique(matrix.indices // 3 + (columns // 3) * (matrix.shape[0] // 3))
    return 3 if 9 * blocks.size == matrix.nnz else 1


def _symmetric_lu(matrix: sps.csc_matrix, order: Literal["MMD_AT_PLUS_A", "NATURAL"]) -> Any:
    return spla.splu(matrix, permc_spec=order, diag_pivot_thresh=0.0, options={"SymmetricMode": True})


class _SuperLU(Factor):
    """SciPy's SuperLU in symmetric mode: minimum-degree order of A + A^T, found once a pattern, and diagonal pivots."""

    backend = "superlu"

    def __init__(self, matrix: sps.csc_array, ordering: _Ordering | None = None) -> None:
        try:
            if ordering is None:
                self._factor = _symmetric_lu(sps.csc_matrix(matrix), "MMD_AT_PLUS_A")
            else:
                self._factor = _symmetric_lu(ordering.apply(matrix), "NATURAL")
        except RuntimeError as error:
            raise SolverError(f"the matrix ({matrix.shape[0]} unknowns) is singular: {error}") from error
        self._order = None if ordering is None else ordering.order

    def _solve(self, right_side: Array) -> Array:
        if self._order is None:
            return np.asarray(self._factor.solve(np.ascontiguousarray(right_side)))
        solution = np.empty_like(right_side)
        solution[self._order] = self._factor.solve(np.ascontiguousarray(right_side[self._order]))
        return solution

    def is_definite(self) -> bool:
        # Off the diagonal pivots are taken only where the diagonal one vanishes, as it cannot in a definite matrix.
        in_place = np.array_equal(self._factor.perm_r, self._factor.perm_c)
        return bool(in_place and (self._factor.U.diagonal() > 0.0).all())


@functools.cache
def _openmp() -> list[ctypes.CDLL]:
    from threadpoolctl import threadpool_info

    return [ctypes.CDLL(library["filepath"]) for library in threadpool_info() if library["user_api"] == "openmp"]


@contextmanager
def _one_thread() -> Iterator[None]:
    """Keep OpenMP to one thread: CHOLMOD asks for four by number, which only the depth of nesting can refuse."""
    before = [(library, library.omp_get_max_active_levels()) for library in _openmp()]
    for library, _ in before:
        library.omp_set_max_active_levels(0)
    try:
        yield
    finally:
        for library, levels in before:
            library.omp_set_max_active_levels(levels)


_DISSECT_FROM = 120_000
"""Unknowns from which nested dissection, slower to find than a minimum-degree order, pays by its smaller factor."""


class _Cholmod(Factor):
    """CHOLMOD, supernodal, on one thread: its own threads cost more than they bring at the sizes of shells."""

    backend = "cholmod"

    def __init__(self, matrix: sps.csc_array, analysis: Any = None) -> None:
        from sksparse import cholmod

        whole = sps.csc_matrix(matrix)
        try:
            # Analysing and factorising apart: cholesky() in one call is simplicial, 2.5 times slower here.
            with _one_thread():
                if analysis is None:
                    ordering = "amd" if matrix.shape[0] < _DISSECT_FROM else "nesdis"
                    analysis = cholmod.analyze(whole, mode="supernodal", ordering_method=ordering)
                self.analysis = analysis
                self._factor = self.analysis.cholesky(whole)
        except cholmod.CholmodError as error:
            raise SolverError(f"the matrix ({matrix.shape[0]} unknowns) is not positive definite: {error}") from error

    def _solve(self, right_side: Array) -> Array:
        with _one_thread():
            return np.asarray(self._factor(right_side))


class _PardisoAnalysis:
    """A PARDISO instance with its symbolic factorisation; it holds one numeric factor at a time."""

    def __init__(self) -> None:
        import pypardiso

        self.solver: Any = pypardiso.PyPardisoSolver(mtype=2)
        # Matrices of shells are small for threads: on a shared machine two ran five to a hundred times slower than one.
        self.solver.libmkl.MKL_Set_Num_Threads(1)
        # A finalizer and no __del__: at the interpreter's end there is nothing left to free with.
        weakref.finalize(self, self.solver.free_memory, everything=True).atexit = False
        self.error: type[Exception] = pypardiso.pardiso_wrapper.PyPardisoError
        self.owner: object = None
        self.phase = 12
        self.lower: sps.csc_array | None = None

    def run(self, phase: int, upper: sps.csr_matrix, right_side: Array) -> Array:
        """Call PARDISO itself: the wrapper's own solve() compares whole matrices before each call."""
        self.solver.set_phase(phase)
        return np.asarray(self.solver._call_pardiso(upper, right_side))


class _Pardiso(Factor):
    """Intel MKL PARDISO on the upper triangle; the analysis of a pattern is kept for the next matrix."""

    backend = "pardiso"

    def __init__(self, matrix: sps.csc_array, analysis: Any = None) -> None:
        self.analysis: _PardisoAnalysis = _PardisoAnalysis() if analysis is None else analysis
        lower = self.analysis.lower
        if lower is None:
            entries = np.arange(1, matrix.data.size + 1)
            numbered = sps.csc_array((entries, matrix.indices, matrix.indptr), shape=matrix.shape)
            lower = self.analysis.lower = sps.csc_array(sps.tril(numbered, format="csc"))
            lower.sort_indices()
        # The lower triangle by columns is the upper triangle by rows.
        self._upper = sps.csr_matrix((matrix.data[lower.data - 1], lower.indices, lower.indptr), shape=matrix.shape)
        self._zero = np.zeros((matrix.shape[0], 1), order="F")
        self.analysis.owner = self
        try:
            self.analysis.run(self.analysis.phase, self._upper, self._zero)
            self.analysis.phase = 22
        except self.analysis.error as error:
            self.analysis.owner = None
            raise SolverError(f"the matrix ({matrix.shape[0]} unknowns) is not positive definite: {error}") from error

    def _solve(self, right_side: Array) -> Array:
        if self.analysis.owner is not self:
            raise SolverError("this factor's place was taken by a later one on the same pattern; factorise again")
        columns = np.asfortranarray(right_side.reshape(len(right_side), -1), dtype=np.float64)
        return self.analysis.run(33, self._upper, columns).reshape(right_side.shape)


_OPTIONAL: dict[str, tuple[str, type[_Cholmod] | type[_Pardiso]]] = {
    "cholmod": ("sksparse", _Cholmod),
    "pardiso": ("pypardiso", _Pardiso),
}
_ORDER: dict[Use, tuple[str, ...]] = {"solve": ("cholmod", "pardiso"), "refactor": ("pardiso", "cholmod")}


def available_backends(use: Use = "solve") -> list[str]:
    """Back ends for positive definite matrices that are installed, best for ``use`` first; SuperLU always is."""
    present = [name for name in _ORDER[use] if importlib.util.find_spec(_OPTIONAL[name][0]) is not None]
    return [*present, "superlu"]


class Factoriser(threading.local):
    """Factorises matrices of one pattern, keeping what the back end has learnt of it, for each thread by itself.

    Parameters
    ----------
    backend : str, optional
        One of :func:`available_backends`; the best one present for ``use`` without it.
    use : {"solve", "refactor"}
        What the factors are for.

    Raises
    ------
    OptionError
        If ``backend`` is not installed.
    """

    def __init__(self, backend: str | None = None, use: Use = "refactor") -> None:
        present = available_backends(use)
        if backend is not None and backend not in present:
            raise OptionError(f"factorisation back end {backend!r} is not installed; present: {', '.join(present)}")
        self.backend = backend or present[0]
        self._use = use
        self._analysis: Any = None
        self._ordering: _Ordering | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        return Factoriser, (self.backend, self._use)

    def definite(self, matrix: sps.csc_array) -> Factor:
        """Factor of a positive definite matrix (both triangles stored); SolverError if it is found not to be.

        SuperLU takes other matrices without a word: ask its factor's ``is_definite`` where that matters.
        """
        _check_finite(matrix)
        if self.backend == "superlu":
            return self._superlu(matrix)
        count_factorisation(matrix.shape[0])
        factor = _OPTIONAL[self.backend][1](matrix, self._analysis)
        self._analysis = factor.analysis
        return factor

    def symmetric(self, matrix: sps.csc_array) -> Factor:
        """Factor of a symmetric matrix that may be indefinite; SolverError if it is singular."""
        if self.backend != "superlu":
            try:
                return self.definite(matrix)
            except SolverError:
                pass
        _check_finite(matrix)
        return self._superlu(matrix)

    def _superlu(self, matrix: sps.csc_array) -> Factor:
        count_factorisation(matrix.shape[0])
        if self._use == "refactor" and self._ordering is None:
            self._ordering = _Ordering.of(matrix)
        return _SuperLU(matrix, self._ordering)


def _check_finite(matrix: sps.csc_array) -> None:
    if not np.isfinite(matrix.data).all():
        raise SolverError(f"the matrix ({matrix.shape[0]} unknowns) has entries that are not finite")
