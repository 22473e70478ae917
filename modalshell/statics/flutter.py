"""Whether answers under loads without a potential flutter: asked once, of the answer."""

from __future__ import annotations

from dataclasses import replace

from modalshell.modes import Factor
from modalshell.modes.flutter import flutters
from modalshell.modes.unsymmetric import definite_half
from modalshell.shell import EXACT
from modalshell.statics.newton import NewtonResult
from modalshell.statics.potential import Potential


def without_flutter(problem: Potential, result: NewtonResult) -> NewtonResult:
    """A ``result`` found as stable, ``stable`` only where no vibrations flutter either.

    On the way to an answer the symmetric half of the stiffness is asked, or the whole where that is not definite.
    """
    if not (problem.unsymmetric and result.stable):
        return result
    hessian = problem.linearise(result.point, EXACT)[1]
    unknowns, half = problem.shell.unknowns, result.factor
    if not (isinstance(half, Factor) and half.is_definite()):
        found = definite_half(hessian, problem.factoriser_of(hessian))
        if found is None:
            return result
        half = problem.condensed(found)
    with problem.costs.part("solution"):
        unstable = flutters(hessian, half, unknowns.masses(problem.shell.mass))
    return replace(result, stable=False) if unstable else result
