"""Events of an equilibrium path: limit points and bifurcations by the inertia of the Hessian, and other branches."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, final

import numpy as np

from modalshell.core.errors import SolverError
from modalshell.core.typing import Array, Progress, unheard
from modalshell.shell import EXACT
from modalshell.statics.bordered import Plane
from modalshell.statics.newton import Matrix, Problem
from modalshell.statics.path import PathPoint, Tracer

LIMIT, BIFURCATION = "limit", "bifurcation"
"""Kinds of events: the load factor turns back, or another branch crosses."""
_CROSSED = 1e-6
"""Share of the critical eigenvalue at a step's ends at which a bifurcation counts as found."""
_NEARBY, _SMALLEST_LOAD, _POINTS = 0.02, 1e-3, 20
"""Longest step of the load in which the end of a branch is looked for, its share and least one; points at most."""
_AWAY = 5
"""Points after which a branch has left the bifurcation that it begins at."""
_FAR = 1e9
"""Length along a null vector that the reach of a step cuts whatever its unit."""
_ASIDE = (0.03, 0.06, 0.12, 0.25, 0.015)
"""Shares of the longest step that the first point of another branch is looked for at."""


class PathEvent(NamedTuple):
    """A marked point of a path.

    Attributes
    ----------
    kind : str
        "limit" where the load factor turns back, "bifurcation" where another branch crosses.
    index : int
        Which point of the path it is.
    factor : float
        Share of the load.
    """

    kind: str
    index: int  # type: ignore[assignment]  # tuple.index is nothing that an event needs
    factor: float


@final
@dataclass
class Trace:
    """A followed path."""

    points: list[PathPoint] = field(default_factory=list)
    """Equilibria in order, events among them."""
    events: list[PathEvent] = field(default_factory=list)
    """Limit points and bifurcations."""
    complete: bool = False
    """Whether the path reached its end: the requested load factor, or for a branch the path that it left."""
    message: str = ""
    """Why it ended elsewhere."""

    def add(self, point: PathPoint, kinds: tuple[str, ...] = ()) -> None:
        """One more point, and what happens there."""
        self.points.append(point)
        self.events += [PathEvent(kind, len(self.points) - 1, point.factor) for kind in kinds]


@final
@dataclass(frozen=True)
class Range:
    """How far a path is followed."""

    until: float
    """Load factor at which it ends."""
    low: float
    high: float
    """Range of load factors; the path ends outside of it."""
    points: int
    """Points at most."""


def follow(
    tracer: Tracer[Matrix],
    first: PathPoint,
    span: Range,
    stop: Callable[[PathEvent], bool] | None = None,
    on_point: Progress = unheard,
    ends: Sequence[PathPoint] = (),
) -> Trace:
    """Follow the path from ``first`` until the load factor of ``span``, or until an event for which ``stop`` holds.

    A branch also ends where it comes to one of the points ``ends``, bifurcations of the path that it has left: through
    them it would continue as its own mirror image, or come round again.
    """
    trace = Trace()
    trace.add(first)
    point = first
    while len(trace.points) < span.points:
        found = tracer.advance(point)
        if found is None:
            trace.message = f"no further equilibrium was found beyond a load factor of {point.factor:.6g}"
            if tracer.control != "arc":
                trace.message += f": {tracer.control} control ends where that turns back; take control='arc'"
            return trace
        known = len(trace.events)
        end = None
        if (point.factor - span.until) * (found.factor - span.until) <= 0.0 and point.factor != span.until:
            end = tracer.at_factor(point, found, span.until)
            found = end or found
        events = events_between(tracer, point, found)
        if not all(passed.located for passed, _ in events) and tracer.retried():
            continue  # a shorter step tells where it is
        for passed, kind in events:
            trace.add(passed, (kind,))
        trace.add(found)
        on_point(len(trace.points), span.points)
        if stop is not None and any(map(stop, trace.events[known:])):
            return trace
        if end is not None:
            trace.complete = True
            return trace
        if len(trace.points) > _AWAY and (met := tracer.passed(point, found, ends)) is not None:
            trace.complete = True
            trace.message = f"the branch joins the path again at its bifurcation at a load factor of {met.factor:.6g}"
            return trace
        if not span.low <= found.factor <= span.high:
            trace.message = f"the path left the load factors {span.low:g} to {span.high:g}"
            return trace
        point = found
    trace.message = f"the path did not reach a load factor of {span.until:g} in {span.points} points"
    return trace


