"""Newton iteration with projected and exact Hessians, shared by full and reduced problems.

A nearly inextensible sheet defeats plain Newton: a step along the tangent stretches the membrane by its square, so a
line search lets only tiny steps through. The mixed step [magisano2017] treats the element stresses as unknowns of
their own: after elimination the equations are Newton's, but the geometric part of the Hessian takes each stress from
the last linearised step instead of the (huge) stress of the over-stretched iterate. Full steps then converge in a few
iterations whatever the membrane stiffness.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import ClassVar, Generic, Protocol, Self, TypeVar

import numpy as np

from modalshell.core.errors import SolverError
from modalshell.core.typing import Array
from modalshell.shell import EXACT, GAUSS_NEWTON, MIXED
from modalshell.statics.verdict import ACCEPTED

GOAL = 1e-10
"""Relative residual that is aimed at."""

_LINEAR = 0.3
"""Residual of linear equations that a kept factor solves, at most: over the gradient, and over the goal."""

Matrix = TypeVar("Matrix")


class Factored(Protocol):
    """A factorised symmetric matrix, sparse or dense."""

    def solve(self, right_side: Array) -> Array:
        """Solution (N,) for a right side (N,)."""

    def is_definite(self) -> bool:
        """Whether the matrix is positive definite."""

    def negative_eigenvalues(self) -> int:
        """Number of negative eigenvalues; SolverError where the factors do not show it."""


@dataclass
class NewtonResult:
    """Where a solver ended.

    Attributes
    ----------
    point : ndarray
        Last (or best) iterate: positions (n, 3) [m] of a full problem, coordinates (r,) of a reduced one.
    residual : float
        Size of the gradient over that of the load.
    iterations : int
        Newton's, each with a factorisation or a kept factor.
    converged : bool
        Whether the residual met :data:`ACCEPTED`, or :meth:`Problem.rounding` with Newton's steps at their end.
    factor : Factored or None
        Of the last Hessian, a step before the end; of the one at the end where :func:`is_minimum` has found it so.
    stable : bool or None
        Whether the exact Hessian at the end is positive definite; None if unknown.
    limited : bool
        Whether rounding keeps the residual above :data:`ACCEPTED`.
    left_saddle : bool
        Whether the iteration passed a saddle and left it along its unstable mode to the lower side.
    path : list
        Shares of the load, and unknowns, of the states on the way from rest.
    jumps : list
        What ended the branches that the way from rest left by a jump, and at which shares of the load.
    factored_at : ndarray or None
        Where the Hessian of ``factor`` is, as :func:`mixed_newton` leaves it.
    """

    point: Array
    residual: float
    iterations: int
    converged: bool
    factor: Factored | None = None
    stable: bool | None = None
    limited: bool = False
    left_saddle: bool = False
    path: list[tuple[float, Array]] = field(default_factory=list)
    jumps: list[tuple[str, float]] = field(default_factory=list)
    factored_at: Array | None = None


@dataclass(frozen=True)
class Problem(ABC, Generic[Matrix]):
    """A potential ``E(x) + u.Q u / 2 - b.u`` with ``u = x - origin``, and the algebra of its unknowns.

    Parameters
    ----------
    load : ndarray
        b, of the shape of x.
    origin : ndarray
        Where the quadratic part is centred; rest in statics.
    quadratic : ndarray, optional
        Q, inertia and damping of an implicit step; statics has none.
    """

    load: Array
    origin: Array
    quadratic: Array | None = field(default=None, kw_only=True)

    load_step: ClassVar[float]
    """Reach of the longest step that a growing load may predict."""
    path_goal: ClassVar[float]
    """Relative residual that load steps before the last aim at."""
    snaps: ClassVar[int]
    """Number of ends of branches after which the potential is minimised under the whole load at once."""

    @property
    def push(self) -> Array:
        """Load (N,) on the free unknowns."""
        return self.load

    @property
    def is_dead(self) -> bool:
        """Whether the load leaves the Hessian alone."""
        return True

    @property
    def weights(self) -> Array:
        """Weight (N,) of each free unknown in the squared length of a step."""
        return np.ones(self.push.size)

    def push_at(self, x: Array) -> Array:  # noqa: ARG002 (of loads whose work is not linear in x)
        """Load (N,) on the free unknowns at ``x``: what a growing load adds to minus the gradient."""
        return self.push

    def difference(self, x: Array, y: Array) -> Array:
        """``x - y`` on the free unknowns (N,)."""
        return (x - y).ravel()

    @abstractmethod
    def critical_mode(self, hessian: Matrix) -> tuple[float, Array]:
        """Eigenvalue of a Hessian nearest to zero, over :attr:`weights`, and its direction (N,)."""

    @abstractmethod
    def linearise(self, x: Array, geometric: int, stresses: list[Array] | None = None) -> tuple[Array, Matrix]:
        """Gradient (N,) and Hessian on the free unknowns."""

    @abstractmethod
    def factor(self, hessian: Matrix) -> Factored:
        """Factor of a Hessian, definite or not; SolverError if it is singular."""

    @abstractmethod
    def moved(self, x: Array, direction: Array, reach: float | None = None) -> tuple[Array, list[Array], float]:
        """Unknowns and predicted stresses after a step along ``direction`` (N,), and the step's fraction of it.

        ``reach`` is the largest rotation [rad], or relative change of an edge, of the step.
        """

    @abstractmethod
    def descend(self, start: Array, scale: float) -> NewtonResult:
        """Go downhill to a minimum."""

    def residual(self, x: Array) -> Array:
        """Gradient (N,) on the free unknowns."""
        return self.linearise(x, GAUSS_NEWTON)[0]

    def definite_factor(self, hessian: Matrix) -> Factored | None:
        """Factor of a positive definite Hessian, None for any other."""
        factor = self.factor(hessian)
        return factor if factor.is_definite() else None

    def step(self, factor: Factored, gradient: Array) -> Array:
        """Newton direction (N,); SolverError if there is none."""
        return factor.solve(-gradient)

    def direction(
        self,
        hessian: Matrix,
        gradient: Array,
        kept: Factored | None,  # noqa: ARG002 (for sparse problems)
        accuracy: float,  # noqa: ARG002
    ) -> tuple[Factored, Array]:
        """Newton direction (N,) and the factor that it took: a new one, or ``kept`` where that gives it as well.

        ``accuracy`` is the residual of the linear equations, over the gradient, that serves; SolverError if there is
        no direction.
        """
        factor = self.factor(hessian)
        return factor, self.step(factor, gradient)

    def keeps_factor(self, length: float) -> bool:  # noqa: ARG002 (of problems whose factors are dear)
        """Whether the factor of a Hessian serves for another, where no unknown differs by ``length``."""
        return False

    def measure(self, force: Array) -> float:
        """Size of a force (N,) on the free unknowns."""
        return float(np.linalg.norm(force))

    def rounding(self, x: Array, hessian: Matrix, length: float) -> float:  # noqa: ARG002 (for sparse problems)
        """Size of the residual due to rounding after a step that moved no unknown by more than ``length``."""
        return 0.0

    def scale_at(self, start: Array | None) -> float:
        """Scale of residuals: the load's size, or without a load that of the forces at the start."""
        size = self.measure(self.push)
        return size or (0.0 if start is None else self.measure(self.residual(start))) or 1.0

    def loaded(self, share: float) -> Self:
        """The same problem under a share of the load."""
        return replace(self, load=share * self.load)

    def _outer(self, x: Array) -> tuple[float, Array]:
        u = x - self.origin
        pull = -self.load if self.quadratic is None else self._product(self.quadratic, u) - self.load
        return 0.5 * float(np.vdot(u, pull - self.load)), pull

    def _product(self, quadratic: Array, u: Array) -> Array:
        return np.asarray(quadratic @ u)


