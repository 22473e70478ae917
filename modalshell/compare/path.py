"""Reference path of a comparison: equilibria of discrete shells under a growing load, and their snaps."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import final

import numpy as np

from modalshell.analysis.paths import EquilibriumPath, equilibrium_path
from modalshell.core.cost import counted
from modalshell.core.errors import SolverError
from modalshell.core.short_repr import short_repr
from modalshell.core.typing import Array
from modalshell.models import DiscreteShell, Equilibrium
from modalshell.modes import Factoriser, TangentStiffness, lowest_modes
from modalshell.shell import Shell
from modalshell.statics.bifurcation import LIMIT

_SINGULAR = 0.03
"""Lowest eigenvalue about a deformed state, over that at rest, below which the tangent counts as singular."""
_SHIFT, _MOVED = 0.1, 2.0
"""Movement between neighbouring loads above which the path between them is followed: in lengths, and over what the
stiffer of both tangents predicts. Panels snap by less than a tenth of their length."""
_BEYOND = 1.1
"""Load factor up to which the path is followed where the tangent is singular under the whole load."""
_SAME = 0.1
"""Largest distance between two states that count as one, as a share of the movement between the loads."""
_STEPS, _POINTS = 4, 150
"""Steps at least, and points at most, of the path on which a snap is located."""
_SNAPS = 4
"""Snaps that are searched between two of the loads, at most."""
NEXT_TO_SNAP = 0.005
"""Distance of the loads just below and just above a snap from its load, relative to it."""


@final
@dataclass(frozen=True)
class Marks:
    """Load factors of what happens along a path of equilibria."""

    bifurcation: float | None = None
    """Bifurcation at which the path from rest becomes unstable, before any limit point."""
    limit: float | None = None
    """Limit point at which the stable states end: of the path, or of the branch that leaves it at the bifurcation."""
    stable_again: float | None = None
    """Load factor at which the path becomes stable again."""
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
    """Where the shell leaves its branch."""

    low: float
    high: float
    """Shares of the load between which it happens; one and the same where it was located."""
    reason: str
    """What shows it."""
    marks: Marks = field(default_factory=Marks)
    """What happens along the path of equilibria there."""
    stable: tuple[Array, Array] | None = field(default=None, repr=False, compare=False)
    """Load factors (k,) and positions (k, n, 3) [m] of the stable states before it, where it was located."""

    def __str__(self) -> str:
        """Description of the snap, to follow "the shell"."""
        if self.low == self.high:
            return f"snaps at {self.low:.4g} of the load: {self.reason}"
        return f"snaps between {self.low:.3g} and {self.high:.3g} of the load: {self.reason}"


@short_repr
@dataclass(frozen=True)
class LoadPath:
    """Discrete shells over the load range."""

    factors: tuple[float, ...]
    """Shares of the load."""
    answers: list[Equilibrium] = field(repr=False)
    """DS at each; one that did not converge is no truth."""
    tangents: list[float | None]
    """Lowest eigenvalue about each state over that at rest; None where DS or the eigensolver gave none."""
    lowest: float
    """Lowest eigenvalue at rest [1/s^2]."""
    snaps: Sequence[Snap] = ()
    """Where DS leaves its branch."""
    near: tuple[float, ...] = ()
    """Shares of the load just below and just above the snaps that were located, as far as DS has answers there."""
    near_answers: list[Equilibrium] = field(default_factory=list, repr=False)
    """DS at these."""
    cost: float = 0.0
    """Counted cost of all answers [reference microseconds]."""

    @property
    def snap(self) -> Snap | None:
        """The first one, if there is any."""
        return self.snaps[0] if self.snaps else None

    @property
    def known(self) -> list[int]:
        """Which of the loads DS has an answer for."""
        return [k for k, answer in enumerate(self.answers) if answer.converged]


@final
@dataclass(frozen=True)
class _State:
    """An equilibrium of DS at a share of the load."""

    factor: float
    positions: Array
    speed: float
    """How far it moves by the share, 0 where its Hessian is singular."""
    tangent: float
    """Lowest eigenvalue over that at rest."""

    @property
    def singular(self) -> bool:
        """Whether a critical point is near."""
        return self.tangent < _SINGULAR


def follow_loads(
    shell: Shell, load: Array, factors: Sequence[float], on_load: Callable[[], None] = lambda: None
) -> LoadPath:
    """Find the equilibria of DS at growing shares of ``load`` (n, 3) [N], each from the one before, and its snap."""
    model = DiscreteShell(shell)
    lowest = float(lowest_modes(shell, 1)[0].eigenvalues[0])
    if not lowest > 0.0:
        raise SolverError(
            f"the lowest mode of the shell has no stiffness to compare with (got eigenvalue {lowest:g}): give the "
            "material a stretch, shear and flexure above 0"
        )
    answers: list[Equilibrium] = []
    tangents: list[float | None] = []
    snaps: list[Snap] = []
    near: list[tuple[float, Equilibrium]] = []
    search = _SnapSearch(model, load, lowest)
    last, missed, cost = search.rest(), False, 0.0
    for factor in factors:
        with counted() as work:
            answer = model.equilibrium(force=factor * load, start=last.positions if last.factor else None)
        cost += work.cost
        answers.append(answer)
        tangents.append(None)
        if answer.converged:
            state = search.state(factor, answer.positions)
            tangents[-1] = state.tangent
            if missed or search.suspicious(last, state):
                with counted() as work:
                    for snap, around in search.snaps_between(last, state, missed, factors):
                        snaps.append(snap)
                        near += around
                cost += work.cost
            last, missed = state, False
        else:
            missed = True
        on_load()
    if missed:
        snaps.append(Snap(last.factor, float(factors[-1]), "DS finds no equilibrium there"))
    elif last.singular:
        beyond = find_snap(model, load, last.positions, last.factor, None, _BEYOND)
        snaps += [] if beyond is None else [beyond]
        near += [] if beyond is None else next_to_snap(model, load, beyond, factors)
    return LoadPath(
        tuple(float(factor) for factor in factors),
        answers,
        tangents,
        lowest,
        snaps,
        tuple(share for share, _ in near),
        [answer for _, answer in near],
        cost,
    )


@final
class _SnapSearch:
    """Decides between which loads the path of equilibria is followed; ``lowest`` [1/s^2] is the eigenvalue at rest."""

    def __init__(self, model: DiscreteShell, load: Array, lowest: float) -> None:
        self._model, self._load = model, load
        self._followed, self._shell, self._lowest = model.followable(load), model.shell, lowest
        self._factoriser = Factoriser()

    def rest(self) -> _State:
        """The state without a load."""
        x = self._shell.rest_positions
        return _State(0.0, x, self._speed(TangentStiffness.at(self._shell, x, self._factoriser)), 1.0)

    def state(self, share: float, positions: Array) -> _State:
        """A state of DS at a share of the load."""
        stiffness = TangentStiffness.at(self._shell, positions, self._factoriser)
        try:
            tangent = stiffness.lowest_mode()[0] / self._lowest
        except SolverError:  # singular to the last bit
            tangent = 0.0
        return _State(share, positions, self._speed(stiffness), tangent)

    def _speed(self, stiffness: TangentStiffness) -> float:
        """How far a state of that stiffness moves by the share of the load."""
        try:
            return self._followed.problem.length(stiffness.solve(self._followed.problem.push))
        except SolverError:
            return 0.0

    def suspicious(self, before: _State, after: _State) -> bool:
        """Whether DS may have left its branch between two states."""
        problem, unknowns = self._followed.problem, self._followed.unknowns
        moved = problem.length(problem.difference(unknowns(after.positions), unknowns(before.positions)))
        predicted = (after.factor - before.factor) * min(before.speed, after.speed)
        apart = float(np.linalg.norm(after.positions - before.positions, axis=1).max())
        return before.singular or apart >= _SHIFT * self._shell.size or moved > _MOVED * predicted

    def snaps_between(
        self, before: _State, after: _State, missed: bool, factors: Sequence[float]
    ) -> Iterator[tuple[Snap, list[tuple[float, Equilibrium]]]]:
        """Snaps between two states, with the answers of DS next to them: behind one that was located another may be."""
        for _ in range(_SNAPS):
            where = before.positions, before.factor, after.positions, after.factor
            snap = find_snap(self._model, self._load, *where, missed)
            if snap is None:
                return
            near = next_to_snap(self._model, self._load, snap, factors)
            yield snap, near
            above = [(share, answer) for share, answer in near if snap.high < share < after.factor]
            if not above:
                return
            before, missed = self.state(above[0][0], above[0][1].positions), False
            if not self.suspicious(before, after):
                return


def find_snap(
    model: DiscreteShell,
    load: Array,
    before: Array,
    low: float,
    after: Array | None,
    high: float,
    missed: bool = False,
) -> Snap | None:
    """Search for a snap between two fractions of ``load`` along the equilibrium path from the state ``before``.

    ``after`` is the state of DS at the higher one; None where it is not known. ``missed``: whether DS found no
    equilibrium at some load in between.
    """
    jump = 0.0 if after is None else float(np.linalg.norm(after - before, axis=1).max())
    what = f"DS jumps by {jump / model.shell.size:.2g} lengths" + ", and DS finds no equilibrium on the way" * missed
    try:
        path = equilibrium_path(
            model, force=load, begin=low, start=before, until=high, steps=_STEPS, points=_POINTS, branches=1
        )
    except SolverError:  # nothing to begin from: an answer that the path's solver does not confirm
        return Snap(low, high, "the tangent of DS is singular" if after is None else what)
    marks = Marks.of(path)
    if marks.snap is None:
        ends = [one.positions[-1] for one in (path, *path.branches) if one.converged]
        if after is None or any(np.linalg.norm(end - after, axis=1).max() <= _SAME * jump for end in ends):
            return None
        return Snap(low, high, f"DS comes to another branch; {what}", marks)
    how = "a limit point" if marks.limit is not None else "a bifurcation without stable branches"
    if None not in (marks.bifurcation, marks.limit):
        how += f", on a branch that begins at {marks.bifurcation:.4g}"
    return Snap(marks.snap, marks.snap, how if after is None else f"{how}; {what}", marks, stable_states(path))


def stable_states(path: EquilibriumPath) -> tuple[Array, Array]:
    """Load factors (k,) and positions (k, n, 3) [m] of a path, and of its branches, until it turns unstable."""
    routes = [(one, int(np.argmin([*one.stable, False]))) for one in (path, *path.branches)]
    factors = np.concatenate([one.factors[:count] for one, count in routes])
    return factors, np.concatenate([one.positions[:count] for one, count in routes])


def next_to_snap(
    model: DiscreteShell, load: Array, snap: Snap, factors: Sequence[float]
) -> list[tuple[float, Equilibrium]]:
    """Equilibria of DS just below and just above a snap, with their shares of the load.

    None where the snap was not located, and none at loads that are as close to one of ``factors`` or beyond them.
    """
    if snap.stable is None:
        return []
    shares, states = snap.stable
    start, found = states[0], []
    for share in ((1.0 - NEXT_TO_SNAP) * snap.low, (1.0 + NEXT_TO_SNAP) * snap.low):
        if share >= max(factors) or min(abs(share - factor) for factor in factors) < 0.1 * NEXT_TO_SNAP * snap.low:
            continue
        below = np.flatnonzero(shares <= share)
        if share < snap.low and below.size:
            start = states[below[np.argmax(shares[below])]]
        answer = model.equilibrium(force=share * load, start=start)
        if answer.converged:
            found.append((share, answer))
            start = answer.positions
    return found