def events_between(
    tracer: Tracer[Matrix], before: PathPoint, after: PathPoint, low: PathPoint | None = None, depth: int = 6
) -> list[tuple[PathPoint, str]]:
    """Limit points and bifurcations of the step from ``before`` to ``after``, from ``low`` on its way, in their order.

    At a limit point the path's direction of load turns back, and one eigenvalue changes its sign; whatever else the
    number of negative eigenvalues changes by is due to bifurcations. Those within one step are separated by
    halving it. Where that does not separate bifurcations they are one, as those of symmetric shells are; where it fails
    with a limit point among them they are said of its end.
    """
    start = low or before
    turned, change = start.sense != after.sense, after.negative - start.negative
    if not turned and change == 0:
        return []
    if turned and abs(change) == 1:
        return [(tracer.locate(before, after, tracer.speed, low=low), LIMIT)]
    if not turned and (abs(change) == 1 or not depth):

        def critical(point: PathPoint) -> float:
            size = abs(critical_mode(tracer, point)[0])
            return size if point.negative == start.negative else -size

        return [(tracer.locate(before, after, critical, _CROSSED, low=low), BIFURCATION)]
    begin = 0.0 if low is None else low.step
    middle = tracer.stepped(before, 0.5 * (begin + after.step)) if depth else None
    if middle is None:
        unknown = replace(after, located=False)
        return [(unknown, LIMIT)] * turned + [(unknown, BIFURCATION)] * (abs(change) > turned)
    first = events_between(tracer, before, middle, low, depth - 1)
    return first + events_between(tracer, before, after, middle, depth - 1)


def critical_mode(tracer: Tracer[Matrix], point: PathPoint) -> tuple[float, Array]:
    """Eigenvalue of the Hessian nearest to zero at a point of a path, and its direction (N,)."""
    return tracer.problem.critical_mode(tracer.problem.loaded(point.factor).linearise(point.x, EXACT)[1])


def branch_end(problem: Problem[Matrix], x: Array, factor: float) -> PathEvent | None:
    """Event that ends the stable branch through ``x`` shortly above a load factor; None if none is located."""
    tracer = Tracer(problem, max(_NEARBY * factor, _SMALLEST_LOAD))
    try:
        first = tracer.first(x, factor, 1.0)
    except SolverError:
        return None
    span = Range(np.inf, -np.inf, np.inf, _POINTS)
    events = follow(tracer, first, span, stop=lambda _: True).events
    return events[0] if events else None


def switched(tracer: Tracer[Matrix], point: PathPoint, side: float) -> PathPoint | None:
    """First point of the branch that crosses at a bifurcation, along its null vector (``side`` 1) or against it.

    The distance along the null vector is prescribed, so that Newton's method cannot fall back on the first branch; None
    where there is no equilibrium at any of the distances that are tried.
    """
    problem = tracer.problem
    try:
        mode = critical_mode(tracer, point)[1]
    except SolverError:
        return None
    mode *= side / problem.length(mode)
    normal = problem.weights * mode
    for share in _ASIDE:
        guess, stresses, cut = problem.moved(point.x, _FAR * mode, share * problem.load_step)
        length = float(normal @ problem.difference(guess, point.x))
        if not length > 0.0 or cut == 1.0:
            continue
        plane = Plane(normal, 0.0, guess, point.factor, length)
        try:
            found = tracer.corrected(guess, point.factor, plane, stresses)
            if found is not None:
                return tracer.assessed(*found, lambda tangent: float(normal @ tangent), 0.0)
        except SolverError:
            continue
    return None
