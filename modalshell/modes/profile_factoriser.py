"""Factorisations of many matrices of one small pattern, in profile storage."""

from __future__ import annotations

from typing import final

import numpy as np
import scipy.sparse as sps

from modalshell.core.cost import count_factorisation
from modalshell.core.typing import Array
from modalshell.linalg import ProfileAnalysis, ProfileFactor
from modalshell.modes.factorisation import Factor, Factoriser

_MOST = 5000
"""Unknowns up to which a profile is looked for."""
_DEAREST = 1e7
"""Multiplications of a factorisation up to which its solves, too, are no dearer than those of sparser factors."""


class _Profile(Factor):
    """``L D L^T`` with pivots in their order, whatever their sign."""

    backend = "profile"

    def __init__(self, factor: ProfileFactor) -> None:
        self._factor = factor

    def _solve(self, right_side: Array) -> Array:
        return self._factor.solve(right_side)

    def is_definite(self) -> bool:
        """Whether all pivots are positive."""
        return self._factor.is_definite()

    def negative_eigenvalues(self) -> int:
        """Number of negative pivots."""
        return self._factor.negative


@final
class ProfileFactoriser(Factoriser):
    """As its base for symmetric matrices; faster for small or slender ones, once its kernels are compiled."""

    def __init__(self) -> None:
        super().__init__()
        self._profile: ProfileAnalysis | None = None

    def definite(self, matrix: sps.csc_array) -> Factor:
        """Factor of a symmetric matrix, definite or not; SolverError if a pivot is zero or an entry not finite."""
        return self._in_profile(matrix) or super().definite(matrix)

    def symmetric(self, matrix: sps.csc_array) -> Factor:
        """Factor of a symmetric matrix; SolverError if a pivot is zero or an entry not finite."""
        return self._in_profile(matrix) or super().symmetric(matrix)

    def _in_profile(self, matrix: sps.csc_array) -> Factor | None:
        if self._profile is None and matrix.shape[0] <= _MOST:
            self._profile = ProfileAnalysis(matrix)
        if self._profile is None or self._profile.products > _DEAREST:
            return None
        count_factorisation(matrix.shape[0])
        with np.errstate(over="ignore", invalid="ignore"):
            return _Profile(self._profile.factorise(matrix))
