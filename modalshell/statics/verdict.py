"""Outcome and message of a static solve, by one rule for all models, and whether an answer flutters: asked once."""

from __future__ import annotations

from dataclasses import replace

import scipy.sparse as sps

from modalshell.core.outcome import Outcome
from modalshell.modes import Factor
from modalshell.modes.flutter import flutters
from modalshell.modes.unsymmetric import definite_half
from modalshell.shell import EXACT
from modalshell.statics.mixed_newton import ACCEPTED
from modalshell.statics.newton import NewtonResult
from modalshell.statics.potential import Potential

_GROWS = (
    "in balance, but without damping the smallest push aside grows, as at a saddle or in flutter: whether damping, "
    "that of wind too, holds it is shown by a motion from there"
)


def verdict(
    residual: float, stable: bool | None, *, limited: bool = False, note: str = "", follows: bool = False
) -> tuple[Outcome, str]:
    """Outcome and message of an answer with this residual, whose Hessian is positive definite or not.

    ``limited``: whether rounding limits the residual; ``note`` is added to the message. ``follows``: whether the load
    has no potential, as wind: then what is not stable without damping may flutter instead, and be held by damping.
    """
    if residual <= ACCEPTED:
        if stable:
            return Outcome.CONVERGED, note
        if follows:
            return Outcome.UNSTABLE, _GROWS
        return Outcome.UNSTABLE, "in balance at a saddle, which the smallest push aside leaves"
    if limited:
        return (
            Outcome.ROUNDING_LIMITED,
            f"rounding keeps the residual at {residual:.1e} of {ACCEPTED:.0e}: the membrane is too stiff for this load",
        )
    return Outcome.NOT_CONVERGED, f"residual {residual:.1e} of {ACCEPTED:.0e}"


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
