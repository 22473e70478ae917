"""Problems of Newton's method, full and reduced, and mixed Newton on them; :mod:`.mixed_newton` has the method."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import ClassVar, Generic, NamedTuple, Protocol, Self, TypeVar, final

import numpy as np

from modalshell.core.errors import SolverError
from modalshell.core.typing import Array
from modalshell.shell import EXACT, GAUSS_NEWTON, MIXED
from modalshell.statics.mixed_newton import ACCEPTED, GOAL, MOST, Rules, Solved, iterate

Matrix = TypeVar("Matrix")


class Factored(Protocol):
    """A factorised symmetric matrix, sparse or dense."""

    def solve(self, right_side: Array) -> Array:
        """Solution (N,) for a right side (N,)."""

    def is_definite(self) -> bool:
        """Whether the matrix is positive definite."""

    def negative_eigenvalues(self) -> int:
        """Number of negative eigenvalues; SolverError where the factors do not show it."""


class Kept(NamedTuple):
    """A factor, and where its Hessian is."""

    factor: Factored
    at: Array


@dataclass
class NewtonResult:
    """Where a solver ended."""

    point: Array
    """Last (or best) iterate: positions (n, 3) [m] of a full problem, coordinates (r,) of a reduced one."""
    residual: float
    """Size of the gradient over that of the load."""
    iterations: int
    """Newton's, each with a factorisation or a kept factor."""
    converged: bool
    """Whether the residual met :data:`ACCEPTED`, or :meth:`Problem.rounding` with Newton's steps at their end."""
    factor: Factored | None = None
    """Of the last Hessian, a step before the end; of the one at the end where :func:`is_minimum` has found it so."""
    stable: bool | None = None
    """Whether the exact Hessian at the end is positive definite; None if unknown."""
    limited: bool = False
    """Whether rounding keeps the residual above :data:`ACCEPTED`."""
    left_saddle: bool = False
    """Whether the iteration passed a saddle and left it along its unstable mode to the lower side."""
    path: list[tuple[float, Array]] = field(default_factory=list)
    """Shares of the load, and unknowns, of the states on the way from rest."""
    jumps: list[tuple[str, float]] = field(default_factory=list)
    """What ended the branches that the way from rest left by a jump, and at which shares of the load."""
    factored_at: Array | None = None
    """Where the Hessian of ``factor`` is, as :func:`mixed_newton` leaves it."""


