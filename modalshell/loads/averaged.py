"""Factors of loads as steps feel them, where a table of factors bends or jumps within steps.

The ends of a step alone say nothing of a bend or jump between them. A rule of order two feels a straight line over such
a step, with what the table has more than the line through its values added to the line's ends, so that the impulse of
the load and when it comes are kept: a free body is, from the next end but one on, where the table itself takes it. What
is added to an end is felt in the steps on both its sides. Elsewhere tables are felt as they are, to the last bit. Rules
of order one take plain means over their steps instead.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import pairwise
from math import ceil, sqrt

_NEAR = 1e-6
"""Share of a step within which a bend is at the end of one."""
_JUMP = 1e-4
"""Share of the factors about by which one jumps there."""
_GAUSS = 0.5 / sqrt(3.0)
"""Points of Gauss from the middle of an interval, in its lengths: exact for two tables' product under the weight."""
_NONE = 0.0, 0.0


def averaged(
    factor: Callable[[float], float], bends: Sequence[float], dt: float, *, within: bool = False
) -> Callable[[float], float]:
    """The factor as steps of ``dt`` [s], from time 0 on, take it at their ends, or at those of their parts.

    ``factor`` is a function of the time [s], and ``bends`` are the times [s] at which it bends or jumps. With
    ``within``, for rules of order one, plain means over the steps that end there are taken.
    """
    places, near = sorted(set(bends)), _NEAR * dt
    return _means(factor, places, dt, near) if within else _lines(factor, places, dt, near)


def _lines(factor: Callable[[float], float], places: list[float], dt: float, near: float) -> Callable[[float], float]:
    """The factor, with straight lines over the steps within which it bends or jumps."""

    @lru_cache(maxsize=4)
    def value(step: int) -> tuple[float, bool]:
        """Factor at the end of a step, the mean of both sides where it jumps there; and whether it does."""
        end = step * dt
        if bisect_right(places, end + near) - bisect_left(places, end - near) > 1:  # a jump has two knots
            before, after = factor(end - near), factor(end + near)
            if abs(after - before) > _JUMP * max(abs(before), abs(after)):
                return 0.5 * (before + after), True
        return factor(end), False

    @lru_cache(maxsize=4)
    def added(step: int) -> tuple[float, float] | None:
        """What the line over a step has more at its ends than the factor; None where that is straight."""
        low, high = (step - 1) * dt, step * dt
        if step < 1:
            return None
        (first, jumps), (last, jumps_last) = value(step - 1), value(step)
        bends = bisect_right(places, low + near) < bisect_left(places, high - near)
        if not (bends or jumps or jumps_last):
            return None
        area = moment = 0.0
        inside = places[bisect_right(places, low) : bisect_left(places, high)]
        for begin, end in pairwise([low, *inside, high]):
            for point in (0.5 - _GAUSS, 0.5 + _GAUSS):
                at = begin + point * (end - begin)
                share = (at - low) / dt
                more = 0.5 * (end - begin) / dt * (factor(at) - first - share * (last - first))
                area, moment = area + more, moment + share * more
        # The start of the first step has no step before it that would feel it, too.
        return (3.0 * (area - moment), 0.5 * (3.0 * moment - area)) if step == 1 else (area - moment, moment)

    def at_time(time: float) -> float:
        step = max(1, ceil(time / dt - _NEAR))
        before, here, after = added(step - 1), added(step), added(step + 1)
        if before is here is after is None:
            return factor(time)
        left = step - time / dt if step - time / dt > _NEAR else 0.0
        begin = (before or _NONE)[1] + (here or _NONE)[0]
        end = (here or _NONE)[1] + (after or _NONE)[0]
        straight = factor(time) if here is None else left * value(step - 1)[0] + (1.0 - left) * value(step)[0]
        return straight + left * begin + (1.0 - left) * end

    return at_time


def _means(factor: Callable[[float], float], places: list[float], dt: float, near: float) -> Callable[[float], float]:
    """Plain means of the factor over the steps that end at a time."""

    def inner(end: float, inward: float) -> float:
        """Factor at an ``end`` of a step; where it jumps there, that ``inward`` [s] of it."""
        value = factor(end)
        if bisect_left(places, end - near) == bisect_right(places, end + near):
            return value
        found = factor(end + inward)
        return found if abs(found - value) > _JUMP * max(abs(found), abs(value)) else value

    def mean(time: float) -> float:
        low = time - dt if time > near else time
        inside = places[bisect_right(places, low + near) : bisect_left(places, time - near)]
        if not inside:
            return 0.5 * (inner(low, near) + inner(time, -near))
        total = 0.0
        for begin, end in pairwise([low, *inside, time]):
            for point in (0.5 - _GAUSS, 0.5 + _GAUSS):
                total += 0.5 * (end - begin) * factor(begin + point * (end - begin))
        return total / (time - low)

    return mean
