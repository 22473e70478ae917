"""Paths of equilibria with contacts, by steps of the load: what touches may change from one to the next."""

from __future__ import annotations

from typing import NamedTuple, final

import numpy as np

from modalshell.contact.active_set import DIRECT, ActiveSet, Rest
from modalshell.contact.statics import rest_on_contacts
from modalshell.contact.touching import Touching
from modalshell.core.errors import SolverError
from modalshell.core.typing import Array, Mask, Progress
from modalshell.statics import mixed_newton as method
from modalshell.statics.bifurcation import BIFURCATION, Trace
from modalshell.statics.newton import rules_of
from modalshell.statics.path import PathPoint
from modalshell.statics.potential import Potential

_FAR = 0.1
"""Largest move of a vertex in a step, as a share of the shell's size: beyond, another branch may have been met."""
_SMALLEST = 1e-4
"""Smallest step over the longest."""
_EASY = 6
"""Iterations up to which the next step is twice as long."""


class TouchingPoint(NamedTuple):
    """A point of a path, and what touches there."""

    point: PathPoint
    rest: Rest
    """Where its solve ended, with the rows that touch and their forces."""


@final
class LoadSteps:
    """Follows equilibria of a shell with contacts under a load whose factor grows by steps of ``longest`` at most.

    Each begins at the one before, with what touched there. A step is halved where Newton's method does not converge,
    leads a vertex through a collider, or far away. ``problem`` is the potential under the whole load.
    """

    def __init__(self, problem: Potential, touching: Touching, longest: float) -> None:
        self._problem, self._touching, self._longest = problem, touching, longest
        self._scale = problem.measure(problem.push)
        self.iterations = 0

    def _solver(self, factor: float) -> ActiveSet:
        return ActiveSet(self._problem.loaded(factor), self._touching, self._scale)

    def first(self, x: Array, factor: float) -> TouchingPoint:
        """The point at a factor, from x (n, 3); SolverError if there is none."""
        rest = rest_on_contacts(self._problem.loaded(factor), self._touching, x)
        if not rest.converged:
            raise SolverError(f"no equilibrium with contacts at a load factor of {factor:g} near the start")
        return self._point(rest, factor)

    def _point(self, rest: Rest, factor: float) -> TouchingPoint:
        negative, self.iterations = 0, self.iterations + rest.iterations + 1
        if not rest.stable:
            negative = self._solver(factor).negative_eigenvalues(rest)
        none = np.zeros(self._problem.shell.unknowns.count)
        point = PathPoint(rest.point, factor, none, 1.0, negative, rest.residual, rest.iterations)
        return TouchingPoint(point, rest)

    def stepped(self, before: TouchingPoint, factor: float) -> TouchingPoint | None:
        """The point at a factor next to another one; None if there is none."""
        solver, x = self._solver(factor), before.point.x
        active: Mask = before.rest.active | solver.near(x)
        rest = solver.iterate(x, active, rules_of(self._problem, method.GOAL, DIRECT))
        move = float(np.sqrt(np.sum((rest.point - x) ** 2, axis=1)).max())
        if not rest.converged or move > _FAR * self._touching.size or self._touching.crossed(x, rest.point):
            self.iterations += rest.iterations
            return None
        try:
            return self._point(solver.settled(rest), factor)
        except SolverError:
            return None

    def follow(self, first: TouchingPoint, until: float, points: int, on_point: Progress) -> tuple[Trace, list[Rest]]:
        """The path from a point to the factor ``until``, and where the solve of each of its points ended."""
        trace, rests, present, share = Trace(), [first.rest], first, 1.0
        trace.add(first.point)
        sense = 1.0 if until > first.point.factor else -1.0
        while (left := abs(until - present.point.factor)) > 0.0 and len(trace.points) < points:
            step = min(share * self._longest, left)
            factor = until if step == left else present.point.factor + sense * step
            found = self.stepped(present, factor)
            if found is None:
                share *= 0.5
                if share < _SMALLEST:
                    trace.message = (
                        f"load steps with contacts end at a load factor of {present.point.factor:.6g}: there is no "
                        "equilibrium near it under more load, as at a limit point, where the shell snaps"
                    )
                    return trace, rests
                continue
            kinds: tuple[str, ...] = ()
            if found.point.negative != present.point.negative and step > _SMALLEST * self._longest:
                found, kinds = self._change(present, found), (BIFURCATION,)
            trace.add(found.point, kinds)
            rests.append(found.rest)
            on_point(len(trace.points), points)
            easy = found.point.iterations <= _EASY
            present, share = found, min(1.0, 2.0 * share) if easy else share
        trace.complete = present.point.factor == until
        if not trace.complete:
            trace.message = f"{points} points did not reach a load factor of {until:g}: allow more"
        return trace, rests

    def _change(self, before: TouchingPoint, after: TouchingPoint) -> TouchingPoint:
        """The first point found after a change of stability, by halving the step to it."""
        while abs(after.point.factor - before.point.factor) > _SMALLEST * self._longest:
            middle = self.stepped(before, 0.5 * (before.point.factor + after.point.factor))
            if middle is None:
                break
            if middle.point.negative == before.point.negative:
                before = middle
            else:
                after = middle
        return after
