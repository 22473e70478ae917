"""Potential of a reduced energy with assumed stresses, for statics; see :mod:`.assumed_stress`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from modalshell.core.typing import Array
from modalshell.models.hybrid.assumed_stress import ReducedStress
from modalshell.models.hybrid.energy_kernels import evaluate
from modalshell.shell import EXACT
from modalshell.statics.dense import DenseProblem


@final
@dataclass(frozen=True)
class StressPotential(DenseProblem):
    """The potential ``E(z) - p . z`` of coordinates z (m,) of unit mass, with p the load; the origin is rest: zeros."""

    reduced: ReducedStress
    """E. Its Hessian leaves out the second derivatives of the angles of hinges that are bent at rest."""
    scaling: Array
    """Square root (m,) of the stiffness of each coordinate at rest."""
    change: Callable[[Array], float]
    """Largest relative change of an edge vector by a step in z."""
    count: Callable[[int], None]
    """Counts a number of evaluations of the energy."""

    load_step: ClassVar = 0.5
    path_goal: ClassVar = 1e-4
    snaps: ClassVar = 3

    def potential(self, x: Array) -> tuple[float, Array]:
        """The whole potential [J] and its gradient (m,)."""
        value, _, _, gradient, _ = self._evaluated(x, None)
        return value - float(self.load @ x), gradient - self.load

    def linearise(self, x: Array, geometric: int, stresses: list[Array] | None = None) -> tuple[Array, Array]:
        """Gradient (m,) and Hessian (m, m)."""
        present = self._evaluated(x, None)[1][: self._modes] if geometric == EXACT else None
        _, _, _, gradient, lower = self._evaluated(x, stresses[0] if stresses else present)
        return gradient - self.load, np.tril(lower) + np.tril(lower, -1).T

    def moved(self, x: Array, direction: Array, reach: float | None = None) -> tuple[Array, list[Array], float]:
        """A straight step, cut where an edge would change by more than ``reach`` of its length."""
        fraction = 1.0 if reach is None else min(1.0, reach / max(self.change(direction), 1e-300))
        step = fraction * direction
        _, strains, slopes, _, _ = self._evaluated(x, None)
        return x + step, [strains[: self._modes] + slopes[: self._modes] @ step], fraction

    @property
    def _modes(self) -> int:
        return self.reduced.membrane.modes

    def _evaluated(self, z: Array, stresses: Array | None) -> tuple[float, Array, Array, Array, Array]:
        self.count(1)
        return evaluate(self.reduced, z, np.zeros(self._modes) if stresses is None else stresses)
