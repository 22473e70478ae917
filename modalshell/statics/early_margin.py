"""The second step of a bar by the factor of the first, and the margin where it began: a factorisation less each."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse as sps

from modalshell.core.typing import Array
from modalshell.modes import Factor
from modalshell.modes.kept_factor import solution_by_kept_factor
from modalshell.shell import GAUSS_NEWTON, Shell
from modalshell.statics.margin import CLEAR, LITTLE_STEP, lowest_ratio, probe
from modalshell.statics.warped import turned_axes

_CLOSE = 1e-3
"""Residual of a step's equations at which iterations with the factor of another step have solved them."""


class Begun(NamedTuple):
    """Positions (n, 3) [m] where a step began, its Hessian, and the factor that solved it.

    That is of the Hessian, or where that is ``unstressed``, of the first step's.
    """

    x: Array
    hessian: sps.csc_array
    factor: Factor
    unstressed: bool = False

    def direction(self, shell: Shell, x: Array, hessian: sps.csc_array, gradient: Array) -> Array | None:
        """Newton direction (N,) at x (n, 3) by iterations with this step's factor; None where it does not serve."""
        axes = turned_axes(shell, self.x, x)
        return solution_by_kept_factor(self.factor, hessian, -gradient, _CLOSE, axes)

    def margin(self, shell: Shell, off: float, moved: float) -> float | None:
        """The margin where a step began of length ``off``, under dead loads; None where it is long, or not clear.

        ``moved`` is the displacement, a length alike. The lowest ratio r of G to ``K_1 + G`` makes it ``1 / (1 - r)``.
        The factor of the first step, where that served for both, is of ``K_1`` alone: to that it is ``1 + r``.
        """
        if not (off <= LITTLE_STEP * moved and self.factor.is_definite()):
            return None
        # Internal unknowns, the last ones, have no part in the difference.
        geometric = self.hessian - shell.pattern.free_matrix(shell.hessian(self.x, GAUSS_NEWTON))
        whole = np.zeros(geometric.shape[0])

        def softening(values: Array) -> Array:
            whole[: values.size] = values
            return np.asarray((geometric @ whole)[: values.size])

        ratio = lowest_ratio(self.factor.solve, softening, probe(shell.unknowns.count)).value
        margin = ratio if self.unstressed else 1.0 / (2.0 - ratio)
        return margin if margin > CLEAR else None
