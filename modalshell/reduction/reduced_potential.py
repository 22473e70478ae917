"""The potential of a reduced shell as a problem of statics and implicit steps, with dense algebra."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from modalshell.errors import SolverError
from modalshell.reduction.reduced_energy import ReducedEnergy
from modalshell.shell import EXACT
from modalshell.statics.newton import GOAL, NewtonResult, Problem
from modalshell.statics.trust_region import minimise
from modalshell.statics.verdict import ACCEPTED
from modalshell.typing import Array


@final
class _Dense:
    """A small symmetric matrix, scaled, with :class:`Factored`'s methods."""

    def __init__(self, matrix: Array, scaling: Array) -> None:
        self._matrix, self._scaling = matrix / scaling[:, None] / scaling, scaling

    def solve(self, right_side: Array) -> Array:
        try:
            return np.asarray(np.linalg.solve(self._matrix, right_side / self._scaling) / self._scaling)
        except np.linalg.LinAlgError:
            raise SolverError("a reduced Hessian is singular") from None

    def is_definite(self) -> bool:
        try:
            return bool(np.isfinite(np.linalg.cholesky(self._matrix)).all())
        except np.linalg.LinAlgError:
            return False


@final
@dataclass(frozen=True)
class ReducedPotential(Problem[Array]):
    """The potential of a reduced energy: x are coordinates z (r,).

    Parameters
    ----------
    load, origin : ndarray, shape (r,)
        Reduced load, and where the quadratic part is centred.
    energy : ReducedEnergy
        E.
    scaling : ndarray, shape (r,)
        Square root of the stiffness of each coordinate about ``origin``: forces are measured by ``|f / scaling|``, the
        root of twice the energy that they store.
    edge_change : callable
        Largest relative change of an edge vector that a step in z makes.
    quadratic : ndarray, shape (r, r), optional
        Q.
    """

    energy: ReducedEnergy
    scaling: Array
    edge_change: Callable[[Array], float]

    load_step: ClassVar = 0.5
    path_goal: ClassVar = 1e-4  # cubature is trained on the path
    snaps: ClassVar = 0  # the whole load at once from the end of a branch

    def measure(self, force: Array) -> float:
        """Size of a reduced force [sqrt(J)]."""
        return float(np.linalg.norm(force / self.scaling))

    def linearise(self, x: Array, geometric: int, stresses: list[Array] | None = None) -> tuple[Array, Array]:
        """Gradient (r,) and Hessian (r, r)."""
        _, gradient, hessian = self.energy.hessian(x, geometric, stresses)
        return gradient + self._outer(x)[1], hessian if self.quadratic is None else hessian + self.quadratic

    def factor(self, hessian: Array) -> _Dense:
        """The matrix itself, which is small."""
        return _Dense(hessian, self.scaling)

    def moved(self, x: Array, direction: Array, reach: float | None = None) -> tuple[Array, list[Array], float]:
        """A straight step, cut where an edge would change by more than ``reach`` of its length."""
        share = 1.0 if reach is None else min(1.0, reach / max(self.edge_change(direction), 1e-300))
        step = share * direction
        return x + step, self.energy.predicted_stresses(x, step), share

    def descend(self, start: Array, scale: float) -> NewtonResult:
        """Trust-region descent to a minimum, in coordinates scaled to unit stiffness."""
        scaling = self.scaling

        def value_gradient(y: Array) -> tuple[float, Array]:
            value, gradient = self.energy.gradient(y / scaling)
            more, pull = self._outer(y / scaling)
            total = value + more
            gradient = (gradient + pull) / scaling
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
