"""Discrete shells along a growing load: the truth that the rungs are held against, and whether it snaps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from modalshell.errors import SolverError
from modalshell.models import DiscreteShell, Equilibrium
from modalshell.modes import lowest_tangent_eigenvalue, solve_modes
from modalshell.shell import Shell
from modalshell.typing import Array
from modalshell.work import counted

_SINGULAR = 0.03
"""Lowest eigenvalue about a deformed state, over that at rest, below which the tangent counts as singular."""
_SHIFT = 0.1
"""Movement between neighbouring loads, in lengths, above which the load step is halved to look for a jump."""
_BISECTIONS = 7
"""Halvings of the load step in which a snap is located."""


@dataclass(frozen=True)
class Snap:
    """Where the shell leaves its branch.

    Attributes
    ----------
    low, high : float
        Shares of the load between which it happens.
    reason : str
        What shows it.
    """

    low: float
    high: float
    reason: str

    def __str__(self) -> str:
        """Where it snaps, to stand after "the shell"."""
        return f"snaps between {self.low:.3g} and {self.high:.3g} of the load: {self.reason}"


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
                snap = find_jump(model, load, last, last_factor, answer.positions, factor, missed)
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


def find_jump(
    model: DiscreteShell, load: Array, before: Array, low: float, after: Array, high: float, missed: bool = False
) -> Snap | None:
    """Bracket a jump between two shares of ``load`` by halving: a smooth path moves less with each, a jump does not.

    ``missed`` says that DS found no answer at some load in between.
    """
    size = model.shell.size

    def apart(one: Array, other: Array) -> float:
        return float(np.linalg.norm(one - other, axis=1).max()) / size

    for _ in range(_BISECTIONS):
        if apart(before, after) < _SHIFT:
            return None
        middle = 0.5 * (low + high)
        answer = model.equilibrium(force=middle * load, start=before if low else None)
        if not answer.converged:
            missed = True
            break
        if apart(answer.positions, before) > apart(answer.positions, after):
            after, high = answer.positions, middle
        else:
            before, low = answer.positions, middle
    between = ", and finds no equilibrium on the way" if missed else ""
    return Snap(low, high, f"DS jumps by {apart(before, after):.2g} lengths{between}")
