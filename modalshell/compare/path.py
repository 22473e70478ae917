"""Reference path of a comparison: equilibria of discrete shells under a growing load, and their snaps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import final

import numpy as np

from modalshell.brief import brief
from modalshell.errors import SolverError
from modalshell.models import DiscreteShell, Equilibrium
from modalshell.models.paths import EquilibriumPath, equilibrium_path
from modalshell.modes import lowest_tangent_eigenvalue, solve_modes
from modalshell.shell import Shell
from modalshell.statics.bifurcation import LIMIT
from modalshell.typing import Array
from modalshell.work import counted

_SINGULAR = 0.03
"""Lowest eigenvalue about a deformed state, over that at rest, below which the tangent counts as singular."""
_SHIFT = 0.1
"""Movement between neighbouring loads, in lengths, above which the path between them is looked at."""
_STEPS, _POINTS = 4, 150
"""Steps at least, and points at most, of the path on which a snap is located."""


@final
@dataclass(frozen=True)
class Marks:
    """Load factors of what happens along a path of equilibria.

    Attributes
    ----------
    bifurcation : float or None
        Bifurcation at which the path from rest becomes unstable, before any limit point.
    limit : float or None
        Limit point at which the stable states end: of the path, or of the branch that leaves it at the bifurcation.
    stable_again : float or None
        Load factor at which the path becomes stable again.
    """

    bifurcation: float | None = None
    limit: float | None = None
    stable_again: float | None = None
    smooth: bool = True
    """Whether stable states continue to the path's end."""

    @classmethod
    def of(cls, path: EquilibriumPath) -> Marks:
        """Those of a path, followed with one of its branches at least where it has a bifurcation."""
        if not path.events:
            return cls(smooth=path.converged)
        kind, _, factor = path.events[0]
        again = [event.factor for event in path.events[1:] if path.stable[event[1] + 1 :][:1].all()]
        stable_again = again[0] if again and path.stable[-1] else None
        if kind == LIMIT:
            return cls(None, factor, stable_again, False)
        stable = [branch for branch in path.branches if branch.stable[:2].all()]
        ends = [event.factor for branch in stable for event in branch.events[:1] if event.kind == LIMIT]
        smooth = any(branch.converged and not branch.events for branch in stable)
        return cls(factor, max(ends, default=None), stable_again, smooth)

    @property
    def snap(self) -> float | None:
        """Load factor from which no stable state is near; None if the states continue."""
        if self.smooth:
            return None
        return self.bifurcation if self.limit is None else self.limit


@final
@dataclass(frozen=True)
class Snap:
    """Where the shell leaves its branch.

    Attributes
    ----------
    low, high : float
        Shares of the load between which it happens; one and the same where it was located.
    reason : str
        What shows it.
    marks : Marks
        What happens along the path of equilibria there.
    """

    low: float
    high: float
    reason: str
    marks: Marks = field(default_factory=Marks)

    def __str__(self) -> str:
        """Description of the snap, to follow "the shell"."""
        if self.low == self.high:
            return f"snaps at {self.low:.4g} of the load: {self.reason}"
        return f"snaps between {self.low:.3g} and {self.high:.3g} of the load: {self.reason}"


@brief
@dataclass(frozen=True)
class LoadPath:
    """Discrete shells over the load range.

    Attributes
    ----------
    factors : tuple of float
        Shares of the load.
    answers : list of Equilibrium
        DS at each; one that did not converge is no truth.
    tangents : list of float or None
        Lowest eigenvalue about each state over that at rest; None where DS or the eigensolver gave none.
    lowest : float
        Lowest eigenvalue at rest [1/s^2].
    snap : Snap or None
        The first one, if there is any.
    cost : float
        Counted cost of the answers [reference microseconds].
    """

    factors: tuple[float, ...]
    answers: list[Equilibrium] = field(repr=False)
    tangents: list[float | None]
    lowest: float
    snap: Snap | None
    cost: float = 0.0

    @property
    def known(self) -> list[int]:
        """Which of the loads DS has an answer for."""
        return [k for k, answer in enumerate(self.answers) if answer.converged]


def follow_loads(
    shell: Shell, load: Array, factors: Sequence[float], on_load: Callable[[], None] | None = None
) -> LoadPath:
    """Find the equilibria of DS at growing shares of ``load`` (n, 3) [N], each from the one before."""
    model = DiscreteShell(shell)
    lowest = float(solve_modes(shell, 1).eigenvalues[0])
    answers: list[Equilibrium] = []
    tangents: list[float | None] = []
    snap: Snap | None = None
    last, last_factor, missed, cost = shell.rest_positions, 0.0, False, 0.0
    for factor in factors:
        with counted() as work:
            answer = model.equilibrium(force=factor * load, start=last if last_factor else None)
        cost += work.cost
        answers.append(answer)
        tangents.append(tangent_ratio(shell, answer, lowest))
        if answer.converged:
            if snap is None:
                snap = find_snap(model, load, last, last_factor, answer.positions, factor, missed)
            tangent = tangents[-1]
            if snap is None and tangent is not None and tangent < _SINGULAR:
                snap = Snap(last_factor, factor, f"the lowest eigenvalue of DS falls to {tangent:.2g} of that at rest")
            last, last_factor, missed = answer.positions, factor, False
        else:
            missed = True
        if on_load is not None:
            on_load()
    if missed and snap is None:
        snap = Snap(last_factor, float(factors[-1]), "DS finds no equilibrium there")
    return LoadPath(tuple(float(factor) for factor in factors), answers, tangents, lowest, snap, cost)


def tangent_ratio(shell: Shell, answer: Equilibrium, lowest: float) -> float | None:
    """Lowest eigenvalue about an answer of DS over ``lowest``."""
    if not answer.converged:
        return None
    try:
        return lowest_tangent_eigenvalue(shell, answer.positions) / lowest
    except SolverError:  # singular to the last bit
        return 0.0


def find_snap(
    model: DiscreteShell, load: Array, before: Array, low: float, after: Array, high: float, missed: bool = False
) -> Snap | None:
    """Search for a snap between two fractions of ``load`` with distant states, along the equilibrium path.

    ``missed``: whether DS found no equilibrium at some load in between.
    """
    size = model.shell.size

    def apart(one: Array, other: Array) -> float:
        return float(np.linalg.norm(one - other, axis=1).max()) / size

    jump = apart(before, after)
    if jump < _SHIFT:
        return None
    between = ", and DS finds no equilibrium on the way" if missed else ""
    try:
        path = equilibrium_path(
            model, force=load, begin=low, start=before, until=high, steps=_STEPS, points=_POINTS, branches=1
        )
    except SolverError:  # nothing to begin from: an answer that the path's solver does not confirm
        return Snap(low, high, f"DS jumps by {jump:.2g} lengths{between}")
    marks = Marks.of(path)
    if marks.snap is None:
        routes = [one.positions[-1] for one in (path, *path.branches) if one.converged]
        if any(apart(route, after) < _SHIFT for route in routes):
            return None
        return Snap(low, high, f"DS comes to another branch, {jump:.2g} lengths away{between}", marks)
    what = "a limit point" if marks.limit is not None else "a bifurcation without stable branches"
    twisted = (
        "" if None in (marks.bifurcation, marks.limit) else f", on a branch that begins at {marks.bifurcation:.4g}"
    )
    return Snap(marks.snap, marks.snap, f"{what}{twisted}; DS jumps by {jump:.2g} lengths{between}", marks)
