"""Bordered systems: equilibrium with the load factor as an unknown and one path equation [keller1977]."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, final

import numpy as np

from modalshell.core.errors import SolverError
from modalshell.core.typing import Array
from modalshell.statics.newton import Equations, Factored, Matrix, Problem


@final
@dataclass(frozen=True)
class Plane:
    """The equation ``(normal . (x - x0) + slope (factor - factor0)) / length = 0``.

    Attributes
    ----------
    normal : ndarray, shape (N,)
        Of the free unknowns.
    slope : float
        Of the load factor.
    x : ndarray
        A point of the plane, unknowns as its problem has them.
    factor : float
        Load factor of that point.
    length : float
        Size of a step, the scale of the equation's residual.
    """

    normal: Array
    slope: float
    x: Array
    factor: float
    length: float


@final
class _BorderedFactor(Generic[Matrix]):
    """Factor of ``[[K, -p], [normal, slope] / length]`` by block elimination."""

    def __init__(self, factor: Factored, push: Array, plane: Plane, unit: float) -> None:
        self._factor, self._plane, self._unit = factor, plane, unit
        self._along = factor.solve(push)
        self._share = plane.slope + float(plane.normal @ self._along)

    def solve(self, right_side: Array) -> Array:
        plain = self._factor.solve(right_side[:-1])
        rest = right_side[-1] * self._plane.length / self._unit - float(self._plane.normal @ plain)
        if self._share == 0.0:
            raise SolverError("the path runs within the plane that should cut it")
        factor = rest / self._share
        return np.append(plain + factor * self._along, factor)

    def is_definite(self) -> bool:
        return False  # a saddle by its form

    def negative_eigenvalues(self) -> int:
        raise SolverError("a bordered matrix has no inertia of interest")


@final
@dataclass(frozen=True)
class Bordered(Equations[tuple[Matrix, Array]], Generic[Matrix]):
    """A problem under a load factor that is an unknown too: the last one, after the flattened unknowns.

    See theory 8, eq. 5 and 6. ``inner`` is the problem under the whole load, ``plane`` the further equation, which
    counts as a force of ``unit`` where it is out by its length.
    """

    inner: Problem[Matrix]
    plane: Plane
    unit: float

    def joined(self, x: Array, factor: float) -> Array:
        """Unknowns of the whole."""
        return np.append(x.ravel(), factor)

    def parts(self, point: Array) -> tuple[Array, float]:
        """Unknowns of the problem, and the load factor."""
        return point[:-1].reshape(self.inner.origin.shape), float(point[-1])

    def linearise(
        self, x: Array, geometric: int, stresses: list[Array] | None = None
    ) -> tuple[Array, tuple[Matrix, Array]]:
        """Gradient and the plane's equation (N + 1,); Hessian, and load on the free unknowns."""
        position, factor = self.parts(x)
        gradient, hessian = self.inner.loaded(factor).linearise(position, geometric, stresses)
        plane = self.plane
        off = float(plane.normal @ self.inner.difference(position, plane.x)) + plane.slope * (factor - plane.factor)
        whole = np.append(gradient, self.unit * off / plane.length)
        return whole, (hessian, self.inner.push_at(position))

    def factor(self, hessian: tuple[Matrix, Array]) -> _BorderedFactor[Matrix]:
        """Factor by block elimination; SolverError if the Hessian is singular."""
        return _BorderedFactor(self.inner.factor(hessian[0]), hessian[1], self.plane, self.unit)

    def moved(self, x: Array, direction: Array, reach: float | None = None) -> tuple[Array, list[Array], float]:
        """A step of the problem, and the same share of that of the factor."""
        position, factor = self.parts(x)
        position, stresses, share = self.inner.moved(position, direction[:-1], reach)
        return self.joined(position, factor + share * float(direction[-1])), stresses, share

    def measure(self, force: Array) -> float:
        """Size of the force, the plane's equation in it."""
        return float(np.hypot(self.inner.measure(force[:-1]), force[-1]))

    def rounding(self, x: Array, hessian: tuple[Matrix, Array], length: float) -> float:
        """That of the problem."""
        return self.inner.rounding(self.parts(x)[0], hessian[0], length)