class Equations(ABC, Generic[Matrix]):
    """Equations that mixed Newton solves, and the algebra of their unknowns x."""

    @abstractmethod
    def linearise(self, x: Array, geometric: int, stresses: list[Array] | None = None) -> tuple[Array, Matrix]:
        """Gradient (N,) and Hessian on the free unknowns."""

    def prepared(
        self, x: Array, geometric: int, stresses: list[Array] | None = None
    ) -> tuple[Array, Callable[[], Matrix]]:
        """Gradient (N,), and what makes the Hessian where that is asked for."""
        gradient, hessian = self.linearise(x, geometric, stresses)
        return gradient, lambda: hessian

    @abstractmethod
    def factor(self, hessian: Matrix) -> Factored:
        """Factor of a Hessian, definite or not; SolverError if it is singular."""

    @abstractmethod
    def moved(self, x: Array, direction: Array, reach: float | None = None) -> tuple[Array, list[Array], float]:
        """Unknowns and predicted stresses after a step along ``direction`` (N,), and the step's fraction of it.

        ``reach`` is the largest rotation [rad], or relative change of an edge, of the step.
        """

    @property
    def is_step(self) -> bool:
        """Whether they are those of a step in time, which must be taken."""
        return False

    def residual(self, x: Array) -> Array:
        """Gradient (N,) on the free unknowns."""
        return self.linearise(x, GAUSS_NEWTON)[0]

    def step(self, factor: Factored, gradient: Array) -> Array:
        """Newton direction (N,); SolverError if there is none."""
        return factor.solve(-gradient)

    def direction(
        self,
        x: Array,  # noqa: ARG002 (for sparse problems)
        hessian: Matrix,
        gradient: Array,
        kept: Kept | None,  # noqa: ARG002
        accuracy: float,  # noqa: ARG002
    ) -> tuple[Factored, Array]:
        """Newton direction (N,) at x and the factor that it took: a new one, or ``kept`` where that gives it as well.

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


@dataclass(frozen=True)
class Problem(Equations[Matrix]):
    """A potential ``E(x) + u.Q u / 2 - b.u`` with ``u = x - origin``, and the algebra of its unknowns."""

    load: Array
    """b, of the shape of x."""
    origin: Array
    """Where the quadratic part is centred; rest in statics."""
    quadratic: Array | None = field(default=None, kw_only=True)
    """Q, inertia and damping of an implicit step; statics has none."""

    load_step: ClassVar[float]
    """Reach of the longest step that a growing load may predict."""
    path_goal: ClassVar[float]
    """Relative residual that load steps before the last aim at."""
    snaps: ClassVar[int]
    """Number of ends of branches after which the potential is minimised under the whole load at once."""

    @property
    def is_step(self) -> bool:
        """Whether there is inertia."""
        return self.quadratic is not None

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

    def length(self, step: Array) -> float:
        """Length of a step of the free unknowns (N,), by their weights."""
        return float(np.sqrt(self.weights @ step**2))

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
    def descend(self, start: Array, scale: float) -> NewtonResult:
        """Go downhill to a minimum."""

    def definite_factor(self, hessian: Matrix) -> Factored | None:
        """Factor of a positive definite Hessian, None for any other."""
        factor = self.factor(hessian)
        return factor if factor.is_definite() else None

    def scale_at(self, start: Array | None) -> float:
        """Scale of residuals: the load's size, or without a load that of the forces at the start.

        Those of an answer without a load are rounding: residuals need not be smaller than that.
        """
        size = self.measure(self.push)
        if size or start is None:
            return size or 1.0
        size = self.measure(self.residual(start))
        if np.isfinite(size) and not self.is_step:
            size = max(size, self.rounding(start, self.linearise(start, GAUSS_NEWTON)[1], 0.0) / ACCEPTED)
        return size or 1.0

    def loaded(self, fraction: float) -> Self:
        """The same problem under a fraction of the load."""
        return replace(self, load=fraction * self.load)

    def _outer(self, x: Array) -> tuple[float, Array]:
        u = x - self.origin
        pull = self._product(u) - self.load if self.is_step else -self.load
        return 0.5 * float(np.vdot(u, pull - self.load)), pull

    def _product(self, u: Array) -> Array:
        return np.asarray(self.quadratic @ u)  # type: ignore[operator]  # of a step


class Iterate(ABC, Generic[Matrix]):
    """An iterate of a problem with its stresses and factor: the operations of :mod:`.mixed_newton`.

    Parameters
    ----------
    problem : Equations
        The equations.
    start : ndarray
        The first iterate.
    scale : float
        Size of the force that residuals are relative to.
    stresses : list of ndarray, optional
        Those predicted with the start; without them the first step leaves the geometric part out.
    """

    def __init__(
        self, problem: Equations[Matrix], start: Array, scale: float, stresses: list[Array] | None = None
    ) -> None:
        self.problem, self.x, self.scale, self.stresses = problem, start.copy(), scale, stresses
        self.factor: Factored | None = None
        self.factored_at: Array | None = None
        self.stable: bool | None = None
        self.moves = 0
        self._sizes = 0.0, 0.0
        self._in_time = problem.is_step and problem.keeps_factor(0.0)
        self.slots = np.stack([start, start])
        self._keeping = True
        self._lent: Factored | None = None

    def keep(self, near: NewtonResult | None) -> None:
        """Begin with the factor, if there is any, of a result for a problem that is near this one."""
        if near is not None and near.factor is not None and near.factored_at is not None:
            self.factor = self._lent = near.factor
            self.factored_at = near.factored_at

    def residual(self) -> float:
        """Out-of-balance force."""
        geometric = GAUSS_NEWTON if self.stresses is None else MIXED
        self._gradient, self._make = self.problem.prepared(self.x, geometric, self.stresses)
        self._sizes = self._sizes[1], self.problem.measure(self._gradient) / self.scale
        return self._sizes[1]

    def _stays(self, accuracy: float) -> bool:
        """Whether the Hessian of the iterate before serves, the linear equations being solved to ``accuracy``.

        A step by it leaves about as large a share of the gradient as the last step has left: near the end no more than
        the linear equations do.
        """
        before, now = self._sizes
        return self._in_time and now <= accuracy * before

    def solve(self, accuracy: float) -> bool:
        """Find Newton's direction."""
        if not self._stays(accuracy):
            self._hessian, self._made_at = self._make(), self.x.copy()
        last = self.factor
        serves = self._keeping and last is not None and _serves(self.problem, self.factored_at, self.x)
        kept = Kept(last, self.factored_at) if serves else None  # type: ignore[arg-type]
        try:
            self.factor, self._direction = self.problem.direction(self.x, self._hessian, self._gradient, kept, accuracy)
        except SolverError:
            return False
        # No second try once one of its own was in vain.
        self._keeping = self._keeping and (kept is None or last is self._lent or self.factor is last)
        if kept is None or self.factor is not last:
            self.factored_at = self._made_at
        return bool(np.isfinite(self._direction).all())

    def advance(self) -> float:
        """Move along the direction."""
        moved, self.stresses, _ = self.problem.moved(self.x, self._direction)
        length = float(np.abs(moved - self.x).max())
        self.x[:] = moved
        self.moves += 1
        return self.problem.rounding(moved, self._hessian, length) / self.scale

    def result(self, solved: Solved) -> NewtonResult:
        """The iterate as the result of a method that ended so."""
        return NewtonResult(
            self.x, solved.residual, solved.iterations, solved.solved, self.factor, self.stable,
            left_saddle=solved.saddles > 0, factored_at=self.factored_at,
        )  # fmt: skip


