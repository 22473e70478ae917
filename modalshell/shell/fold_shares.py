"""Fold shares of the split-fold energy at its minimum."""

from __future__ import annotations

import functools
from typing import NamedTuple, final

import numpy as np
import scipy.sparse as sps
import scipy.sparse.linalg as spla

from modalshell.core.errors import SolverError
from modalshell.core.thread_safety import PerThread
from modalshell.core.typing import Array
from modalshell.linalg.columns import ColumnFactor, column_factor, solve_local_rows, solve_rows
from modalshell.shell.split_folds import SplitFolds

_SLACK = 1e-12
"""Stiffness of a combination of fold shares, relative to the largest, below which it counts as zero."""
_FEW = 0.02
"""Share of entries up to which right sides are local."""


def _factorised(stiffness: sps.csc_matrix) -> ColumnFactor:
    options = {"SymmetricMode": True}
    try:
        factor = column_factor(spla.splu(stiffness, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options))
        if factor is None:
            raise RuntimeError("a pivot vanishes")
    except RuntimeError as error:
        raise SolverError(
            "the bending stiffness of the fold shares is singular to rounding: thicknesses or moduli of neighbouring "
            f"triangles are too many decades apart, or overflow ({error})"
        ) from error
    return factor


@final
class Measures(NamedTuple):
    """Measures at some positions: changes of the fold angles, their slopes, and of half the squared edge lengths."""

    points: Array
    folds: Array
    slopes: Array
    stretches: Array

    def energy(self, couples: Array, tensions: Array) -> float:
        """Half the work of couples (H,) and tensions (E,) on them."""
        return 0.5 * float(self.folds @ couples + self.stretches @ tensions)


@final
class FoldShares:
    """Constant matrices of the bending energy, and its least shares: of all, or of the combinations of ``fields``.

    See theory 4, eq. 10.
    """

    def __init__(self, folds: SplitFolds, fields: Array | None = None) -> None:
        self.by_fold, self.coupling, self.stiffness = folds.matrices()
        self.coupling_transposed = self.coupling.T  # of the same arrays
        self._factor = PerThread(functools.partial(_factorised, sps.csc_matrix(self.stiffness)))
        self._fields = fields
        if fields is not None:
            # Few elements may leave combinations without stiffness; nothing drives these either.
            values, vectors = np.linalg.eigh(fields.T @ (self.stiffness @ fields))
            kept = values > _SLACK * values.max(initial=0.0)
            self._fields = fields @ (vectors[:, kept] / np.sqrt(values[kept]))

    @property
    def factor(self) -> ColumnFactor | None:
        """Factor of :attr:`stiffness`; None where there are no shares."""
        return self._factor() if self.stiffness.shape[0] else None

    def solve(self, right_side: Array) -> Array:
        """Shares (m,) or (m, k) under loads of that shape."""
        if self._fields is not None:
            return np.asarray(self._fields @ (self._fields.T @ right_side))
        if not right_side.size:
            return right_side
        rows = np.ascontiguousarray(right_side.T).reshape(-1, len(right_side))
        solution = np.empty_like(rows)
        if len(rows) > 1 and np.count_nonzero(rows) < _FEW * rows.size:
            solve_local_rows(*self._factor(), rows, solution, np.empty(rows.shape[1], bool))
        else:
            solve_rows(*self._factor(), rows, solution)
        return solution.reshape(right_side.T.shape).T

    def couples(self, folds: Array) -> Array:
        """Derivatives (H,) of the bending energy by the fold angles, shares at their minimum [N m]."""
        shares = self.solve(self.coupling @ folds)
        return np.asarray(self.by_fold @ folds - self.coupling_transposed @ shares)
