"""Where the branch of a static answer ends under a growing load: a walk along it by error bars.

From the corrected answer the walk follows the branch itself, so that the load factor is an unknown (theory 8, eq. 5 and
6): each step leads to a plane across it by mixed Newton steps, which bars take two of (theory 14, eq. 2), and has its
stability margin (eq. 4). Along the branch the margin falls to zero about in proportion, at limit points and at
bifurcations alike, so that the last two tell where the walk will pass the end; between the points on either side of it
the end lies. A margin that only comes near to zero, as where a bifurcation is blurred by an imperfection, is passed by.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple, final

import numpy as np

from modalshell.core.errors import SolverError
from modalshell.core.typing import Array
from modalshell.shell import GAUSS_NEWTON, MIXED
from modalshell.statics.bordered import Bordered, Plane
from modalshell.statics.error_bar import ErrorBar, ErrorEstimator
from modalshell.statics.live_loads import LiveLoads

_FARTHEST = 4.0
"""Factor on the load up to which an end is looked for."""
_BEGINNING, _GROWN = 0.25, 0.3
"""Growth of the load in the first step from rest, and in others as a share of it, where the tangent predicts that."""
_MOVED, _LONGER = 0.5, 3.0
"""Length of a step over the displacement, and over the one before, at most."""
_PAST, _WITHIN = 1.15, 0.6
"""Length of a step that is to pass the end, over the expected way there; and of one whose reach is short of that."""
_HOME, _CORRECTIONS, _SLOW = 0.02, 7, 0.7
"""Last Newton step over the length of the walk's at which a point is found, Newton steps at most, and the ratio of two
that do not converge."""
_OFF, _SHORTER = 0.4, 0.35
"""Distance from the prediction, over the length of a step, from which it is refused, and the factor on the next one."""
_LEAST_LENGTH = 1e-4
"""Length of a step over the displacement at which the walk gives up."""
_BENT, _LOOKS = 0.15, 3
"""Share of a margin's fall that was not predicted from which a crossing of zero is looked at again, and how often."""
_AT_END = 0.06
"""Growth of the load to the expected end within which that is taken where the walk has ended without passing it."""
_SETTLED = 1e-2
"""Size of Newton's steps over the shell's at which a stressed shell counts as in balance without load."""
_POINTS = 40


class _Point(NamedTuple):
    """A state on the branch.

    Positions (n, 3) [m] about the origin, the factor on the load, the margin, the direction of the branch (N,) of
    length 1 in the weights of the unknowns, the factor's derivative along it, and how far along the branch the state
    is.
    """

    x: Array
    factor: float
    margin: float
    way: Array
    speed: float
    along: float


def with_branch_end(estimator: ErrorEstimator, bar: ErrorBar, load: Array, live: LiveLoads | None = None) -> ErrorBar:
    """The bar of an answer with the factor on its load at which its branch ends, infinite if that is not below 4.

    A walk that comes to no end leaves the bar as it is.

    Parameters
    ----------
    estimator : ErrorEstimator
        That of the shell.
    bar : ErrorBar
        The bar. The walk begins at its corrected answer, or where it is void at rest, so that it may end below 1.
    load, live
        The load at a factor of 1, as in :meth:`ErrorEstimator.bar`.
    """
    try:
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            end = _Walk(estimator, load, live).end(bar)
    except SolverError:
        end = None
    if end is None:
        return bar
    return replace(bar, critical_load=end if end <= _FARTHEST else np.inf, walked=True)


