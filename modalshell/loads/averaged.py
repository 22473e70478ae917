"""Factors of loads as steps take them at their ends.

Where a table of factors bends, or jumps, within steps, its value at their ends says nothing of that. Its mean there,
weighted by one over a step to each side and falling in a straight line from the end itself, keeps the impulse of the
load and when it comes, to second order in the step. Where tables bend at ends of steps alone, and do not jump, their
values serve, to the last bit. Of other tables all are means, at the ends where they bend, too: a slope that begins by a
mean and ends by a value has an impulse that is off by a sixth of its rise in a step. The mean at the start has no other
side that makes up for a slope: the straight part of a rise from there is taken as it is, however finely its table has
it, and its impulse is kept where that rise ends. Rules of order one take plain means over their steps
instead.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence
from itertools import chain, pairwise
from math import sqrt

_NEAR = 1e-6
"""Share of a step within which a bend is at the end of one."""
_JUMP = 1e-4
"""Share of the factors about by which one jumps there."""
_GAUSS = 0.5 / sqrt(3.0)
"""Points of Gauss from the middle of an interval, in its lengths: exact for two tables' product under the weight."""


def averaged(
    factor: Callable[[float], float], bends: Sequence[float], dt: float, *, within: bool = False
) -> Callable[[float], float]:
    """The factor as steps take it at their ends, or at those of their parts.

    Parameters
    ----------
    factor : callable
        Of the time [s].
    bends : sequence of float
        Times [s] at which it bends or jumps.
    dt : float
        The step [s], from time 0 on.
    within : bool
        Take plain means over the steps that end there, for rules of order one.
    """
    places, near = sorted(set(bends)), _NEAR * dt
    turns, rises = _rise(factor, places, near)
    values_serve = not within and _bends_at_ends(factor, places, dt)

    def rise(end: float) -> float:
        """Slope [1/s] of the rise from the start, in the step before its ``end``."""
        return rises[bisect_left(turns, end - near)]

    def within_step(end: float, inward: float) -> float:
        """Factor at an ``end`` of a step; where it jumps there, that ``inward`` [s] of it."""
        value = factor(end)
        if bisect_left(places, end - near) == bisect_right(places, end + near):
            return value
        inner = factor(end + inward)
        return inner if abs(inner - value) > _JUMP * max(abs(inner), abs(value)) else value

    def at_end(time: float) -> float:
        first = time <= near
        low, high = time if first else time - dt, time if within else time + dt
        inside = places[bisect_right(places, low - near if first else low + near) : bisect_left(places, high - near)]
        if not inside:
            return 0.5 * (within_step(low, near) + within_step(time, -near)) if within else factor(time)
        if not within and values_serve:
            return factor(time)
        marks, total = sorted({low, time, high, *(bend for bend in inside if bend > low)}), 0.0
        for begin, end in pairwise(marks):
            for point in (0.5 - _GAUSS, 0.5 + _GAUSS):
                at = begin + point * (end - begin)
                total += 0.5 * (end - begin) * (1.0 if within else 1.0 - abs(at - time) / dt) * factor(at)
        if within:
            return total / (high - low)
        mean = 2.0 * total / (high - low)
        return mean - dt / 3.0 * rise(high) if first else mean - dt / 6.0 * (rise(high) - rise(time))

    return at_end


def _bends_at_ends(factor: Callable[[float], float], places: Sequence[float], dt: float) -> bool:
    """Whether a factor bends at ends of steps alone, and jumps nowhere."""
    near = _NEAR * dt
    if any(abs(place - dt * round(place / dt)) > near for place in places):
        return False
    sides = [(factor(place - near), factor(place + near)) for place in places]
    size = max((abs(one) for one in chain(*sides)), default=0.0)
    return all(abs(after - before) <= _JUMP * size for before, after in sides)


def _rise(factor: Callable[[float], float], places: Sequence[float], near: float) -> tuple[list[float], list[float]]:
    """Least slope that all has had from the start on, one way: times [s] up to which it is which [1/s], and 0 then."""
    turns: list[float] = []
    slopes: list[float] = []
    last, before = near, factor(near)
    for place in places[bisect_right(places, near) :]:
        value = factor(place)
        slope = (value - before) / (place - last)
        if slopes:
            slope = min(slopes[-1], slope, key=abs) if slope * slopes[-1] > 0.0 else 0.0
        if not slope:
            break
        turns.append(place)
        slopes.append(slope)
        last, before = place, value
    return turns, [*slopes, 0.0]
