"""Sparse factorisation of symmetric matrices, by the fastest suitable back end.

Small and slender matrices go to the profile factorisation of :mod:`modalshell.linalg`, others to its multifrontal one,
which takes pivots of either sign, and those whose pivots vanish to SciPy's SuperLU. PARDISO was as fast as Cholesky
(within 15 % from 7,500 to 300,000 unknowns, its solves half as fast) and CHOLMOD has no wheels: neither is needed.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import scipy.sparse as sps
import scipy.sparse.linalg as spla
from numpy.typing import NDArray

from modalshell.core.checks import checked_choice
from modalshell.core.cost import count_factorisation, count_solves
from modalshell.core.errors import SolverError
from modalshell.core.typing import Array
from modalshell.linalg import (
    BlockCholesky,
    CholeskyAnalysis,
    NotPositiveDefiniteError,
    ProfileAnalysis,
    ProfileFactor,
    Stop,
)
from modalshell.linalg.cholesky import block_graph, without_zeros
from modalshell.linalg.columns import ColumnFactor, column_factor, solve_axes, solve_rows
from modalshell.linalg.ordering import minimum_degree

Use = Literal["solve", "axes", "refactor"]
"""Whether one factor serves many solves, or one pattern many factors."""


class Factor(ABC):
    """A factorised symmetric matrix."""

    backend: str
    """Name of the library that holds the factor."""
    solves_a_factorisation: float = 0.0
    """Solves that take the time of another factorisation, about; 0 where the factor is not worth keeping."""

    def solve(self, right_side: Array) -> Array:
        """Solution of ``A x = right_side`` for (N,) or (N, k) right sides."""
        count_solves(len(right_side), right_side.size // max(len(right_side), 1))
        return self._solve(right_side)

    @abstractmethod
    def _solve(self, right_side: Array) -> Array: ...

    def solve_near(
        self,
        matrix: sps.csc_array,  # noqa: ARG002
        right_side: Array,  # noqa: ARG002
        stop: Stop,  # noqa: ARG002
        axes: Array | None = None,  # noqa: ARG002
    ) -> Array | None:
        """Solution (N,) for a symmetric matrix near A by conjugate gradients; None where they fail, or cannot pay.

        See :func:`modalshell.linalg.conjugate_gradients.solve_near`.
        """
        return None

    def is_definite(self) -> bool:
        """Whether A is positive definite, by the signs of its pivots; Cholesky factors exist for no other."""
        return True

    def negative_eigenvalues(self) -> int:
        """Number of A's negative eigenvalues, by the signs of its pivots; SolverError where these do not show it."""
        return 0


class CondensedFactor(Factor):
    """Factor of a matrix whose last unknowns have no load of their own: solves with the Schur complement of the others.

    It is positive definite with the ``whole`` matrix where the block of those unknowns, ``internal`` many, is.
    """

    def __init__(self, factor: Factor, internal: int) -> None:
        self.whole = factor
        self._internal = internal
        self.backend, self.solves_a_factorisation = factor.backend, factor.solves_a_factorisation

    def _solve(self, right_side: Array) -> Array:
        none = np.zeros((self._internal, *right_side.shape[1:]))
        return self.whole._solve(np.concatenate([right_side, none]))[: len(right_side)]

    def is_definite(self) -> bool:
        """Whether the whole matrix is positive definite."""
        return self.whole.is_definite()

    def negative_eigenvalues(self) -> int:
        """Number of negative eigenvalues of the whole matrix, and of the Schur complement: the last block has none."""
        return self.whole.negative_eigenvalues()


def condensed_factor(factor: Factor, internal: int) -> Factor:
    """``factor`` as one of the unknowns before the last ``internal`` ones; itself if there are none."""
    return CondensedFactor(factor, internal) if internal else factor


@dataclass(frozen=True)
class _Ordering:
    """SuperLU's order of one pattern: the permuted pattern, and which entry of the matrix goes where in it.

    Found before the first matrix, so that this is factorised to the same bits as every later one with its entries.
    """

    order: NDArray[np.int64]
    permuted: sps.csc_array

    @classmethod
    def of(cls, matrix: sps.csc_array) -> _Ordering:
        size, graph = block_graph(matrix)
        order = (size * minimum_degree(graph)[:, None] + np.arange(size)).ravel()
        numbers = sps.csc_array((np.arange(1, matrix.data.size + 1), matrix.indices, matrix.indptr), matrix.shape)
        permuted = sps.csc_array(numbers[order][:, order])
        permuted.sort_indices()  # now: SuperLU would sort the shared indices in place, and leave the numbers behind
        return cls(order, permuted)

    def apply(self, matrix: sps.csc_array) -> sps.csc_matrix:
        pattern = self.permuted
        return sps.csc_matrix((matrix.data[pattern.data - 1], pattern.indices, pattern.indptr), shape=matrix.shape)


