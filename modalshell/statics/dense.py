"""Problems of few unknowns, with dense algebra: reduced shells, modal potentials, user-defined energies."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import ClassVar, Self, final

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike

from modalshell.core.checks import checked_number, checked_vectors, vector_count
from modalshell.core.cost import count_solves
from modalshell.core.errors import OptionError, SolverError
from modalshell.core.typing import Array
from modalshell.shell import EXACT
from modalshell.statics.least_potential import Workable
from modalshell.statics.mixed_newton import ACCEPTED, GOAL
from modalshell.statics.newton import NewtonResult, Problem
from modalshell.statics.trust_region import minimise

_SOFTEST = 1e-12
"""Least stiffness of an unknown, as a share of the largest, that forces are scaled by."""


@final
class DenseFactor:
    """A small symmetric matrix, scaled, with :class:`Factored`'s methods."""

    def __init__(self, matrix: Array, scaling: Array) -> None:
        self._matrix, self._scaling = matrix / scaling[:, None] / scaling, scaling

    def solve(self, right_side: Array) -> Array:
        """Solution (r,) for a right side (r,)."""
        count_solves(len(right_side), 1)
        try:
            return np.asarray(np.linalg.solve(self._matrix, right_side / self._scaling) / self._scaling)
        except np.linalg.LinAlgError:
            raise SolverError("a reduced Hessian is singular") from None

    def is_definite(self) -> bool:
        """Whether the matrix is positive definite."""
        try:
            return bool(np.isfinite(np.linalg.cholesky(self._matrix)).all())
        except np.linalg.LinAlgError:
            return False

    def negative_eigenvalues(self) -> int:
        """Number of negative eigenvalues."""
        return int((np.linalg.eigvalsh(self._matrix) < 0.0).sum())


class DenseProblem(Problem[Array]):
    """A problem of few unknowns x (r,), whose Hessians are dense."""

    scaling: Array
    """Square root of the stiffness of each unknown at rest: forces are measured by ``|f / scaling|``, the root of twice
    the energy that they store. Shape (r,)."""

    @abstractmethod
    def potential(self, x: Array) -> tuple[float, Array]:
        """The whole potential [J] and its gradient (r,)."""

    def measure(self, force: Array) -> float:
        """Size of a reduced force [sqrt(J)]."""
        return float(np.linalg.norm(force / self.scaling))

    def factor(self, hessian: Array) -> DenseFactor:
        """The matrix itself, which is small."""
        return DenseFactor(hessian, self.scaling)

    def critical_mode(self, hessian: Array) -> tuple[float, Array]:
        """Eigenvalue nearest to zero, over :attr:`weights`, and its direction (r,)."""
        root = np.sqrt(self.weights)
        values, vectors = scipy.linalg.eigh(hessian / root[:, None] / root)
        nearest = int(np.abs(values).argmin())
        return float(values[nearest]), np.asarray(vectors[:, nearest] / root)

    def descend(self, start: Array, scale: float) -> NewtonResult:
        """Trust-region descent to a minimum, in coordinates scaled to unit stiffness."""
        scaling = self.scaling

        def value_gradient(y: Array) -> tuple[float, Array]:
            total, gradient = self.potential(y / scaling)
            gradient = gradient / scaling
            return total if np.isfinite(total) and np.isfinite(gradient).all() else np.inf, gradient

        def hessian(y: Array) -> Array:
            matrix = self.linearise(y / scaling, EXACT)[1] / scaling[:, None] / scaling
            return matrix if np.isfinite(matrix).all() else np.eye(scaling.size)  # a collapsed element: plain descent

        found = minimise(value_gradient, hessian, start * scaling, GOAL, scale=scale, radius=scale)
        z = found.point / scaling
        factor = self.definite_factor(self.linearise(z, EXACT)[1])
        stable = found.converged or factor is not None
        balanced = found.residual <= ACCEPTED
        return NewtonResult(z, found.residual, found.iterations, balanced and stable, factor, stable)


@final
@dataclass(frozen=True)
class WorkPotential(DenseProblem):
    """The potential ``q . Lambda q / 2 - share f . u(q)`` of a modal model that knows the work of its load.

    ``load`` is f (n, 3) [N], ``share`` the part of it that acts, and ``origin`` is rest: zeros (m,). Lambda is all
    positive.
    """

    model: Workable
    share: float = 1.0
    scaling: Array = field(init=False)

    load_step: ClassVar = 0.3
    path_goal: ClassVar = 1e-9
    snaps: ClassVar = 3

    def __post_init__(self) -> None:
        object.__setattr__(self, "scaling", np.sqrt(self.model.basis.eigenvalues))

    @property
    def push(self) -> Array:
        """Modal force (m,) of the share at rest."""
        return self.share * self.push_at(self.origin)

    def push_at(self, x: Array) -> Array:
        """Modal force (m,) of the whole load at q."""
        return self.model.work(x, self.load)[1]

    def loaded(self, share: float) -> Self:
        """The same problem under a share of the load."""
        return replace(self, share=share * self.share)

    def potential(self, x: Array) -> tuple[float, Array]:
        """The whole potential [J] and its gradient (m,)."""
        work, push = self.model.work(x, self.load)
        pull = self.model.basis.eigenvalues * x
        return 0.5 * float(x @ pull) - self.share * work, pull - self.share * push

    def linearise(  # exact, whatever is asked for: there are no stresses
        self,
        x: Array,
        geometric: int,  # noqa: ARG002
        stresses: list[Array] | None = None,  # noqa: ARG002
    ) -> tuple[Array, Array]:
        """Gradient (m,) and exact Hessian (m, m)."""
        curvature = self.model.work_curvature(x, self.load)
        return self.potential(x)[1], np.diag(self.model.basis.eigenvalues) - self.share * curvature

    def moved(self, x: Array, direction: Array, reach: float | None = None) -> tuple[Array, list[Array], float]:
        """A straight step, cut where a part would turn by more than ``reach`` [rad]."""
        share = 1.0 if reach is None else min(1.0, reach / max(self.model.largest_turn(direction), 1e-300))
        return x + share * direction, [], share


