"""Sparse factorisation of symmetric matrices: one place that takes the best back end present and says which."""

from __future__ import annotations

import importlib.util
import warnings
from abc import ABC, abstractmethod
from typing import Any

import numpy as np
import scipy.sparse as sps
import scipy.sparse.linalg as spla
from numpy.typing import NDArray

from modalshell.errors import OptionError, SolverError

Array = NDArray[np.float64]


class Factor(ABC):
    """A factorised symmetric matrix.

    Attributes
    ----------
    backend : str
        Name of the library that holds the factor.
    """

    backend: str

    @abstractmethod
    def solve(self, right_side: Array) -> Array:
        """Solution of ``A x = right_side`` for (N,) or (N, k) right sides."""

    @abstractmethod
    def negative_pivots(self) -> int | None:
        """Number of negative eigenvalues of A by Sylvester's law, or None where the back end does not tell."""


class _SuperLU(Factor):
    """SciPy's SuperLU in symmetric mode: minimum-degree order of A + A^T and diagonal pivots."""

    backend = "superlu"

    def __init__(self, matrix: sps.csc_array) -> None:
        try:
            self._factor = spla.splu(
                sps.csc_matrix(matrix),
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )
        except RuntimeError as error:
            raise SolverError(f"the matrix ({matrix.shape[0]} unknowns) is singular: {error}") from error

    def solve(self, right_side: Array) -> Array:
        return np.asarray(self._factor.solve(np.ascontiguousarray(right_side)))

    def negative_pivots(self) -> int | None:
        if not np.array_equal(self._factor.perm_r, self._factor.perm_c):
            return None
        return int(np.count_nonzero(self._factor.U.diagonal() < 0.0))


class _Cholmod(Factor):
    """CHOLMOD through scikit-sparse; for positive definite matrices."""

    backend = "cholmod"

    def __init__(self, matrix: sps.csc_array) -> None:
        from sksparse import cholmod

        try:
            self._factor: Any = cholmod.cholesky(sps.csc_matrix(matrix))
        except cholmod.CholmodError as error:
            raise SolverError(f"the matrix ({matrix.shape[0]} unknowns) is not positive definite: {error}") from error

    def solve(self, right_side: Array) -> Array:
        return np.asarray(self._factor(right_side))

    def negative_pivots(self) -> int | None:
        return 0


class _Pardiso(Factor):
    """Intel MKL PARDISO through pypardiso; upper triangle, symmetric positive definite."""

    backend = "pardiso"

    def __init__(self, matrix: sps.csc_array) -> None:
        import pypardiso

        self._solver: Any = pypardiso.PyPardisoSolver(mtype=2)
        self._upper = sps.csr_matrix(sps.triu(matrix, format="csr"))
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                self._solver.factorize(self._upper)
        except pypardiso.pardiso_wrapper.PyPardisoError as error:
            raise SolverError(f"the matrix ({matrix.shape[0]} unknowns) is not positive definite: {error}") from error

    def solve(self, right_side: Array) -> Array:
        return np.asarray(self._solver.solve(self._upper, np.asfortranarray(right_side)))

    def negative_pivots(self) -> int | None:
        return 0

    def __del__(self) -> None:
        solver = getattr(self, "_solver", None)
        if solver is not None:
            solver.free_memory(everything=True)


_DEFINITE = {"cholmod": ("sksparse", _Cholmod), "pardiso": ("pypardiso", _Pardiso)}


def available_backends() -> list[str]:
    """Back ends for positive definite matrices that are installed, best first; SuperLU always is."""
    present = [name for name, (module, _) in _DEFINITE.items() if importlib.util.find_spec(module) is not None]
    return [*present, "superlu"]


def factorise(matrix: sps.csc_array, *, definite: bool, backend: str | None = None) -> Factor:
    """Factorise a sparse symmetric matrix.

    Parameters
    ----------
    matrix : csc_array, shape (N, N)
        Both triangles stored.
    definite : bool
        Whether the matrix is known to be positive definite, which opens the faster back ends.
    backend : str, optional
        One of :func:`available_backends`; the best one present without it.

    Raises
    ------
    SolverError
        If the matrix is singular to working precision, or not definite where ``definite`` says so.
    OptionError
        If ``backend`` is not installed.
    """
    if not np.isfinite(matrix.data).all():
        raise SolverError(f"the matrix ({matrix.shape[0]} unknowns) has entries that are not finite")
    present = available_backends()
    if backend is not None and backend not in present:
        raise OptionError(f"factorisation back end {backend!r} is not installed; present: {', '.join(present)}")
    chosen = backend or (present[0] if definite else "superlu")
    if chosen != "superlu" and not definite:
        raise OptionError(f"back end {chosen!r} needs a positive definite matrix; use 'superlu'")
    return _SuperLU(matrix) if chosen == "superlu" else _DEFINITE[chosen][1](matrix)
