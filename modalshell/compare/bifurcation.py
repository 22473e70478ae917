"""Bifurcations of the reference: where a second branch of equilibria crosses that of DS."""

from __future__ import annotations

import warnings

from modalshell.analysis.paths import equilibrium_path
from modalshell.compare.case import Case
from modalshell.core.errors import ModalShellError, ModalShellWarning
from modalshell.statics.bifurcation import BIFURCATION
from modalshell.statics.buckling import buckling_factors

_POINTS = 60
"""Points of the path at most: only its first event counts."""
_LINEAR = 1.5
"""Linear buckling load over the whole load up to which the path is searched: shells that bend may buckle earlier."""


def first_bifurcation(case: Case) -> float | None:
    """Share of the load at which the path of DS from rest bifurcates before anything else; None if it does not.

    Linear buckling alone cannot say so: a shell that bends away from the load never buckles.
    """
    try:
        with warnings.catch_warnings(action="ignore", category=ModalShellWarning):  # the path says what happens
            factors = buckling_factors(case.shell, force=case.load).factors
        if not factors.size or factors[0] > _LINEAR:
            return None
        events = equilibrium_path(case.shell, force=case.load, points=_POINTS).events
    except ModalShellError:  # nothing is said of a shell whose path is not followed
        return None
    return float(events[0].factor) if events and events[0].kind == BIFURCATION else None


def bifurcation_text(factor: float | None) -> list[str]:
    """What a reader of errors should know of a bifurcation: a sentence, or nothing."""
    if factor is None:
        return []
    return [
        f"The shell buckles at {factor:.4g} of the load, a bifurcation: beyond it rungs that stay on the first branch, "
        "or take the other side, are off by the distance to the branch of DS."
    ]