@final
class _Walk:
    """Points of one branch under a load that grows, from rest."""

    def __init__(self, estimator: ErrorEstimator, load: Array, live: LiveLoads | None) -> None:
        self._estimator, self._problem = estimator, estimator.problem(load, live)
        self._weights = self._problem.weights
        self._points: list[_Point] = []

    def end(self, bar: ErrorBar) -> float | None:
        """The factor at which the branch ends, infinite beyond the farthest; None where the walk comes to no end."""
        rest = self._rest()
        if rest is None:
            return np.inf
        points = self._points = [rest]
        if bar.valid and (start := self._start(bar.corrected - self._estimator.origin)) is not None:
            points.append(start)
        longest, most, looks, first = np.inf, np.inf, 0, 0.0
        while len(points) <= _POINTS:
            last = points[-1]
            if last.factor >= _FARTHEST:
                return np.inf
            if len(points) > 1 and (last.margin <= 0.0 or last.speed <= 0.0):
                return end_between(points[-2:])
            length = min(self._length_of_step(longest), most)
            found, length = self._stepped(length)
            most, first = np.inf, first or length
            if found is None or self._strays(found):
                if length < _LEAST_LENGTH * max(self._moved(last.x), first):
                    break
                most = longest = _SHORTER * length
            elif looks < _LOOKS and not predicted([*points[-2:], found]):
                looks += 1
                most = longest = (found.along - last.along) * last.margin / (last.margin - found.margin)
            else:
                longest, looks = _LONGER * (found.along - last.along), 0
                points.append(found)
        gain = points[-1].speed * way_to_end(points[-2:])
        return points[-1].factor + 0.5 * gain if gain <= _AT_END * points[-1].factor else None

    def _strays(self, found: _Point) -> bool:
        """Whether a point is on another branch: the load falls where the branch rises, or its end is seen from rest.

        From rest there is no margin to predict an end by; a shorter step finds the branch before it.
        """
        points = self._points
        falls = found.speed > 0.0 and found.factor <= points[-1].factor
        return falls or (len(points) == 1 and (found.margin <= 0.0 or found.speed <= 0.0))

    def _rest(self) -> _Point | None:
        """The state without load; None if nothing moves it, SolverError where none is found of a stressed shell."""
        problem = self._problem
        if problem.shell.stressed:
            size = _SETTLED * problem.shell.mesh.moment_length * float(np.sqrt(self._weights.sum()))
            found = self._under_load(problem.origin, 0.0, size)
            if found is None or found.margin <= 0.0:
                raise SolverError("a shell under stress has no stable state near rest")
            return found
        stiffness = problem.linearise(problem.origin, GAUSS_NEWTON)[1]
        tangent = problem.factor(stiffness).solve(problem.push)
        length = problem.length(tangent)
        return _Point(problem.origin, 0.0, 1.0, tangent / length, 1.0 / length, 0.0) if length > 0.0 else None

    def _start(self, x: Array) -> _Point | None:
        """The state under the load, from x (n, 3) nearby; None where Newton's steps do not come to one."""
        found = self._under_load(x, 1.0, self._moved(x))
        return None if found is None else found._replace(along=self._moved(found.x))

    def _under_load(self, x: Array, factor: float, length: float) -> _Point | None:
        """The state under a factor on the load, from x (n, 3) nearby, by Newton's steps of up to a length."""
        return self._found(x, factor, Plane(np.zeros(self._weights.size), 1.0, x, factor, length), None)

    def _length_of_step(self, longest: float) -> float:
        """Length of the next step: past the end where that is within reach."""
        last = self._points[-1]
        if last.factor > 0.0:
            reach = min(_GROWN * last.factor / abs(last.speed), _MOVED * self._moved(last.x), longest)
        else:
            reach = min(_BEGINNING / abs(last.speed), longest)
        way = way_to_end(self._points[-2:])
        return _PAST * way if reach > way else min(reach, _WITHIN * way) if 2.0 * reach > way else reach

    def _stepped(self, length: float) -> tuple[_Point | None, float]:
        """The point after a step of a length, which the turn of the shell bounds; None where none is found near."""
        problem, last = self._problem, self._points[-1]
        guess, stresses, share = problem.moved(last.x, length * last.way)
        length *= share
        plane = Plane(self._weights * last.way, 0.0, guess, 0.0, length)
        try:
            found = self._found(guess, last.factor + length * last.speed, plane, stresses)
        except SolverError:
            found = None
        if found is not None:
            found = found._replace(along=last.along + problem.length(problem.difference(found.x, last.x)))
        return found, length

    def _found(self, x: Array, factor: float, plane: Plane, stresses: list[Array] | None) -> _Point | None:
        """The state in a plane near x (n, 3) and a factor, by mixed Newton steps."""
        problem = self._problem
        scale = (problem.measure(problem.push_at(x)) or 1.0) * (abs(factor) or 1.0)
        bordered = Bordered(problem, plane, scale)
        point, before = bordered.joined(x, factor), np.inf
        for count in range(_CORRECTIONS):
            gradient, hessian = bordered.linearise(point, GAUSS_NEWTON if stresses is None else MIXED, stresses)
            factored = bordered.factor(hessian)
            step = factored.solve(-gradient)
            point, stresses, _ = bordered.moved(point, step)
            size = problem.length(step[:-1])
            if not np.isfinite(point).all() or (count > 1 and size > _SLOW * before):
                return None
            if count > 0 and size <= _HOME * plane.length:
                break
            before = size
        else:
            return None
        x, factor = bordered.parts(point)
        if plane.slope == 0.0 and problem.length(problem.difference(x, plane.x)) > _OFF * plane.length:
            return None
        ahead = factored.solve(np.append(np.zeros(self._weights.size), scale))  # as far as the plane is moved
        length = problem.length(ahead[:-1])
        margin = self._estimator.margin(problem.loaded(factor), x, stresses).value
        return _Point(x, factor, margin, ahead[:-1] / length, float(ahead[-1]) / length, 0.0)

    def _moved(self, x: Array) -> float:
        return self._problem.length(self._problem.difference(x, self._problem.origin))


def way_to_end(points: Sequence[_Point]) -> float:
    """Length of the branch from the last of two points to where the margin is zero in a line; infinite if it grows."""
    if len(points) < 2 or not points[1].margin < points[0].margin:
        return np.inf
    before, last = points
    return last.margin * (last.along - before.along) / (before.margin - last.margin)


def predicted(points: Sequence[_Point]) -> bool:
    """Whether a margin that has fallen below zero lies in a line with the two before, or a limit point was passed.

    Else the last step may have crossed to a branch that comes near.
    """
    last = points[-1]
    if len(points) < 3 or last.margin > 0.0 or last.speed <= 0.0:
        return True
    first, before, _ = points
    slope = (before.margin - first.margin) / (before.along - first.along)
    expected = before.margin + slope * (last.along - before.along)
    return abs(last.margin - expected) <= _BENT * (before.margin - last.margin)


def end_between(points: Sequence[_Point]) -> float:
    """The factor where the margin is zero between two points, by the cubic through their factors and slopes.

    It is no lower than that of the first, and no higher than the branch would come that rises as there.
    """
    before, last = points
    share = 1.0 if last.margin > 0.0 else before.margin / (before.margin - last.margin)
    length, rest = last.along - before.along, 1.0 - share
    ends = rest**2 * (1.0 + 2.0 * share) * before.factor + share**2 * (3.0 - 2.0 * share) * last.factor
    cubic = ends + length * share * rest * (rest * before.speed - share * last.speed)
    most = before.factor + share * length * max(before.speed, last.speed)
    return min(max(cubic, before.factor), most)
