"""Solutions by the factor of a matrix that has changed since, as preconditioner; and directions of GMRES."""

from __future__ import annotations

from typing import final

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


@final
class Krylov:
    """Orthonormal directions of GMRES [saad1986], rows (most + 1, N), each of them the next one's image.

    The first one (N,) is the image of a solution, of any ``length`` but zero; ``most`` is the number of images at most.
    """

    def __init__(self, first: Array, length: float, most: int) -> None:
        self.directions = np.empty((most + 1, first.size))
        self.directions[0] = first / length
        self._seen = np.zeros((most + 1, most))

    def nearest(self, k: int, image: Array, size: float) -> tuple[Array, float]:
        """Shares (k + 1,) of the directions whose images come nearest to ``size`` of the first, and by how much not.

        ``image`` (N,) is that of direction k, and is overwritten. The gap is infinite where it is no number.
        """
        seen, known = self._seen, self.directions[: k + 1]
        for _ in range(2):  # twice is enough
            parts = known @ image
            image -= parts @ known
            seen[: k + 1, k] += parts
        seen[k + 1, k] = np.linalg.norm(image)
        goal = np.zeros(k + 2)
        goal[0] = size
        if not np.isfinite(seen[k + 1, k]):
            return goal[:-1], np.inf
        shares = np.asarray(np.linalg.lstsq(seen[: k + 2, : k + 1], goal, rcond=None)[0], dtype=np.float64)
        if seen[k + 1, k] > 0.0:
            self.directions[k + 1] = image / seen[k + 1, k]
        return shares, float(np.linalg.norm(seen[: k + 2, : k + 1] @ shares - goal))


def solution_by_kept_factor(
    kept: Factor, matrix: sps.csc_array, right_side: Array, accuracy: float, axes: Array | None = None
) -> Array | None:
    """Solution (N,) of ``matrix x = right_side`` by conjugate gradients with the factor of a nearby matrix.

    Returns None where a direction has no or negative curvature, or iterations do not do.

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
    """
    whole = kept.whole if isinstance(kept, CondensedFactor) else kept
    whole_side = np.zeros(matrix.shape[0])
    whole_side[: right_side.size] = right_side
    stop = Stop(accuracy, round(_SHARE * kept.solves_a_factorisation), _SERVES, _JUDGED)
    found = whole.solve_near(matrix, whole_side, stop, axes)
    return None if found is None else found[: right_side.size]


_FEWEST = 8
"""Iterations of GMRES that are allowed at least: what they stand in for, pivots off the diagonal, is dear."""


def unsymmetric_by_kept_factor(
    kept: Factor, matrix: sps.csc_array, right_side: Array, accuracy: float, axes: Array | None = None
) -> Array | None:
    """The same of a ``matrix`` that need not be symmetric, by GMRES with the factor on the right [saad1986].

    Its residual is then that of the equations.
    """
    whole = kept.whole if isinstance(kept, CondensedFactor) else kept
    whole_side = np.zeros(matrix.shape[0])
    whole_side[: right_side.size] = right_side
    most = max(_FEWEST, round(_SHARE * kept.solves_a_factorisation))
    length = float(np.linalg.norm(whole_side))
    if not length > 0.0:
        return None
    krylov, ways = Krylov(whole_side, length, most), np.empty((most, whole_side.size))
    for k in range(most):
        ways[k] = _turned(whole.solve(_turned(krylov.directions[k], axes, "kvj,vj->vk")), axes, "jvk,vj->vk")
        image = matrix @ ways[k]
        if not ways[k] @ image > 0.0:
            return None
        shares, relative = krylov.nearest(k, image, 1.0)
        if relative <= accuracy or (k + 1 == most and relative <= _SERVES):
            found = length * (shares @ ways[: k + 1])
            return found[: right_side.size] if found @ whole_side > 0.0 else None
        if k + 1 == _JUDGED and not relative ** (most / _JUDGED) <= accuracy**0.5:
            return None
    return None


def _turned(x: Array, axes: Array | None, product: str) -> Array:
    """The unknowns x with those of vertices turned with the axes, or back, as the ``product`` says."""
    if axes is None:
        return x
    turned, count = x.copy(), 3 * axes.shape[1]
    turned[:count] = np.einsum(product, axes, x[:count].reshape(-1, 3)).ravel()
    return turned
