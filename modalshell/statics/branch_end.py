"""Where the branch of a static answer ends under a growing load: a walk along it by error bars.

From the corrected answer the load grows in long steps. At each load two mixed Newton steps, and a third by the factor
at hand, lead back to the branch, and the margin ``mu`` is found again (:mod:`modalshell.statics.error_bar`). Near the
end it falls as ``(c - f)^(1/p)``: with p = 2 before a limit point, where the tangent grows without bound, and p = 1
before a bifurcation, which the branch passes at a finite tangent. The exponent for which the last three margins
``mu^p`` lie on a line, between these two, extrapolates to the end ``c`` (theory 14, eq. 6).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple, final

import numpy as np

from modalshell.core.typing import Array
from modalshell.statics.error_bar import ErrorBar, ErrorEstimator
from modalshell.statics.live_loads import LiveLoads

_FARTHEST = 4.0
"""Factor on the load up to which an end is looked for."""
_BEGINNING = 0.25
"""Factor of the first load where the walk begins at rest."""
_LONGEST, _REACH = 1.3, 0.6
"""A load over the last one at most, and the share of the way to the expected end that is walked at once."""
_AT_END = 1.06
"""Expected end over the last load at which the walk is over."""
_HOME = 0.05
"""Third Newton step, over the displacement, above which two steps have not led back to the branch."""
_JUMP, _STIFFEST = 2.0, 0.2
"""Growth of the displacement over that of the load divided by the margin, or by this if it is more, that is a jump."""
_BARS, _POINTS = 2, 24
"""Bars at one load at most, and loads."""
_LIMIT_POINT, _BIFURCATION = 2.0, 1.0
"""Exponents of the margin that fall in proportion to the load."""


class _Point(NamedTuple):
    """A state (n, 3) [m] on the branch, its share of the load, and its margin."""

    factor: float
    margin: float
    positions: Array


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
    walk = _Walk(estimator, load, live)
    start = walk.at(1.0, bar.corrected) if bar.valid else None
    if start is not None:
        walk.points.append(start)
    end, past, lost = np.inf, np.inf, np.inf
    for _ in range(_POINTS):
        last = walk.points[-1].factor
        end = min(extrapolated([(one.factor, one.margin) for one in walk.points]), past)
        if end <= _AT_END * last or last >= _FARTHEST:
            break
        if lost <= _AT_END * last:
            end = lost
            break
        grown = _LONGEST * last if last > 0.0 else _BEGINNING
        factor = min(grown, last + _REACH * (min(end, lost) - last), _FARTHEST)
        point = walk.on(factor)
        if point is None:
            lost = factor
        elif point.margin <= 0.0:
            past = factor
        else:
            lost = np.inf
            walk.points.append(point)
    else:
        return bar
    return replace(bar, critical_load=float(end) if end <= _FARTHEST else np.inf, walked=True)


@final
class _Walk:
    """Points of one branch under a load that grows, from rest."""

    def __init__(self, estimator: ErrorEstimator, load: Array, live: LiveLoads | None) -> None:
        self._estimator, self._load, self._live = estimator, load, live
        self._rest = estimator.shell.rest_positions + estimator.origin
        self.points = [_Point(0.0, 1.0, self._rest)]

    def at(self, factor: float, start: Array) -> _Point | None:
        """The point at a factor near a start (n, 3) [m]; None where bars from it do not come to a state."""
        live = None if self._live is None else self._live.scaled(factor)
        x = start
        for _ in range(_BARS):
            bar = self._estimator.bar(x, factor * self._load, live)
            if bar.message:
                return None
            x = bar.corrected
            moved = self._estimator.length(x - self._rest)
            if self._estimator.length(self._estimator.refined() - x) <= _HOME * moved:
                return _Point(factor, bar.margin, x)
        return None

    def on(self, factor: float) -> _Point | None:
        """The point at a further factor; None where it is not found near the last one."""
        last, start = self.points[-1], self.points[-1].positions
        if len(self.points) > 1:
            before = self.points[-2]
            start = start + (start - before.positions) * (factor - last.factor) / (last.factor - before.factor)
        found = self.at(factor, start)
        if found is not None and last.factor > 0.0:
            expected = (factor / last.factor - 1.0) / max(last.margin, _STIFFEST)
            grown = self._estimator.length(found.positions - last.positions)
            if grown > (_JUMP * expected + 0.1) * self._estimator.length(last.positions - self._rest):
                return None
        return found


def extrapolated(points: Sequence[tuple[float, float]]) -> float:
    """The load at which margins fall to zero, from loads and margins in order; infinity where they do not fall."""
    if len(points) < 2 or not points[-1][1] < points[-2][1]:
        return np.inf
    (before, high), (last, low) = points[-2:]
    power = _exponent(points[-3:]) if len(points) > 2 else _BIFURCATION
    return last + (last - before) * low**power / (high**power - low**power)


def _exponent(points: Sequence[tuple[float, float]]) -> float:
    """The power of three margins that falls in proportion to their loads, between those of the two kinds of ends."""
    (a, first), (b, second), (c, third) = points

    def bend(power: float) -> float:
        """Positive where the margins to this power still fall faster and faster."""
        return (second**power - third**power) * (b - a) - (first**power - second**power) * (c - b)

    low, high = _BIFURCATION, _LIMIT_POINT
    if bend(low) <= 0.0:
        return low
    if bend(high) >= 0.0:
        return high
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if bend(middle) > 0.0 else (low, middle)
    return 0.5 * (low + high)
