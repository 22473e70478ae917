"""Elastic energy of displacements ``u = U z``, over all elements or over weighted ones."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, final

import numpy as np

from modalshell.core.cost import count_products, count_read
from modalshell.core.typing import Array
from modalshell.integrators.full.implicit_rule import EulerStart
from modalshell.models.reduction.blocks import multiply
from modalshell.shell import EXACT, Shell
from modalshell.shell.elastic_energy import Part
from modalshell.statics.dense import DenseProblem
from modalshell.supports import VertexUnknowns


class ReducedEnergy:
    """``E(z) = W(X + U z)`` of an elastic energy W, or of a weighted part of it [barbic2005; an2008]; theory 10, eq. 2.

    The shell gives W and X; U is ``vectors`` (3n, r), displacement fields [1/sqrt(kg)] for coordinates z [m sqrt(kg)].
    ``vertices`` are those of the shell that W touches, in its order.
    """

    def __init__(self, shell: Shell, vectors: Array, part: Part | None = None) -> None:
        count = len(shell.rest_positions)
        self.energy, self.vertices = part or Part(shell.elastic_energy, np.arange(count))
        self._rest = shell.rest_positions[self.vertices]
        rows = (3 * self.vertices[:, None] + np.arange(3)).ravel()
        self._vectors = np.ascontiguousarray(vectors[rows])
        unknowns = VertexUnknowns(np.zeros(self.vertices.size, dtype=bool))
        self._pattern, self._slots = self.energy.pattern(unknowns)

    def damped(self, start: EulerStart, factor: float) -> ReducedEnergy:
        """Sum of it and of what damping takes in a step; see :meth:`modalshell.shell.ElasticEnergy.damped`."""
        other = copy.copy(self)
        energy = self.energy
        begun = start.damping_measures(
            lambda _, state: energy.changes(self.positions(state.coordinates)), energy.periods
        )
        other.energy = energy.damped(begun, factor, start.dt)
        return other

    @property
    def size(self) -> int:
        """Number of coordinates r."""
        return int(self._vectors.shape[1])

    def positions(self, z: Array) -> Array:
        """Positions (k, 3) [m] of the touched vertices."""
        count_read(self._vectors.nbytes)
        return self._rest + (self._vectors @ z).reshape(-1, 3)

    def value(self, z: Array) -> float:
        """Energy [J]; not finite at collapsed elements."""
        return self.energy.energy(self.positions(z))

    def gradient(self, z: Array) -> tuple[float, Array]:
        """Energy [J] and its gradient ``U^T grad W`` (r,)."""
        total, gradient = self.energy.energy_gradient(self.positions(z))
        count_read(self._vectors.nbytes)
        return total, np.asarray(gradient.ravel() @ self._vectors)

    @cached_property
    def rounding(self) -> Array:
        """Forces (r,) that the rounding of positions alone leaves: eps times the stiffness at rest times ``|x|``."""
        _, _, data = self.energy.energy_gradient_hessian(self._slots, self._pattern, self._rest, EXACT, None)
        forces = self._product(data) * self._rest.reshape(-1, 1)
        return np.asarray(np.finfo(np.float64).eps * np.linalg.norm(forces, axis=0))

    def hessian(
        self, z: Array, geometric: int = EXACT, stresses: list[Array] | None = None
    ) -> tuple[float, Array, Array]:
        """Energy, gradient (r,) and Hessian ``U^T K U`` (r, r); options as for a shell's Hessian."""
        x, pattern = self.positions(z), self._pattern
        total, gradient, data = self.energy.energy_gradient_hessian(self._slots, pattern, x, geometric, stresses)
        product = self._product(data)
        reduced = self._vectors.T @ product - pattern.internal_form(data, self._vectors)
        count_products((data.size + self._vectors.size) * self.size)
        return total, np.asarray(gradient.ravel() @ self._vectors), np.asarray(0.5 * (reduced + reduced.T))

    def predicted_stresses(self, z: Array, step: Array) -> list[Array]:
        """Stress of every element after ``step`` (r,) by the measures linearised at ``z`` (mixed Newton)."""
        x, moved = self.positions(z), (self._vectors @ step).reshape(-1, 3)
        return self.energy.linear_stresses(x, moved)

    def _product(self, data: Array) -> Array:
        """``K U`` (3k, r) of a Hessian's entries."""
        product = np.empty_like(self._vectors)
        indices, indptr = self._pattern.structure
        multiply(indptr, indices, data, self._vectors, product)
        return product


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