@final
class NewtonIterate(Iterate[Matrix]):
    """An iterate of mixed Newton alone."""


def rules_of(problem: Equations[Matrix], goal: float, most: int = MOST) -> Rules:
    """When mixed Newton ends on a problem with this goal."""
    accepted = max(ACCEPTED, goal)
    return Rules(goal, accepted, GOAL if problem.is_step else accepted, 0, most)


def mixed_newton(
    problem: Equations[Matrix],
    start: Array,
    scale: float,
    *,
    limit: int = MOST,
    goal: float = GOAL,
    stresses: list[Array] | None = None,
    near: NewtonResult | None = None,
) -> NewtonResult:
    """Full mixed Newton steps from ``start``, with the ``stresses`` predicted there; see :func:`.iterate`.

    The factor of ``near``, the result for a problem near this one, may serve.
    """
    state = NewtonIterate(problem, start, scale, stresses)
    state.keep(near)
    return state.result(iterate(state, rules_of(problem, goal, limit)))


def is_minimum(problem: Problem[Matrix], result: NewtonResult, *, exactly: bool = True) -> bool:
    """Whether a converged result is a minimum: its exact Hessian, whose factor it then keeps, is positive definite.

    If not ``exactly``, a definite Hessian near by stands for it.
    """
    if not result.converged:
        return False
    near = not exactly and _serves(problem, result.factored_at, result.point)
    if not (near and result.factor is not None and result.factor.is_definite()):
        result.factor = problem.definite_factor(problem.linearise(result.point, EXACT)[1])
    result.stable = result.factor is not None
    return result.stable


def _serves(problem: Equations[Matrix], factored_at: Array | None, x: Array) -> bool:
    """Whether the factor of the Hessian at one iterate, if there is any, serves at x."""
    return factored_at is not None and problem.keeps_factor(float(np.abs(x - factored_at).max(initial=0.0)))
