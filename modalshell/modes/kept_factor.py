"""Solutions with the factor of a matrix that has changed since: conjugate gradients preconditioned by it."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sps

from modalshell.core.typing import Array
from modalshell.modes.factorisation import CondensedFactor, Factor

_SHARE = 0.75
"""Iterations at most, in those that take the time of another factorisation."""
_JUDGED = 2
"""Iterations after which their rate tells whether they will get half the way, in digits."""
_SERVES = 0.1
"""Share of the residual that serves at the last of them."""


def solution_by_kept_factor(kept: Factor, matrix: sps.csc_array, right_side: Array, accuracy: float) -> Array | None:
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

    Returns
    -------
    ndarray or None
        None where a direction has no or negative curvature, or iterations do not do.
    """
    whole = kept.whole if isinstance(kept, CondensedFactor) else kept
    residual = np.zeros(matrix.shape[0])
    residual[: right_side.size] = right_side
    most = round(_SHARE * kept.solves_a_factorisation)
    first = float(np.linalg.norm(residual))
    found, direction, slope = np.zeros_like(residual), np.zeros_like(residual), np.inf
    for iteration in range(1, most + 1):
        preconditioned = whole.solve(residual)
        last, slope = slope, float(residual @ preconditioned)
        direction = preconditioned + (slope / last) * direction
        image = matrix @ direction
        curvature = float(direction @ image)
        if not (curvature > 0.0 and slope > 0.0):
            return None
        found += (slope / curvature) * direction
        residual -= (slope / curvature) * image
        relative = float(np.linalg.norm(residual)) / first
        if relative <= accuracy or (iteration == most and relative <= _SERVES):
            return found[: right_side.size]
        if iteration == _JUDGED and relative ** (most / iteration) > accuracy**0.5:
            break
    return None
