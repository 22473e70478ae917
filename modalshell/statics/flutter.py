"""Whether answers under loads without a potential flutter: asked once, of the answer."""

from __future__ import annotations

from dataclasses import replace

import scipy.sparse as sps

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
    flutters_there = fluttering(problem, problem.linearise(result.point, EXACT)[1], result.factor)
    return replace(result, stable=False) if flutters_there else result


def fluttering(problem: Potential, hessian: sps.csc_array, known: object = None) -> bool:
    """Whether vibrations of a Hessian flutter whose symmetric half is definite; ``known`` may be the half's factor."""
    half = known
    if not (isinstance(half, Factor) and half.is_definite()):
        found = definite_half(hessian, problem.factoriser_of(hessian))
        if found is None:
            return False
        half = problem.condensed(found)
    with problem.costs.part("solution"):
        return flutters(hessian, half, problem.shell.unknowns.masses(problem.shell.mass))
