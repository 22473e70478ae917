"""Factors of matrices that need not be symmetric, as stiffnesses are not under loads that follow a free edge.

They differ from their symmetric half by a matrix that is small, as it comes from the edges alone. The half is
factorised, 15 times as fast as the whole, and GMRES, preconditioned by it, adds what it leaves out in some six steps
[saad1986]. Where the other half is large, and for small matrices, SciPy's SuperLU serves.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sps

from modalshell.core.cost import count_factorisation
from modalshell.core.errors import SolverError
from modalshell.core.typing import Array
from modalshell.modes.factorisation import Factor, Factoriser, check_finite, sparse_lu
from modalshell.modes.kept_factor import Krylov

_SMALL = 3000
"""Unknowns below which SuperLU is fast enough."""
_MOST = 24
"""Steps of GMRES at most."""
_EXACT = 1e-12
"""Residual of GMRES, preconditioned, as a share of the right side's."""


def general_factor(matrix: sps.csc_array, factoriser: Factoriser) -> Factor:
    """Factor of a matrix (N, N) that need not be symmetric; SolverError if it is singular.

    ``factoriser`` takes its symmetric half.
    """
    check_finite(matrix)
    if matrix.shape[0] >= _SMALL:
        try:
            return _NearlySymmetric(matrix, factoriser.symmetric(symmetric_half(matrix)))
        except SolverError:  # the half may be singular where the whole is not
            pass
    return _GeneralLU(matrix)


def symmetric_half(matrix: sps.csc_array) -> sps.csc_array:
    """Half the sum of a matrix and its transpose, on its own pattern where that is symmetric."""
    matrix.sort_indices()
    other = sps.csc_array(matrix.T)
    other.sort_indices()
    if not (np.array_equal(matrix.indptr, other.indptr) and np.array_equal(matrix.indices, other.indices)):
        return sps.csc_array(0.5 * (matrix + other))
    return sps.csc_array((0.5 * (matrix.data + other.data), matrix.indices, matrix.indptr), shape=matrix.shape)


def definite_half(matrix: sps.csc_array, factoriser: Factoriser) -> Factor | None:
    """Factor of the symmetric half of a matrix; None where that is not positive definite."""
    try:
        half = factoriser.definite(symmetric_half(matrix))
        return half if half.is_definite() else None
    except SolverError:
        return None


class _GeneralLU(Factor):
    """SciPy's SuperLU with pivots off the diagonal."""

    backend = "superlu"

    def __init__(self, matrix: sps.csc_array) -> None:
        count_factorisation(matrix.shape[0])
        self._factor = sparse_lu(sps.csc_matrix(matrix))

    def _solve(self, right_side: Array) -> Array:
        return self._factor.solve(np.ascontiguousarray(right_side))

    def is_definite(self) -> bool:
        """False: unknown."""
        return False


class _NearlySymmetric(Factor):
    """A matrix and the factor of its symmetric half; SuperLU's of the whole where GMRES does not get there."""

    def __init__(self, matrix: sps.csc_array, half: Factor) -> None:
        self._matrix, self._half = matrix, half
        self.backend = half.backend
        self._whole: Factor | None = None

    def _solve(self, right_side: Array) -> Array:
        sides = right_side.reshape(len(right_side), -1)
        return np.stack([self._solution(side) for side in sides.T], axis=1).reshape(right_side.shape)

    def _solution(self, side: Array) -> Array:
        """The solution for one right side (N,)."""
        found = None if self._whole is not None else self._by_steps(side)
        if found is None:
            self._whole = self._whole or _GeneralLU(self._matrix)
            found = self._whole.solve(side)
        return found

    def _by_steps(self, side: Array) -> Array | None:
        """The same by GMRES; None where it takes too many steps.

        SciPy's asks for the true residual at its end, which rounding in thin shells' factors keeps above any tolerance.
        """
        first = self._half.solve(side)
        length = float(np.linalg.norm(first))
        if not length > 0.0:
            return first if length == 0.0 else None
        krylov = Krylov(first, length, _MOST)
        for k in range(_MOST):
            shares, gap = krylov.nearest(k, self._half.solve(self._matrix @ krylov.directions[k]), length)
            if not np.isfinite(gap):
                return None
            if gap <= _EXACT * length:
                return np.asarray(shares @ krylov.directions[: k + 1])
        return None

    def is_definite(self) -> bool:
        """False: unknown."""
        return False
