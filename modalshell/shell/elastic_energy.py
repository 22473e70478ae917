"""Interface of a shell's elastic energy."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, final

import numpy as np

from modalshell.core.typing import Array, Index, Mask
from modalshell.mesh import TriangleMesh
from modalshell.shell.extended import Extended
from modalshell.shell.pattern import SparsePattern
from modalshell.supports import Unknowns

GAUSS_NEWTON, EXACT, MIXED, PROJECTED = 0, 1, 2, 3
"""How the second term of an element's Hessian is taken; see ``add_stiffness`` of the generated kernels."""


@final
class Part(NamedTuple):
    """A weighted sum of some elements of an energy."""

    energy: ElasticEnergy
    """The sum, on its own numbering of the vertices that it touches."""
    vertices: Index
    """Those vertices, in the numbering of the whole energy; shape (k,)."""


class ElasticEnergy(ABC):
    """Elastic energy of the vertices' positions, with its derivatives; no input checks."""

    @abstractmethod
    def pattern(self, unknowns: Unknowns) -> tuple[SparsePattern, list[Index]]:
        """Pattern of the Hessian with its part of the free ``unknowns``, and the slots of the elements in it."""

    @property
    def has_dashpots(self) -> bool:
        """Whether elements are damped by dashpots of their own."""
        return False

    def held_slopes(self) -> Index:
        """Vertices (k, 2) of the edges about which the surface cannot turn, as the energy clamps or mirrors them."""
        return np.empty((0, 2), dtype=np.int64)

    @abstractmethod
    def energy(self, x: Array) -> float:
        """Energy [J] at positions ``x`` (n, 3); not finite at collapsed elements."""

    @abstractmethod
    def face_energies(self, mesh: TriangleMesh, x: Array) -> Array:
        """Energy of every triangle (T,) [J] at positions ``x`` (n, 3); the sum is the energy."""

    @abstractmethod
    def energy_gradient(self, x: Array) -> tuple[float, Array]:
        """Energy [J] and gradient (n, 3) [N] in one pass."""

    def support_gradient(self, x: Array) -> Array:
        """Gradient (n, 3) [N] with the forces on points that clamp or mirror an edge, if any, at its ends."""
        return self.energy_gradient(x)[1]

    @abstractmethod
    def energy_gradient_hessian(
        self, slots: list[Index], pattern: SparsePattern, x: Array, geometric: int, stresses: list[Array] | None
    ) -> tuple[float, Array, Array]:
        """Energy, gradient (n, 3) and Hessian values on a ``pattern`` in one pass.

        ``geometric`` is one of GAUSS_NEWTON, EXACT, MIXED (with ``stresses``) and PROJECTED.
        """

    def hessian(
        self, slots: list[Index], pattern: SparsePattern, x: Array, geometric: int, stresses: list[Array] | None
    ) -> Array:
        """The Hessian values alone."""
        return self.energy_gradient_hessian(slots, pattern, x, geometric, stresses)[2]

    @abstractmethod
    def pulled_by_rest_angles(self, x: Array, weights: Array) -> Array:
        """Derivative (H,) of ``weights . gradient`` at ``x`` by the rest angle of every hinge of the mesh."""

    @abstractmethod
    def with_rest_angles(self, angles: Array) -> ElasticEnergy:
        """The same energy with ``angles`` (H,) [rad] added to the rest angles of the mesh's hinges."""

    @abstractmethod
    def fold_couples(self, x: Array, hinges: Index) -> Array:
        """Derivatives (C,) [N m] of the energy at ``x`` by the fold angles of some hinges of the mesh."""

    @abstractmethod
    def fold_stiffness(self, hinges: Index) -> Array:
        """Derivatives (C, C) [N m/rad] of these couples by those angles: constant."""

    @abstractmethod
    def rest_angle_pulls(self, x: Array, hinges: Index) -> Array:
        """Derivatives (C, n, 3) [N/rad] of the gradient at ``x`` by the rest angles of some hinges of the mesh."""

    @abstractmethod
    def extended_gradient(self, rest: Array, displacement: Extended) -> Extended:
        """Gradient (n, 3) [N] at ``rest + displacement``, both (n, 3) [m], in extended precision."""

    @abstractmethod
    def part(self, chosen: Sequence[Index], factors: Sequence[Array], internal: Array | None = None) -> Part:
        """The ``chosen`` elements of each kind, times positive ``factors``.

        ``internal`` (m, s) are fields of all internal unknowns, if the energy has any: the part is least over their
        combinations alone.
        """

    def shifted(self, origin: Array) -> ElasticEnergy:  # noqa: ARG002 (of those that hold points of their own)
        """The same energy of positions from which ``origin`` (3,) [m] has been taken."""
        return self

    def resting(self, shape: Any) -> ElasticEnergy:  # noqa: ARG002 (of those of sheets)
        """The same energy, least at a RestShape in place of the mesh's own."""
        return self

    def anchored(self, mesh: TriangleMesh) -> ElasticEnergy:  # noqa: ARG002 (of those that hold points of their own)
        """The same energy with clamped edges that keep the slope of another mesh than that at rest."""
        return self

    def posed(self, place: Callable[[Array], Array]) -> ElasticEnergy:  # noqa: ARG002 (of those that hold points of their own)
        """The same energy where the supports have moved: ``place`` maps positions of the shape at rest."""
        return self

    def pull(self, x: Array, after: Any) -> Array:  # noqa: ARG002 (of those that hold points of their own)
        """Change (n, 3) [N] of the gradient at ``x``, linearised, as the supports move on to those of ``after``."""
        return np.zeros_like(x)

    def holding(self, held: Mask) -> ElasticEnergy:  # noqa: ARG002 (of those whose clamps are their own)
        """The same energy where the vertices ``held`` (n,) are held."""
        return self

    @abstractmethod
    def linear_stresses(self, x: Array, step: Array) -> list[Array]:
        """Stresses after ``step`` (n, 3) by the measures linearised at ``x``."""

    @abstractmethod
    def linear_energy(self, x: Array, step: Array) -> float:
        """Energy [J] of the measures' rates along ``step`` (n, 3) at ``x``: half the Hessian's first part."""

    @abstractmethod
    def changes(self, x: Array) -> list[Array]:
        """Changes of the measures of every kind at ``x`` (n, 3) from those at rest."""

    @property
    @abstractmethod
    def periods(self) -> list[Array | float | None]:
        """Period of every kind of measures, of all or of each; None where they have none."""

    @abstractmethod
    def damped(self, begun: list[Array], factor: float, dt: float) -> ElasticEnergy:
        """Sum of it and of what damping takes in a step of ``dt`` [s] in which measures change from ``begun``.

        Both are quadratic in the measures, so that their sum is such an energy, too, but for a constant.
        """

    @abstractmethod
    def damping_force(self, x: Array, velocity: Array, factor: float) -> Array:
        """Minus ``factor`` [s] times the first part of the Hessian, and dashpots, times ``velocity`` (n, 3) [N]."""

    @abstractmethod
    def damping_matrix(self, slots: list[Index], pattern: SparsePattern, x: Array, factor: float) -> Array:
        """Values of the matrix of :meth:`damping_force` on a ``pattern`` [N s/m]."""


def nearest_measures(measures: Array, to: Array, period: Array | float | None) -> Array:
    """Measures as near as whole periods bring them to others; see :attr:`ElasticEnergy.periods`."""
    return measures if period is None else measures - period * np.round((measures - to) / period)
