"""Linear compliance of loads on a coarse shell, and what of it a basis and its reduced energy have."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, final

import numpy as np
import scipy.linalg
import scipy.sparse as sps

from modalshell.core.typing import Array
from modalshell.linalg import ProfileAnalysis
from modalshell.modes.rigid import RigidFreeSolver
from modalshell.shell import EXACT, Shell

_MISSED, _OFF = 0.02, 0.05
"""Largest fractions of a load's linear compliance outside the basis, and by which the reduced energy's is off."""


@final
class LinearCompliance:
    """Judges loads on a coarse shell by their linear compliance; see :meth:`refusal`.

    ``basis`` (3k, m) is V, and ``own`` (m, m) the Hessian of the reduced energy at rest. ``little`` [J] is the
    compliance of loads that hardly bend a shell with free parts, such as those of a spin within its surface, that of
    balanced loads being looked at; None where all parts are held.
    """

    def __init__(self, coarse: Shell, basis: Array, own: Array, little: float | None) -> None:
        stiffness = sps.csc_array(coarse.stiffness())
        self._basis, self._little = basis, little or 0.0
        self._reduced = [np.linalg.inv(basis.T @ (stiffness @ basis)), scipy.linalg.pinvh(own)]
        self._whole: Callable[[Array], float]
        if little is None:
            held = coarse.free_unknowns
            part = sps.csc_array(stiffness[held][:, held])
            part.sort_indices()
            self._whole = partial(_work, partial(np.take, indices=held), ProfileAnalysis(part).factorise(part))
        else:
            unknowns, data = coarse.unknowns, coarse.hessian(coarse.rest_positions, EXACT)
            self._whole = partial(_work, unknowns.restrict, RigidFreeSolver.of(coarse, data))

    def refusal(self, load: Array) -> str:
        """Why a load (k, 3) [N] is handed over; empty where it is not."""
        whole, reduced = self._whole(load), load.ravel() @ self._basis
        if whole == 0.0:
            return ""
        share = whole / (whole + self._little)
        missed, off = (share * (1.0 - float(reduced @ matrix @ reduced) / whole) for matrix in self._reduced)
        if missed > _MISSED:
            return f"the basis misses {100 * missed:.1f} % of the load's compliance"
        return f"the assumed stresses are {100 * abs(off):.1f} % off the load's compliance" if abs(off) > _OFF else ""


def _work(restrict: Callable[[Array], Array], solver: Any, load: Array) -> float:
    """Work [J] of a load (k, 3) [N] on twice the energy of its linear answer."""
    push = restrict(load.ravel())
    return float(push @ solver.solve(push))