def force_scaling(hessian: Array) -> Array:
    """Square root of the stiffness of each unknown (r,), no less than a small share of the largest."""
    stiffness = np.abs(np.diagonal(hessian))
    return np.asarray(np.sqrt(np.maximum(stiffness, _SOFTEST * stiffness.max(initial=0.0))))


@final
class EnergyFunction:
    """A user-defined elastic energy of any unknowns, for :func:`modalshell.equilibrium_path`.

    Parameters
    ----------
    function : callable
        Energy [J], gradient (N,) and Hessian (N, N) at unknowns (N,).
    rest : array_like, shape (N,)
        Unknowns without load, in balance.
    size : float
        Length of a step in the unknowns that counts as large: steps of a path are no longer than a twentieth of it.

    Raises
    ------
    OptionError
        For arrays of the wrong shape or not finite, a function that returns others, or a size that is not positive.

    Examples
    --------
    A bar of unit stiffness that is pushed into its second equilibrium:

    >>> import numpy as np
    >>> import modalshell as ms
    >>> def double_well(x):
    ...     e = 0.25 * (x[0] ** 2 - 1.0) ** 2
    ...     return e, np.array([x[0] * (x[0] ** 2 - 1.0)]), np.array([[3.0 * x[0] ** 2 - 1.0]])
    >>> path = ms.equilibrium_path(ms.EnergyFunction(double_well, [-1.0]), force=[1.0], until=1.0)
    >>> [kind for kind, index, factor in path.events]
    ['limit', 'limit']
    """

    def __init__(
        self, function: Callable[[Array], tuple[float, Array, Array]], rest: ArrayLike, *, size: float = 1.0
    ) -> None:
        if not callable(function):
            raise OptionError("function must be callable: function(x) -> energy, gradient, Hessian")
        self.rest = checked_vectors("rest", rest, (vector_count(rest),), OptionError).copy()
        self.size = checked_number("size", size, above=0.0)
        self.function = function
        hessian = self(self.rest)[2]
        self.scaling = force_scaling(hessian)
        if not (self.scaling > 0.0).all():
            raise OptionError("function's Hessian at rest has a zero diagonal: no unknown has any stiffness")

    def __call__(self, x: Array) -> tuple[float, Array, Array]:
        """Energy, gradient and Hessian at ``x``; OptionError where the function returns other shapes."""
        found = self.function(x.copy())
        try:
            energy, gradient, hessian = found
            value = float(energy)
            slope, curvature = np.array(gradient, dtype=np.float64), np.array(hessian, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise OptionError("function must return energy, gradient and Hessian at x") from error
        wanted = (self.rest.size,), (self.rest.size, self.rest.size)
        if (slope.shape, curvature.shape) != wanted:
            raise OptionError(f"function must return shapes {wanted} (got {slope.shape}, {curvature.shape})")
        return value, slope, curvature

    def problem(self, load: Array) -> EnergyPotential:
        """The potential of this energy under a dead ``load`` (N,)."""
        return EnergyPotential(load, self.rest, self)


@final
@dataclass(frozen=True)
class EnergyPotential(DenseProblem):
    """The potential ``E(x) - b . x`` of an :class:`EnergyFunction`; ``load`` (N,) is b, ``origin`` (N,) is at rest."""

    energy: EnergyFunction
    scaling: Array = field(init=False)

    load_step: ClassVar = 0.05
    path_goal: ClassVar = 1e-9
    snaps: ClassVar = 3

    def __post_init__(self) -> None:
        object.__setattr__(self, "scaling", self.energy.scaling)

    def potential(self, x: Array) -> tuple[float, Array]:
        """The whole potential and its gradient (N,)."""
        value, gradient, _ = self.energy(x)
        more, pull = self._outer(x)
        return value + more, gradient + pull

    def linearise(  # exact, whatever is asked for: there are no stresses
        self,
        x: Array,
        geometric: int,  # noqa: ARG002
        stresses: list[Array] | None = None,  # noqa: ARG002
    ) -> tuple[Array, Array]:
        """Gradient (N,) and Hessian (N, N)."""
        _, gradient, hessian = self.energy(x)
        return gradient + self._outer(x)[1], hessian

    def moved(self, x: Array, direction: Array, reach: float | None = None) -> tuple[Array, list[Array], float]:
        """A straight step, cut where it is longer than ``reach`` times the energy's size."""
        length = float(np.linalg.norm(direction)) / self.energy.size
        share = 1.0 if reach is None else min(1.0, reach / max(length, 1e-300))
        return x + share * direction, [], share