def mixed_newton(
    problem: Problem[Matrix],
    start: Array,
    scale: float,
    *,
    limit: int = 40,
    goal: float = GOAL,
    stresses: list[Array] | None = None,
) -> NewtonResult:
    """Full mixed Newton steps from ``start``; gives up when the residual stops falling.

    ``stresses`` are those predicted with ``start``; without them the first step leaves the geometric part out.
    """
    x = start
    best = NewtonResult(start, np.inf, 0, False)
    stalled, length, last, keeping = 0, np.inf, np.inf, True
    for iteration in range(limit + 1):
        gradient, hessian = problem.linearise(x, GAUSS_NEWTON if stresses is None else MIXED, stresses)
        residual = problem.measure(gradient) / scale
        if not np.isfinite(residual):
            break
        if residual < best.residual:
            stalled = stalled + 1 if residual > 0.5 * best.residual else 0
            accepted = max(ACCEPTED, goal)
            if iteration == 0 and problem.quadratic is not None:
                accepted = GOAL  # a step must be taken, or a small load on a fast shell would never act
            best = NewtonResult(x, residual, iteration, residual <= accepted, best.factor, factored_at=best.factored_at)
        else:
            stalled += 1
        allowed = problem.rounding(x, hessian, length) / scale
        if best.point is start and iteration > 0 and residual <= allowed:
            # What rounding makes of the balance may be larger than the load itself: the start is no answer for that.
            best = NewtonResult(x, residual, iteration, False, best.factor, factored_at=best.factored_at)
        if best.residual <= allowed and best.point is not start:
            best.converged = True
        if (
            (residual <= goal and best.converged)
            or iteration == limit
            or (best.converged and stalled >= 1)
            or stalled >= 8
        ):
            break
        # As Newton's method converges by squares, so may the linear equations [dembo1982].
        accuracy = max(_LINEAR * goal / residual, min(_LINEAR, (residual / last) ** 2))
        last = residual
        try:
            kept = best.factor if keeping and _is_near(problem, best, x) else None
            best.factor, direction = problem.direction(hessian, gradient, kept, accuracy)
            keeping = keeping and (kept is None or best.factor is kept)  # no second try once one was in vain
            if best.factor is not kept:
                best.factored_at = x
        except SolverError:
            break
        if not np.isfinite(direction).all():
            break
        moved, stresses, _ = problem.moved(x, direction)
        length = float(np.abs(moved - x).max())
        x = moved
        best.iterations = iteration + 1
    return best


def is_minimum(problem: Problem[Matrix], result: NewtonResult, *, exactly: bool = True) -> bool:
    """Whether a converged result is a minimum: its exact Hessian, whose factor it then keeps, is positive definite.

    If not ``exactly``, a definite Hessian near by stands for it.
    """
    if not result.converged:
        return False
    near = not exactly and _is_near(problem, result, result.point)
    if not (near and result.factor is not None and result.factor.is_definite()):
        result.factor = problem.definite_factor(problem.linearise(result.point, EXACT)[1])
    result.stable = result.factor is not None
    return result.stable


def _is_near(problem: Problem[Matrix], result: NewtonResult, x: Array) -> bool:
    """Whether the factor of a result serves at x."""
    at = result.factored_at
    return at is not None and problem.keeps_factor(float(np.abs(x - at).max(initial=0.0)))
