"""Bars of modal states found on a coarse shell, less what that lacks where displacements are small.

Two Newton steps on a coarse shell lead from the sampled positions of a modal rung to where the coarse shell would rest,
which is off by its own error: of some percent of the displacement, more than a bar of half a percent allows. To first
order that error is known beforehand. Under the load ``M phi_j omega_j^2``, which holds the mode ``phi_j`` on the fine
shell, the coarse one rests a little off the sampled mode; those answers' gaps times the coordinates are taken from
what the steps add. On sheets of shell theory 1 to 3 % of the fine bar's correction was left; of a leaf whose coarse
shell misses an eighth of the lowest mode a fourth and more; on hinges, which bend and twist otherwise on another mesh,
a fifth and more. So fine checks say whether it serves.
"""

from __future__ import annotations

import math
from typing import NamedTuple, final

import numpy as np

from modalshell.core.typing import Array
from modalshell.models.auto.answered import solver_at_rest
from modalshell.models.coarse_discrete_shell import CoarseDiscreteShell
from modalshell.modes import Basis
from modalshell.statics.error_bar import LEAST_MARGIN, ErrorBar, ErrorEstimator, QuickCheck

_ALIKE = 0.1
"""Difference of the two checks' corrections, over that of the fine one, up to which the coarse one serves."""
_FAINT = 0.1
"""Bar, over what is allowed, below which it is taken for as large in that share."""
_SURE = 2.0
"""Factor on that difference by which the coarse check may err in states to come."""
_GROWN = 1.5
"""Factor of a displacement on that of the last fine check up to which the coarse one serves."""
_IN_A_ROW = 12
"""Coarse checks from one fine one to the next."""
_NEVER = 1e9
"""Such a difference where the coarse check does not serve; files hold finite numbers."""


class Sampled(NamedTuple):
    """What a coarse shell finds of a modal state.

    What the bar's steps add (n, 3) [m], its length in the norm of the mass [kg^(1/2) m], and the stability margin.
    """

    added: Array
    off: float
    margin: float


def linear_gaps(coarse: CoarseDiscreteShell, basis: Basis) -> Array:
    """Answers of a coarse shell to the loads that hold modes of the fine one, less these modes sampled (k, 3, m)."""
    shell, held, mass = coarse.coarse.shell, coarse.shell, np.repeat(coarse.shell.mass, 3)
    solver, unknowns, gaps = solver_at_rest(shell), shell.unknowns, []
    for mode, eigenvalue in zip(basis.modes.T, basis.eigenvalues, strict=True):
        load = coarse.restrict((eigenvalue * mass * mode).reshape(held.rest_positions.shape))
        answer = np.asarray(unknowns.prolong(solver.solve(np.asarray(unknowns.restrict(load.ravel())))))
        sampled = coarse.sampled_from(mode.reshape(-1, 3)) - shell.rest_positions
        gaps.append(answer.reshape(-1, 3) - sampled)
    return np.stack(gaps, axis=-1)


def lowest_gap(coarse: CoarseDiscreteShell, gaps: Array, basis: Basis) -> float:
    """Length of the lowest mode's gap over that of the mode, in the norm of the mass."""
    shell, r = coarse.coarse.shell, basis.rigid_modes
    mode = coarse.sampled_from(basis.modes[:, r].reshape(-1, 3)) - shell.rest_positions
    off, whole = (float(np.sum(shell.mass[:, None] * part**2)) for part in (gaps[:, :, r], mode))
    return math.sqrt(off / whole)


@final
class SampledCheck:
    """Finds bars of modal states on a coarse shell, and says where a fine one is to look.

    What fine checks have found of the coarse ones are three numbers: the displacement [kg^(1/2) m] of the last, the
    difference of the corrections there over the fine one, and how many coarse ones have followed. Zeros are none.
    ``gaps`` (k, 3, m) are those of :func:`linear_gaps`, and ``quick`` is the coarse shell's compiled check.
    """

    def __init__(self, coarse: CoarseDiscreteShell, gaps: Array, quick: QuickCheck | None) -> None:
        self._coarse, self._gaps, self._mass = coarse, gaps, coarse.shell.mass[:, None]
        self._estimator = ErrorEstimator(coarse.coarse.shell, quick, early=True)

    @staticmethod
    def nothing() -> Array:
        """What is known of coarse checks where no fine one has looked."""
        return np.zeros(3)

    def found(self, x: Array, q: Array, load: Array, ahead: Array | None = None) -> Sampled | None:
        """Of positions x (n, 3) [m] under a load (n, 3) [N], or with stresses of a shape ``ahead`` by that (n, 3) [m].

        The coordinates q (m,) are those of the shape that has the stresses. None where steps lead nowhere.
        """
        coarse = self._coarse
        begin = coarse.sampled(x)
        further = None if ahead is None else coarse.sampled(x + ahead) - begin
        bar = self._estimator.bar(begin, coarse.restrict(load), ahead=further)
        if bar.message:
            return None
        added = coarse.weights @ (bar.corrected - begin - self._gaps @ q)
        return Sampled(added, self._length(added), bar.margin)

    def trusts(self, known: Array, moved: float) -> bool:
        """Whether a coarse check may serve at a displacement [kg^(1/2) m]."""
        last, apart, since = known.tolist()
        return last > 0.0 and moved <= _GROWN * last and apart <= _ALIKE and since < _IN_A_ROW

    def surely(self, found: Sampled, known: Array) -> tuple[float, float]:
        """Distance [kg^(1/2) m] and margin of a coarse check, at their worst by what fine ones have found."""
        wider = 1.0 + _SURE * max(float(known[1]), 0.5 * _ALIKE)
        return wider * found.off, 1.0 - wider * max(1.0 - found.margin, 0.0)

    def compared(
        self, found: Sampled | None, bar: ErrorBar, x: Array, moved: float, allowed: float, known: Array
    ) -> Array:
        """What is known after a fine check of x (n, 3) [m] that was to be within ``allowed`` [kg^(1/2) m]."""
        apart = _NEVER if found is None or bar.message else self._apart(found, bar, x, allowed)
        last, before, _ = known.tolist()
        if last > 0.0 and max(apart, before) <= _ALIKE:  # what has been seen of larger states holds
            apart = apart if _GROWN * moved >= last else max(apart, before)
            moved = max(last, moved)
        return np.array([moved, apart, 0.0])

    def _apart(self, found: Sampled, bar: ErrorBar, x: Array, allowed: float) -> float:
        """Difference of a coarse check's correction, or of what stresses take, from the fine one's over that."""
        added, taken = bar.corrected - x, 1.0 - bar.margin
        off = self._length(found.added - added) / max(self._length(added), _FAINT * allowed)
        softer = abs(bar.margin - found.margin) / max(abs(taken), _FAINT * (1.0 - LEAST_MARGIN))
        return min(max(off, softer), _NEVER)

    def _length(self, displacement: Array) -> float:
        return float(np.sqrt(np.sum(self._mass * displacement**2)))
