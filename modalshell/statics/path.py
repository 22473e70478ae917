"""Equilibrium paths through limit points: tangent predictor and corrector in the normal plane.

The corrector is mixed Newton on the bordered problem, so that the steps do not feel the stiffness of the membrane; the
reach of a step is that of the load continuation: a turn of the shell's vertices, or a change of its edges. Every point
has its exact Hessian factorised: the tangent comes from it, and the number of its negative eigenvalues.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Generic, Literal, final

import numpy as np

from modalshell.core.errors import SolverError
from modalshell.core.typing import Array
from modalshell.shell import EXACT
from modalshell.statics.bordered import Bordered, Plane
from modalshell.statics.newton import Matrix, NewtonResult, Problem, mixed_newton

Control = Literal["arc", "load", "displacement"]
"""What grows along a path: its length, the load factor, or the watched displacement."""
CONTROLS: tuple[Control, ...] = ("arc", "load", "displacement")

GOAL = 1e-9
"""Relative residual that points of a path aim at."""
_FEW, _MANY, _LIMIT = 4, 7, 15
"""Newton steps after which the next step of the path is longer, or shorter; and at most."""
_TURN = 0.85
"""Least cosine between the tangents at both ends of a step."""
_OFF = 0.4
"""Largest distance of a point from its prediction, as a share of the step."""
_GROWTH = 1.7
"""Longest step over the one before."""
_RESOLUTION = 0.15
"""Longest step as a share of the distance from the rest shape, unless it is no longer than the first one."""
_SMALLEST = 1e-5
"""Smallest step of a path, relative to the longest."""
_LOCATED = 1e-6
"""Tolerance of a test function's zero, relative to its values at the ends of a step."""
_FOUND = 1e-3
"""Share of them below which the nearest point is still an event."""
_TRIALS = 30
"""Points at most that the search for such a zero takes."""


@final
@dataclass(frozen=True)
class Followable:
    """A model under a load that grows in proportion, as a path is followed in it."""

    problem: Problem[Any]
    """Its statics under the whole load."""
    positions: Callable[[Array], Array]
    """Vertex positions (n, 3) [m] at the problem's unknowns."""
    unknowns: Callable[[Array], Array]
    """Unknowns nearest to some positions."""
    generalised_force: Callable[[Array, Array], Array]
    """Force (N,) on the free unknowns, at some unknowns, of a force (n, 3) on the vertices."""


@final
@dataclass(frozen=True)
class PathPoint:
    """An equilibrium on a path."""

    x: Array = field(repr=False)
    """Unknowns, as the problem has them."""
    factor: float
    """Share of the load."""
    tangent: Array = field(repr=False)
    """Derivative of the free unknowns by the factor; shape (N,)."""
    sense: float
    """1 where the factor grows along the path, -1 where it falls."""
    negative: int
    """Number of negative eigenvalues of the Hessian."""
    residual: float
    """Out-of-balance force over the largest load so far."""
    iterations: int
    """Factorisations that it took."""
    step: float = 0.0
    """Factor by which the tangent at the point before was followed to predict this one."""
    located: bool = True
    """Whether an event was found where it was looked for."""


