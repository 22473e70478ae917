"""Solutions with the factor of a matrix that has changed since: conjugate gradients preconditioned by it."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sps

from modalshell.core.typing import Array
from modalshell.linalg import Stop
from modalshell.modes.factorisation import CondensedFactor, Factor

_SHARE = 0.75
"""Iterations at most, in those that take the time of another factorisation."""
_JUDGED = 2
"""Iterations after which their rate tells whether they will get half the way, in digits."""
_SERVES = 0.1
"""Share of the residual that serves at the last of them."""


def solution_by_kept_factor(
    kept: Factor, matrix: sps.csc_array, right_side: Array, accuracy: float, axes: Array | None = None
) -> Array | None:
    """Solution (N,) of ``matrix x = right_side`` by conjugate gradients with the factor of a nearby matrix.

    Parameters
    ----------
    kept : Factor
        Factor of a positive definite matrix; that of a condensed matrix serves the whole one.
    matrix : csc_array
        Symmetric matrix, internal unknowns after the first N.
    right_side : ndarray, shape (N,)
        Right side.
    accuracy : float
        Norm of the residual over that of the right side at which to stop; a tenth serves after the most iterations,
        which take three quarters of the time of another factorisation.
    axes : ndarray, shape (3, f, 3), optional
        Where each axis has turned to, since the factor's matrix, with the vertices whose positions are the first
        unknowns: the factor is taken as turned with them.

    Returns
    -------
    ndarray or None
        None where a direction has no or negative curvature, or iterations do not do.
    """
    whole = kept.whole if isinstance(kept, CondensedFactor) else kept
    whole_side = np.zeros(matrix.shape[0])
    whole_side[: right_side.size] = right_side
    stop = Stop(accuracy, round(_SHARE * kept.solves_a_factorisation), _SERVES, _JUDGED)
    found = whole.solve_near(matrix, whole_side, stop, axes)
    return None if found is None else found[: right_side.size]
