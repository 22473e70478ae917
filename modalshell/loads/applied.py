"""Element forces of a load on one shell, and their stiffness by complex steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from modalshell.core.thread_safety import writeable
from modalshell.core.typing import Array, Index
from modalshell.loads.averaged import averaged
from modalshell.loads.surface_kernels import surface_forces

_STEP = 1e-30
"""Imaginary step of complex-step derivatives, which are free of cancellation."""

Corners = NDArray[Any]
"""Corners (E, k, 3) of elements, real, or complex where a derivative is taken."""
Forces = Callable[[Corners, Corners, float, Index], Corners]
"""Forces (E, k, 3) [N] at corners [m], velocities [m/s] and a time [s] of the elements of some numbers (E,)."""


@final
@dataclass(frozen=True, eq=False)
class SurfaceForm:
    """A load on triangles in numbers, from which kernels make its forces: see :class:`modalshell.Wind`."""

    pressure: float = 0.0
    """Along the normals [Pa]."""
    by_normal: float = 0.0
    by_tangent: float = 0.0
    """Half the density of the air times the coefficients of its velocity across and along [kg/m^3]."""
    velocity: Array | Callable[[Array, float], Array] | None = None
    """Of the air [m/s]: everywhere, or ``velocity(points, time)``. Shape (3,)."""

    @property
    def sizes(self) -> Array:
        """Pressure and both coefficients (3,)."""
        return np.array([self.pressure, self.by_normal, self.by_tangent])

    def air(self, x: Array, faces: Index, time: float) -> Array:
        """Velocity of the air [m/s] at the centres of triangles (k, 3) at positions x (n, 3): (k, 3), or (1, 3)."""
        if self.velocity is None:
            return np.zeros((1, 3))
        if callable(self.velocity):
            first, second, third = (x[faces[:, corner]] for corner in range(3))  # a mean over an axis takes thrice that
            return np.ascontiguousarray(self.velocity((first + second + third) / 3.0, time), dtype=np.float64)
        return np.array(self.velocity)[None]


@final
@dataclass(frozen=True, eq=False)
class TurningForm:
    """Numeric data of a load on corners of triangles that rotates with them."""

    weights: Array
    """Weight of each corner in the force; shape (E, 3)."""
    vector: Array | None = None
    """The force [N] on the shape at rest; by default a unit normal. Shape (3,)."""


@final
@dataclass(frozen=True, eq=False)
class BodyForm:
    """A load by mass that is linear in positions and velocities, in numbers: ``m (c - X x - V v)``."""

    mass: Array
    """Of the vertices [kg]; shape (n,)."""
    constant: Array
    """c [m/s^2]; shape (3,)."""
    by_position: Array
    by_velocity: Array
    """X [1/s^2] and V [1/s]; shape (3, 3)."""


@final
@dataclass(frozen=True, eq=False)
class AppliedLoad:
    """Forces on the corners of elements, which follow the corners' positions and velocities, and the time."""

    stencils: Index
    """Vertices of each element; shape (E, k)."""
    forces: Forces
    """Forces (E, k, 3) [N] of corners (E, k, 3) [m], velocities (E, k, 3) [m/s], the time [s] and the elements' numbers
    (E,); it must take complex corners and velocities, from which its derivatives come."""
    energy: Callable[[Array], float] | None = None
    """Potential [J] of positions (n, 3) [m]; None for a load without a potential."""
    held: Index | None = None
    """Vertices that must be held for the potential to be one."""
    by_position: bool = True
    by_velocity: bool = False
    """What the forces depend on."""
    factor: Callable[[float], float] | None = None
    """Factor on the forces at a time [s]."""
    form: SurfaceForm | TurningForm | BodyForm | None = None
    """The load in numbers, if it is of such a form; elements of a :class:`BodyForm` are the vertices, one by one."""
    constant: Array | None = None
    """Its forces [N], if they depend only on the factor; shape (n, 3)."""
    times: tuple[float, ...] = (0.0,)
    """Times [s] at one of which the factor is at its largest, as far as that is known."""
    bends: tuple[float, ...] = ()
    """Times [s] between which the factor is straight, or a product of straight ones, as far as that is known."""

    @property
    def is_dead(self) -> bool:
        """Whether the forces never change."""
        return not (self.by_position or self.by_velocity or self.factor)

    @property
    def is_field(self) -> bool:
        """Whether the forces at rest change by more than the factor, as those of wind by a function of time may."""
        return isinstance(self.form, SurfaceForm) and callable(self.form.velocity)

    def scaled(
        self, factor: Callable[[float], float], times: tuple[float, ...], bends: tuple[float, ...] = ()
    ) -> AppliedLoad:
        """The same load times a factor of time, at its largest at one of ``times``, that bends at ``bends`` [s]."""
        first = self.factor
        both = factor if first is None else lambda time: first(time) * factor(time)
        return replace(self, factor=both, times=(*self.times, *times), bends=(*self.bends, *bends))

    def averaged(self, dt: float, *, within: bool = False) -> AppliedLoad:
        """The same load as steps of ``dt`` [s] take it at their ends; see :func:`.averaged.averaged`."""
        if self.factor is None or not self.bends:
            return self
        return replace(self, factor=averaged(self.factor, self.bends, dt, within=within), bends=())

    def factor_at(self, time: float) -> float:
        """Factor on the forces at a time [s]."""
        return 1.0 if self.factor is None else self.factor(time)

    def element_forces(self, x: Array, velocity: Array | None, time: float, chosen: Index) -> Array:
        """Forces (E, k, 3) [N] of the elements ``chosen`` (E,) at positions and velocities (n, 3)."""
        stencils = self.stencils[chosen]
        corners = x[stencils]
        rates = np.zeros_like(corners) if velocity is None else velocity[stencils]
        return np.asarray(self.factor_at(time) * self.forces(corners, rates, time, chosen))

    def force(self, x: Array, velocity: Array | None = None, time: float = 0.0) -> Array:
        """Forces (n, 3) [N] at positions (n, 3) [m] and velocities (n, 3) [m/s]."""
        forces = self.element_forces(x, velocity, time, np.arange(len(self.stencils)))
        total = np.empty_like(x)
        for axis in range(3):
            total[:, axis] = np.bincount(self.stencils.ravel(), forces[:, :, axis].ravel(), len(x))
        return total

    def add_force(self, x: Array, before: Array, rate: float, time: float, total: Array) -> None:
        """Add the forces (n, 3) [N] at positions x (n, 3) [m] and velocities ``rate (x - before)`` to ``total``."""
        factor, form = self.factor_at(time), self.form
        if self.constant is not None:
            total += factor * self.constant
        elif isinstance(form, SurfaceForm):
            air = form.air(x, self.stencils, time)
            # One kind of arrays, so that the kernel is compiled once: positions at rest and air at rest are read-only.
            x, before, air = writeable(x), writeable(before), writeable(air)
            surface_forces(x, before, rate, self.stencils, factor * form.sizes, air, total)
        else:
            total += self.force(x, rate * (x - before) if self.by_velocity else None, time)

    def value(self, x: Array, time: float) -> float:
        """Potential [J]; 0 if there is none."""
        return 0.0 if self.energy is None else self.factor_at(time) * self.energy(x)

    def stiffness(self, x: Array, velocity: Array | None, time: float, rate: float) -> Array:
        """Minus the derivatives (E, k, 3, k, 3) [N/m] of the forces by the corners, velocities following at ``rate``.

        ``rate`` [1/s] is the change of a velocity by its corner, one over the step in an implicit step.
        """
        corners = x[self.stencils].astype(np.complex128)
        rates = np.zeros_like(corners) if velocity is None else velocity[self.stencils].astype(np.complex128)
        count, size, _ = corners.shape
        slopes = np.zeros((count, size, 3, size, 3))
        if not (self.by_position or (self.by_velocity and rate)):
            return slopes
        everything, factor = np.arange(count), self.factor_at(time)
        for corner in range(size):
            for axis in range(3):
                moved, sped = corners.copy(), rates.copy()
                moved[:, corner, axis] += 1j * _STEP
                sped[:, corner, axis] += 1j * _STEP * rate
                slopes[..., corner, axis] = self.forces(moved, sped, time, everything).imag * (-factor / _STEP)
        return slopes

    def drag(self, x: Array, velocity: Array, time: float, chosen: Index) -> Array:
        """Minus the derivatives (E, 3, 3) [N s/m] of an element's whole force by a common velocity of its corners."""
        corners, rates = x[self.stencils[chosen]].astype(np.complex128), velocity[self.stencils[chosen]]
        slopes = np.empty((len(chosen), 3, 3))
        for axis in range(3):
            sped = rates.astype(np.complex128)
            sped[:, :, axis] += 1j * _STEP
            forces = self.forces(corners, sped, time, chosen)
            slopes[:, :, axis] = forces.sum(axis=1).imag * (-self.factor_at(time) / _STEP)
        return slopes


def length(vectors: Corners) -> Corners:
    """Lengths (...,) of vectors (..., 3), complex ones continued analytically."""
    return np.sqrt(np.sum(vectors * vectors, axis=-1))
