"""Whether a load buckles a shell, by linear theory: what models of quadratic energy cannot see."""

from __future__ import annotations

import numpy as np

from modalshell.errors import SolverError
from modalshell.modes import Factor, Factoriser, condensed_factor
from modalshell.shell import GAUSS_NEWTON, MIXED, Shell
from modalshell.typing import Array

ADVICE = (
    "the load is beyond the shell's linear buckling load: it may snap, which this model cannot follow; "
    "modalshell advise names a model of a scene that does"
)


def buckles(shell: Shell, load: Array) -> bool:
    """Whether the stresses of the linear answer to ``load`` (n, 3) [N] make the stiffness at rest indefinite.

    Linear buckling [bathe1996, section 6.8.2]: exact where the shell hardly moves before it snaps. Never said of a
    shell that its supports do not hold, or without a load.
    """
    if not (load.any() and shell.clamped.any()):
        return False
    rest, unknowns = shell.rest_positions, shell.unknowns
    stiffness = _definite_factor(shell, shell.energy_gradient_hessian(rest, GAUSS_NEWTON)[2])
    if stiffness is None:
        return False
    answer = np.asarray(unknowns.prolong(stiffness.solve(unknowns.restrict(load.ravel())))).reshape(rest.shape)
    stresses = shell.predicted_stresses(rest, answer)
    return _definite_factor(shell, shell.energy_gradient_hessian(rest, MIXED, stresses)[2]) is None


def _definite_factor(shell: Shell, data: Array) -> Factor | None:
    """Factor of a Hessian on the shell's pattern if it is positive definite."""
    try:
        factor = Factoriser().definite(shell.pattern.free_matrix(data))
    except SolverError:
        return None
    if not factor.is_definite():
        return None
    internal = shell.pattern.internal
    return condensed_factor(factor, 0 if internal is None else internal.count)