@final
class Tracer(Generic[Matrix]):
    """Steps along the path of equilibria of one problem.

    Parameters
    ----------
    problem : Problem
        Under the whole load.
    longest : float
        Longest step of the load factor.
    control : {"arc", "load", "displacement"}
        Measure of the steps, which therefore must increase.
    watched : callable, optional
        Gradient (N,) of the watched displacement at some unknowns, for displacement control.
    """

    def __init__(
        self,
        problem: Problem[Matrix],
        longest: float,
        control: Control = "arc",
        watched: Callable[[Array], Array] | None = None,
    ) -> None:
        self.problem, self.longest, self.control, self._watched = problem, longest, control, watched
        self.iterations = 0
        self._weights = problem.weights
        self._largest = longest
        self._trust, self._last, self._first = 1.0, np.inf, np.inf

    # ---- points

    def scale(self, x: Array) -> float:
        """Size of the largest load so far, the scale of residuals."""
        return (self.problem.measure(self.problem.push_at(x)) or 1.0) * self._largest

    def assessed(self, result: NewtonResult, factor: float, before: Callable[[Array], float], step: float) -> PathPoint:
        """The point of a converged result; ``before`` says how far a tangent points along the path until there.

        SolverError where its Hessian is singular to the last bit.
        """
        x = result.point
        hessian = self.problem.loaded(factor).linearise(x, EXACT)[1]
        factored = self.problem.factor(hessian)
        self.iterations += 1
        tangent = factored.solve(self.problem.push_at(x))
        sense = 1.0 if before(tangent) >= 0.0 else -1.0
        self._largest = max(self._largest, abs(factor))
        return PathPoint(
            x, factor, tangent, sense, factored.negative_eigenvalues(), result.residual, result.iterations, step
        )

    def first(self, x: Array, factor: float, sense: float) -> PathPoint:
        """The point at ``factor``, from ``x`` by Newton's method; SolverError if it does not converge."""
        self._largest = max(self._largest, abs(factor))
        result = mixed_newton(self.problem.loaded(factor), x, self.scale(x), goal=GOAL)
        self.iterations += result.iterations
        if not result.converged:
            raise SolverError(f"no equilibrium at a load factor of {factor:g} near the start")
        return self.assessed(result, factor, lambda _: sense, 0.0)

    def unit(self, point: PathPoint) -> Array:
        """Direction of the path (N,) in the free unknowns, its length 1 in the weights."""
        return point.sense * point.tangent / max(self.problem.length(point.tangent), 1e-300)

    def speed(self, point: PathPoint) -> float:
        """Derivative of the factor by the path's length: zero at a limit point."""
        return point.sense / max(self.problem.length(point.tangent), 1e-300)

    # ---- steps

    def corrected(
        self, guess: Array, factor: float, plane: Plane, stresses: list[Array] | None
    ) -> tuple[NewtonResult, float] | None:
        """The equilibrium in a plane, and its factor, by mixed Newton; None if there is none nearby."""
        scale = self.scale(guess)
        bordered = Bordered(self.problem, plane, scale)
        start = bordered.joined(guess, factor)
        result = mixed_newton(bordered, start, scale, limit=_LIMIT, goal=GOAL, stresses=stresses)
        self.iterations += result.iterations
        if not result.converged:
            return None
        x, found = bordered.parts(result.point)
        return NewtonResult(x, result.residual, result.iterations, True), found

    def stepped(self, point: PathPoint, step: float) -> PathPoint | None:
        """The point after ``step`` [of the factor] along the tangent at ``point``; None if none is found."""
        guess, stresses, _ = self.problem.moved(point.x, step * point.tangent)
        factor = point.factor + step
        moved = self.problem.difference(guess, point.x)
        normal, slope = self._weights * self.unit(point), 0.0
        if self.control == "load":
            normal, slope = np.zeros_like(normal), 1.0
        elif self.control == "displacement" and self._watched is not None:
            normal = self._watched(point.x)
        length = abs(float(normal @ moved) + slope * step)
        if not length > 0.0:
            return None
        plane = Plane(normal, slope, guess, factor, length)
        try:
            found = self.corrected(guess, factor, plane, stresses)
            if found is None:
                return None
            before = self._weights * self.unit(point)
            if self.control == "load":
                return self.assessed(*found, lambda _: step, step)
            if self.control == "displacement":
                forward = point.sense * float(normal @ point.tangent)
                return self.assessed(*found, lambda tangent: forward * float(normal @ tangent), step)
            return self.assessed(*found, lambda tangent: float(before @ tangent), step)
        except SolverError:
            return None

    def advance(self, point: PathPoint) -> PathPoint | None:
        """The next point of the path, as far as the solver's success allows; None where the path cannot be followed.

        A step is refused where the path turns sharply in it, ends far from its prediction, or changes the load factor
        against the tangents at both ends: it may have ended on another branch, or have passed two limit points.
        """
        problem = self.problem
        while self._trust >= _SMALLEST:
            reach = self._trust * problem.load_step
            whole = point.sense * self._trust * self.longest
            guess, _, share = problem.moved(point.x, whole * point.tangent, reach)
            # No step is much longer than the one before: short of a limit point a share of the load would lead past it.
            length = abs(share * whole) * self.problem.length(point.tangent)
            far = max(self._first, _RESOLUTION * problem.length(problem.difference(point.x, problem.origin)))
            step = share * whole * min(1.0, min(_GROWTH * self._last, far) / max(length, 1e-300))
            if step != share * whole:
                guess = problem.moved(point.x, step * point.tangent)[0]
            found = self.stepped(point, step)
            if found is None or not self._near(point, found, guess):
                self._trust *= 0.3
                continue
            self._last = problem.length(problem.difference(found.x, point.x))
            if not np.isfinite(self._first):
                self._first = self._last
            if found.iterations <= _FEW:
                self._trust = min(1.0, 1.7 * self._trust)
            elif found.iterations >= _MANY:
                self._trust *= 0.6
            return found
        return None

    def _near(self, point: PathPoint, found: PathPoint, guess: Array) -> bool:
        if point.sense == found.sense and (found.factor - point.factor) * point.sense < 0.0:
            return False
        turned = float(self.unit(point) @ (self._weights * self.unit(found)))
        move = self.problem.length(self.problem.difference(guess, point.x))
        return turned >= _TURN and self.problem.length(self.problem.difference(found.x, guess)) <= _OFF * move

    def passed(self, before: PathPoint, after: PathPoint, points: Sequence[PathPoint]) -> PathPoint | None:
        """The first of some points that lies on the step between two neighbours, as far as its straight line tells."""
        step = self.problem.difference(after.x, before.x)
        length = self.problem.length(step)
        for point in points:
            off = self.problem.difference(point.x, before.x)
            along = min(1.0, max(0.0, float(self._weights * step @ off) / max(length, 1e-300) ** 2))
            if self.problem.length(off - along * step) <= _OFF * length:
                return point
        return None

    def shortened(self) -> None:
        """Make the next step a short one, as after a change of branches."""
        self._trust = min(self._trust, 0.05)

    def retried(self) -> bool:
        """Shorten the next step; return whether that is possible."""
        self._trust *= 0.3
        return self._trust >= _SMALLEST

    def locate(
        self,
        before: PathPoint,
        after: PathPoint,
        test: Callable[[PathPoint], float],
        goal: float = _LOCATED,
        *,
        low: PathPoint | None = None,
    ) -> PathPoint:
        """The point on the step from ``before`` to ``after`` where ``test`` changes its sign, by regula falsi.

        ``low`` is a point of the step before the change. Where points in between cannot be found, the one of them, or
        of the ends, at which ``test`` is least: far from the change, it is marked as ``located=False``.
        """
        start = low or before
        near, far = 0.0 if low is None else low.step, after.step
        below, above = test(start), test(after)
        size = max(abs(below), abs(above))
        best, least = (start, abs(below)) if abs(below) < abs(above) else (after, abs(above))
        for _ in range(_TRIALS):
            if least <= goal * size or below * above > 0.0:
                break
            middle = far - above * (far - near) / (above - below)
            point = self.stepped(before, middle)
            if point is None:
                middle = 0.5 * (near + far)
                point = self.stepped(before, middle)
                if point is None:
                    break
            value = test(point)
            if abs(value) < least:
                best, least = point, abs(value)
            if value * above <= 0.0:
                near, below = far, above
            else:
                below *= 0.5  # the Illinois rule: the end that stays counts half
            far, above = middle, value
        return best if least <= max(goal, _FOUND) * size else replace(best, located=False)

    def at_factor(self, before: PathPoint, after: PathPoint, factor: float) -> PathPoint | None:
        """The point between two neighbours at a load factor, exactly; None if it is not found."""
        near = self.locate(before, after, lambda point: point.factor - factor, 1e-3)
        guess, stresses, _ = self.problem.moved(near.x, (factor - near.factor) * near.tangent)
        plane = Plane(np.zeros(near.tangent.size), 1.0, guess, factor, self.longest)
        try:
            found = self.corrected(guess, factor, plane, stresses)
            if found is None:
                return None
            direction = self._weights * self.unit(near)
            return self.assessed(found[0], factor, lambda tangent: float(direction @ tangent), near.step)
        except SolverError:
            return None