def sparse_lu(matrix: sps.csc_matrix, **options: Any) -> Any:
    """SciPy's SuperLU of a matrix; SolverError if it is singular."""
    try:
        return spla.splu(matrix, **options)
    except RuntimeError as error:
        raise SolverError(f"the matrix ({matrix.shape[0]} unknowns) is singular: {error}") from error


class _SuperLU(Factor):
    """SciPy's SuperLU in symmetric mode: minimum-degree order of A + A^T, once per pattern, and diagonal pivots."""

    backend = "superlu"

    def __init__(self, matrix: sps.csc_array, ordering: _Ordering | None = None) -> None:
        order = "MMD_AT_PLUS_A" if ordering is None else "NATURAL"
        permuted = sps.csc_matrix(matrix) if ordering is None else ordering.apply(matrix)
        self._factor = sparse_lu(permuted, permc_spec=order, diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        self._order = None if ordering is None else ordering.order

    def _solve(self, right_side: Array) -> Array:
        if self._order is None:
            return self._factor.solve(np.ascontiguousarray(right_side))
        solution = np.empty_like(right_side)
        solution[self._order] = self._factor.solve(np.ascontiguousarray(right_side[self._order]))
        return solution

    def is_definite(self) -> bool:
        # Off the diagonal pivots are taken only where the diagonal one vanishes, as it cannot in a definite matrix.
        return bool(self._in_place() and (self._factor.U.diagonal() > 0.0).all())

    def negative_eigenvalues(self) -> int:
        if not self._in_place():
            raise SolverError("pivots off the diagonal hide the signs of the eigenvalues")
        return int((self._factor.U.diagonal() < 0.0).sum())  # Sylvester's law: A = L D L^T with U = D L^T

    def _in_place(self) -> bool:
        return np.array_equal(self._factor.perm_r, self._factor.perm_c)


class _Axes(Factor):
    """SuperLU's factor by columns, for right sides of three."""

    backend = "superlu"

    def __init__(self, columns: ColumnFactor) -> None:
        self._columns = columns

    def _solve(self, right_side: Array) -> Array:
        sides = np.array(right_side, dtype=np.float64, order="C")
        sides = sides.reshape(len(sides), math.prod(sides.shape[1:]))
        solution = np.empty_like(sides)
        if sides.shape[1] == 3:
            solve_axes(*self._columns, sides, solution)
        else:
            solve_rows(*self._columns, sides.T.copy(), rows := np.empty(sides.T.shape))
            solution[:] = rows.T
        return solution.reshape(right_side.shape)

    def is_definite(self) -> bool:
        return bool((self._columns.pivots > 0.0).all())

    def negative_eigenvalues(self) -> int:
        return int((self._columns.pivots < 0.0).sum())


class _Cholesky(Factor):
    """Multifrontal Cholesky factorisation of 3 x 3 blocks: see :mod:`modalshell.linalg`."""

    backend = "cholesky"

    def __init__(self, factor: BlockCholesky) -> None:
        self._factor = factor
        self.solves_a_factorisation = factor.solves_a_factorisation

    def _solve(self, right_side: Array) -> Array:
        return self._factor.solve(right_side)

    def solve_near(
        self, matrix: sps.csc_array, right_side: Array, stop: Stop, axes: Array | None = None
    ) -> Array | None:
        """Solution (N,) for a symmetric matrix near A by conjugate gradients; None where they fail."""
        found, iterations, served = self._factor.solve_near(matrix, right_side, stop, axes)
        count_solves(right_side.size, iterations)
        return found if served else None


class _Signed(Factor):
    """A factor whose pivots were taken in their order, whatever their sign: profile, or multifrontal."""

    def __init__(self, factor: ProfileFactor | BlockCholesky) -> None:
        self._factor = factor
        self.backend = "profile" if isinstance(factor, ProfileFactor) else "cholesky"

    def _solve(self, right_side: Array) -> Array:
        return self._factor.solve(right_side)

    def is_definite(self) -> bool:
        """Whether all pivots are positive."""
        return self._factor.negative == 0

    def negative_eigenvalues(self) -> int:
        """Number of negative pivots."""
        return self._factor.negative


BACKENDS = ("cholesky", "superlu")
"""Names of the factorisations: multifrontal Cholesky of positive definite matrices, and SciPy's SuperLU."""

_ROUGH = 1e7
"""Multiplications of a profile factorisation from which a rough multifrontal one and conjugate gradients are faster."""
_SLENDER = 1e8
"""The same for a multifrontal factorisation in double precision, and a solve with it."""
_LONG = 20_000
"""Unknowns up to which definite matrices may be so slender that it pays to look for their profile."""
_SMALL = 2000
"""Unknowns below which SuperLU makes a single factor for many solves: its own are as fast, and need no compilation."""


def known_factorisations() -> str:
    """Which factorisation takes which matrices, and why."""
    return (
        f"profile (our own) up to {_SLENDER / 1e6:.0f} million multiplications, 7 to 10 times as fast as superlu; "
        "cholesky (multifrontal, our own) above, 4 to 7 times. Of single factors: cholesky from "
        f"{_SMALL:,} unknowns on, superlu (SciPy) below, and for RSW. Superlu also takes matrices whose pivots vanish"
    )


class Factoriser:
    """Factorises matrices of one pattern, reusing its symbolic analysis; thread-safe.

    OptionError for a ``backend`` of another name.

    Parameters
    ----------
    backend : {"cholesky", "superlu"}, optional
        Without it, by the work: a profile factorisation where the matrix is small or slender, else Cholesky.
    use : {"solve", "axes", "refactor"}
        Whether one factor serves many solves, or one pattern many factors. For the former SuperLU stands in for the
        profile factorisation, below 2,000 unknowns. Where solves are of right sides (N, 3), one for each axis, it does
        at any size: of one unknown a vertex its factor is found in half the time of the multifrontal one.
    """

    def __init__(self, backend: str | None = None, use: Use = "refactor") -> None:
        if backend is not None:
            checked_choice("backend", backend, BACKENDS)
        self.backend = backend
        self._use = use
        self._analysis: CholeskyAnalysis | None = None
        self._ordering: _Ordering | None = None
        self._profile: ProfileAnalysis | None = None

    def definite(self, matrix: sps.csc_array) -> Factor:
        """Factor of a positive definite matrix (both triangles stored); SolverError if it proves not to be.

        SuperLU and profile factors accept other matrices silently: check ``is_definite`` if that matters.
        """
        check_finite(matrix)
        count_factorisation(matrix.shape[0])
        way = self._way(matrix)
        if way == "cholesky":
            return _Cholesky(self._multifrontal(matrix))
        return self._superlu(matrix) if way == "superlu" else self._by_profile(matrix)

    def rough(self, matrix: sps.csc_array) -> Factor | None:
        """Factor of a positive definite matrix in single precision, for conjugate gradients; None if there is none.

        It takes half the memory of another one, and half its time. Small matrices have none, nor do those whose lowest
        eigenvalues are lost in the rounding of the largest.
        """
        check_finite(matrix)
        if self._way(matrix, _ROUGH) != "cholesky":
            return None
        count_factorisation(matrix.shape[0])
        try:
            return _Cholesky(self._multifrontal(matrix, single=True))
        except NotPositiveDefiniteError:
            return None

    def _multifrontal(self, matrix: sps.csc_array, *, single: bool = False, signed: bool = False) -> BlockCholesky:
        once = self._use == "solve"
        stored = without_zeros(matrix) if once else matrix
        if once or self._analysis is None:
            self._analysis = CholeskyAnalysis.known(stored, once=once)
        return self._analysis.factorise(stored, single=single, signed=signed)

    def symmetric(self, matrix: sps.csc_array) -> Factor:
        """Factor of a symmetric matrix that may be indefinite; SolverError if it is singular."""
        try:
            return self.definite(matrix)
        except NotPositiveDefiniteError:
            count_factorisation(matrix.shape[0])
            try:
                return _Signed(self._multifrontal(matrix, signed=True))
            except NotPositiveDefiniteError:  # a pivot vanishes: SuperLU looks for another one off the diagonal
                return self._superlu(matrix)

    def _way(self, matrix: sps.csc_array, slender: float = _SLENDER) -> str:
        """Which factorisation takes a positive definite matrix; a profile one up to ``slender`` multiplications."""
        size = matrix.shape[0]
        if self.backend is not None:
            return self.backend
        if self._use == "axes":
            return "superlu"
        if self._use == "solve":
            return "superlu" if size < _SMALL else "cholesky"
        if size > _LONG:
            return "cholesky"
        self._profile = self._profile or ProfileAnalysis.known(matrix)
        return "profile" if self._profile.products <= slender else "cholesky"

    def _by_profile(self, matrix: sps.csc_array) -> Factor:
        assert self._profile is not None
        try:
            return _Signed(self._profile.factorise(matrix))
        except SolverError:  # as above
            return self._superlu(matrix)

    def _superlu(self, matrix: sps.csc_array) -> Factor:
        if self._use == "refactor" and self._ordering is None:
            self._ordering = _Ordering.of(matrix)
        factor = _SuperLU(matrix, self._ordering)
        columns = column_factor(factor._factor) if self._use == "axes" else None
        return factor if columns is None else _Axes(columns)


def check_finite(matrix: sps.csc_array) -> None:
    """Raise SolverError for entries that are not finite."""
    if not np.isfinite(matrix.data).all():
        raise SolverError(f"the matrix ({matrix.shape[0]} unknowns) has entries that are not finite")
