"""Measures of the discrete-shell energies for the hybrid rung."""

from __future__ import annotations

from typing import ClassVar, final

import numpy as np
from numpy.typing import NDArray

from modalshell.core.typing import Array, Index
from modalshell.mesh.topology import numbers_of_edges
from modalshell.models.hybrid.measures import FLAT, Bending, Measures, feet_of, offsets, remaining
from modalshell.shell.smoothed_membrane import PAIR, strain_of_lengths


@final
class HingeMeasures(Measures):
    """Of the discrete-shell energies: stresses of triangles and edges, and hinges that are not coupled."""

    vectors: ClassVar[tuple[int, ...]] = (32, 44, 64)

    @property
    def edges(self) -> Index:
        """The mesh's."""
        return self.shell.elements[1].stencils

    @property
    def state_size(self) -> int:
        """Triangles and edges."""
        return self.evaluated

    @property
    def evaluated(self) -> int:
        """Triangles and edges."""
        return sum(elements.rest.size for elements in self.shell.elements[:2])

    def state(self, x: Array, step: Array) -> Array:
        """Stresses of triangles and edges."""
        return np.concatenate(self.shell.predicted_stresses(x, step)[:2])

    def _softness(self, factors: tuple[float, ...] = (1.0, 1.0)) -> Array:
        """Strain (T + E,) for each unit of stress of triangles and edges, 0 where there is no stiffness."""
        parts = zip(factors, self.shell.elements[:2], strict=True)
        weight = np.concatenate([factor * elements.weight for factor, elements in parts])
        return np.divide(0.5, weight, out=np.zeros(weight.size), where=weight > 0.0)

    def scaled(self, states: Array) -> Array:
        """By the roots of the compliances."""
        return np.asarray(np.sqrt(self._softness())[:, None] * states)

    def unscaled(self, modes: Array) -> Array:
        """Zero where there is no stiffness."""
        root = np.sqrt(self._softness())[:, None]
        return np.asarray(modes / np.where(root > 0.0, root, np.inf))

    def energy(self, x: Array) -> float:
        """Of triangles and edges."""
        return float(sum(e.kernel.energy(x, e.stencils, e.rest, e.weight) for e in self.shell.elements[:2]))

    def _along(self, stresses: Array) -> Array:
        """Stresses (E, K) by the edges' lengths that do the work of those of triangles and edges (T + E, K)."""
        stretch, shear, _ = self.shell.elements
        sides = self.shell.mesh.face_edges
        squares = shear.rest[sides] ** 2
        # dA / dl_i = l_i (l_j^2 + l_k^2 - l_i^2) / (8 A) at rest
        slopes = shear.rest[sides] * (squares.sum(axis=1)[:, None] - 2.0 * squares) / (8.0 * stretch.rest[:, None])
        along = stresses[len(stretch.rest) :].copy()
        for side in range(3):
            np.add.at(along, sides[:, side], slopes[:, side, None] * stresses[: len(stretch.rest)])
        return along

    @property
    def _flat(self) -> NDArray[np.bool_]:
        return np.abs(self.shell.elements[2].rest) <= FLAT

    def elastic_tensions(self, modes: Array, factors: tuple[float, ...] = (1.0, 1.0, 1.0)) -> Array:
        """See :class:`Measures`; factors of triangles, edges and hinges."""
        shear, mesh = self.shell.elements[1], self.shell.mesh
        hinges = self.shell.elements[2].stencils[self._flat]
        weights = 2.0 * factors[2] * self.shell.elements[2].weight[self._flat]
        strains = self._softness(factors[:2])[:, None] * modes
        edges = numbers_of_edges(mesh.edges, hinges[:, PAIR])
        rows = np.zeros((len(hinges), 2, len(PAIR)))
        rows[:, :, [0, 1, 2]] = strain_of_lengths(mesh, hinges[:, [0, 1, 2]])[:, 1:]
        rows[:, :, [0, 3, 4]] -= strain_of_lengths(mesh, hinges[:, [0, 1, 3]], -1.0)[:, 1:]
        jumps = np.einsum("hpe,hek->hpk", rows, (shear.rest[:, None] * strains[-len(shear.rest) :])[edges])
        resisted = np.zeros((len(shear.rest), modes.shape[1]))
        np.add.at(resisted, edges, np.einsum("h,hpe,hpk->hek", weights, rows, jumps))
        taken = np.einsum("h,hpk,hpl->kl", weights, jumps, jumps)
        along = remaining(self._along(modes), shear.rest[:, None] * resisted, taken, modes.T @ strains)
        return np.asarray(along / shear.rest[:, None])

    def bending(self, columns: Array) -> Bending:
        """Hinges one by one."""
        flexure, vertices = self.shell.elements[2], self.shell.rest_positions
        flat = self._flat
        used, hinges = np.unique(flexure.stencils[~flat], return_inverse=True)
        stencils, weights = flexure.stencils[flat], flexure.weight[flat]
        tall = offsets(feet_of(vertices, stencils), columns, stencils).reshape(-1, columns.shape[2])
        bent = int(np.sum(~flat))
        return Bending(
            tall.T @ (np.repeat(2.0 * weights, 3)[:, None] * tall),
            np.ascontiguousarray(vertices[used]),
            np.ascontiguousarray(columns[used]),
            np.ascontiguousarray(hinges.reshape(-1, 4), dtype=np.int64),
            flexure.rest[~flat].copy(),
            np.sqrt(2.0 * flexure.weight[~flat]),
            np.zeros(bent + 1, dtype=np.int64),
            np.empty(0, dtype=np.int64),
            np.empty(0),
            np.empty((0, 3, columns.shape[2])),
            np.empty((0, 4)),
        )
