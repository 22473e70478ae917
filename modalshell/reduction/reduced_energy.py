"""The discrete-shell energy of displacements ``u = U z``: over all elements, or over a weighted few of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from modalshell.kernels.blocks import multiply
from modalshell.shell import EXACT, Shell
from modalshell.shell import elements as sums
from modalshell.shell.elements import ElementSet
from modalshell.shell.pattern import build_pattern
from modalshell.supports import VertexUnknowns
from modalshell.typing import Array, Index
from modalshell.work import count_products, count_read


class ReducedEnergy:
    """``E(z) = sum_e xi_e w_e (g_e(X + U z) - g_e(X))^2`` with its derivatives in z [barbic2005; an2008].

    Parameters
    ----------
    shell : Shell
        Gives the elements, and X.
    vectors : ndarray, shape (3n, r)
        U, displacement fields [1/sqrt(kg)] for coordinates z [m sqrt(kg)].
    chosen : sequence of int arrays, optional
        Which elements of each of the shell's element sets to sum; all without it.
    factors : sequence of arrays, optional
        xi, the factor of each chosen element; one without it.

    Attributes
    ----------
    elements : list of ElementSet
        The summed elements, on their own numbering of the vertices that they touch.
    vertices : ndarray of int
        Those vertices of the shell.
    """

    def __init__(
        self,
        shell: Shell,
        vectors: Array,
        chosen: Sequence[Index] | None = None,
        factors: Sequence[Array] | None = None,
    ) -> None:
        if chosen is None:
            chosen = [np.arange(e.rest.size) for e in shell.elements]
        if factors is None:
            factors = [np.ones(picked.size) for picked in chosen]
        stencils = [e.stencils[picked] for e, picked in zip(shell.elements, chosen, strict=True)]
        self.vertices = np.unique(np.concatenate([stencil.ravel() for stencil in stencils]))
        local = np.zeros(len(shell.rest_positions), np.int64)
        local[self.vertices] = np.arange(self.vertices.size)
        self.elements: list[ElementSet] = [
            replace(e, stencils=local[stencil], rest=e.rest[picked], weight=e.weight[picked] * factor)
            for e, stencil, picked, factor in zip(shell.elements, stencils, chosen, factors, strict=True)
        ]
        self._rest = shell.rest_positions[self.vertices]
        rows = (3 * self.vertices[:, None] + np.arange(3)).ravel()
        self._vectors = np.ascontiguousarray(vectors[rows])
        count = self.vertices.size
        self._pattern, self._slots = build_pattern(
            count, [e.stencils for e in self.elements], VertexUnknowns(np.zeros(count, dtype=bool))
        )

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
        return sums.energy(self.elements, self.positions(z))

    def gradient(self, z: Array) -> tuple[float, Array]:
        """Energy [J] and its gradient ``U^T grad E`` (r,)."""
        total, gradient = sums.energy_gradient(self.elements, self.positions(z))
        count_read(self._vectors.nbytes)
        return total, np.asarray(gradient.ravel() @ self._vectors)

    def hessian(
        self, z: Array, geometric: int = EXACT, stresses: Sequence[Array] | None = None
    ) -> tuple[float, Array, Array]:
        """Energy, gradient (r,) and Hessian ``U^T K U`` (r, r); options as for a shell's Hessian."""
        x, pattern = self.positions(z), self._pattern
        total, gradient, data = sums.energy_gradient_hessian(
            self.elements, self._slots, pattern, x, geometric, stresses
        )
        product = np.empty_like(self._vectors)
        multiply(pattern.indptr, pattern.indices, data, self._vectors, product)
        reduced = self._vectors.T @ product
        count_products((data.size + self._vectors.size) * self.size)
        return total, np.asarray(gradient.ravel() @ self._vectors), np.asarray(0.5 * (reduced + reduced.T))

    def predicted_stresses(self, z: Array, step: Array) -> list[Array]:
        """Stress of every element after ``step`` (r,) by the measures linearised at ``z`` (mixed Newton)."""
        x, moved = self.positions(z), (self._vectors @ step).reshape(-1, 3)
        return sums.linear_stresses(self.elements, x, moved)
