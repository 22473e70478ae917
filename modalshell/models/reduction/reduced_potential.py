"""Potential of a reduced shell for static and implicit solves, with dense algebra."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, final

from modalshell.core.typing import Array
from modalshell.models.reduction.reduced_energy import ReducedEnergy
from modalshell.statics.dense import DenseProblem


@final
@dataclass(frozen=True)
class ReducedPotential(DenseProblem):
    """The potential of a reduced energy: x are coordinates z (r,).

    ``load`` and ``origin`` (r,) are the reduced load, and where the quadratic part Q (r, r) is centred; ``scaling``
    (r,) is the square root of the stiffness of each coordinate about it. ``edge_change`` gives the largest relative
    change of an edge vector by a step in z.
    """

    energy: ReducedEnergy
    scaling: Array
    edge_change: Callable[[Array], float]

    load_step: ClassVar = 0.5
    path_goal: ClassVar = 1e-4  # cubature is trained on the path
    snaps: ClassVar = 0  # the whole load at once from the end of a branch

    def potential(self, x: Array) -> tuple[float, Array]:
        """The whole potential [J] and its gradient (r,)."""
        value, gradient = self.energy.gradient(x)
        more, pull = self._outer(x)
        return value + more, gradient + pull

    def linearise(self, x: Array, geometric: int, stresses: list[Array] | None = None) -> tuple[Array, Array]:
        """Gradient (r,) and Hessian (r, r)."""
        _, gradient, hessian = self.energy.hessian(x, geometric, stresses)
        return gradient + self._outer(x)[1], hessian if self.quadratic is None else hessian + self.quadratic

    def moved(self, x: Array, direction: Array, reach: float | None = None) -> tuple[Array, list[Array], float]:
        """A straight step, cut where an edge would change by more than ``reach`` of its length."""
        share = 1.0 if reach is None else min(1.0, reach / max(self.edge_change(direction), 1e-300))
        step = share * direction
        return x + step, self.energy.predicted_stresses(x, step), share

    def rounding(self, x: Array, hessian: Array, length: float) -> float:
        """Size of the residual that the rounding of positions leaves."""
        return self.measure(self.energy.rounding)
