"""Sum of all loads on one shell: a dead part, and parts that depend on positions, velocities or time."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import copy
from typing import final

import numpy as np

from modalshell.core.checks import checked_kind, checked_vectors, shown
from modalshell.core.errors import LoadError
from modalshell.core.typing import Array, Index, Mask
from modalshell.loads.applied import AppliedLoad
from modalshell.loads.base import Load
from modalshell.mesh import TriangleMesh

_SAMPLED = 200
"""Elements from which the drag of a load is found, at least."""


@final
class Loading:
    """The sum of all loads on one shell.

    ``rest`` are its positions (n, 3) [m], ``dead`` (n, 3) [N] is the sum of the dead loads, ``live`` are those that
    change, and ``held`` (n,) its held vertices.

    Attributes
    ----------
    loads : tuple of Load
        Its loads, without the initial dead force.
    conservative : bool
        Whether every load has a potential on this shell.
    """

    def __init__(self, rest: Array, dead: Array, live: Sequence[AppliedLoad] = (), held: Mask | None = None) -> None:
        self.rest, self.dead, self.live = rest, dead, tuple(live)
        self.loads: tuple[Load, ...] = ()
        self._potential = [
            one
            for one in self.live
            if one.energy is not None and (one.held is None or (held is not None and bool(held[one.held].all())))
        ]
        self.conservative = len(self._potential) == len(self.live)

    @classmethod
    def of(
        cls,
        mesh: TriangleMesh,
        mass: Array,
        rest: Array,
        held: Mask,
        dead: Array,
        loads: Sequence[Load],
    ) -> Loading:
        """The loads on a shell of vertex masses (n,) [kg] at ``rest`` (n, 3) [m], added to a dead one (n, 3) [N].

        LoadError where the forces of a load are of the wrong shape or not finite.
        """
        live, rest_of_mesh = [], np.asarray(mesh.vertices)
        if isinstance(loads, Load) or not isinstance(loads, Iterable):
            raise LoadError(f"loads must be a list of loads (got {shown(loads)}): write loads=[...]")
        loads = tuple(loads)
        for load in loads:
            checked_kind("each of loads", load, Load)  # type: ignore[type-abstract]
            applied = load.applied(mesh, mass)
            part = load.force(mesh) if applied is None else applied.force(rest_of_mesh)
            part = checked_vectors(f"the force of {type(load).__name__}", part, dead.shape)
            if applied is None or applied.is_dead:
                dead = dead + part
            else:
                live.append(applied)
        made = cls(rest, dead, live, held)
        made.loads = loads
        return made

    def averaged(self, dt: float, *, within: bool = False) -> Loading:
        """The same loads as steps of ``dt`` [s] take them at their ends; see :func:`.averaged.averaged`."""
        if not any(one.bends for one in self.live):
            return self
        other = copy(self)
        other.live = tuple(one.averaged(dt, within=within) for one in self.live)
        return other

    @property
    def steady(self) -> bool:
        """Whether the forces at given positions and velocities are the same at all times."""
        return all(one.factor is None for one in self.live)

    @property
    def by_velocity(self) -> bool:
        """Whether forces depend on velocities."""
        return any(one.by_velocity for one in self.live)

    def live_force(self, x: Array, velocity: Array | None = None, time: float = 0.0) -> Array:
        """Forces (n, 3) [N] of the loads that change, at positions (n, 3) [m] and velocities (n, 3) [m/s]."""
        total = np.zeros_like(self.dead)
        for one in self.live:
            total += one.force(x, velocity, time)
        return total

    def moving_force(self, dead: Array, x: Array, before: Array, rate: float, time: float) -> Array:
        """Forces (n, 3) [N] at x (n, 3) [m] and velocities ``rate (x - before)``, with ``dead`` ones (n, 3) [N]."""
        total = dead.copy()
        for one in self.live:
            one.add_force(x, before, rate, time, total)
        return total

    def force(self, x: Array, velocity: Array | None = None, time: float = 0.0) -> Array:
        """Forces (n, 3) [N] of all loads at positions (n, 3) [m] and velocities (n, 3) [m/s]."""
        return self.dead + self.live_force(x, velocity, time) if self.live else self.dead

    def largest_force(self) -> Array:
        """Forces (n, 3) [N] on the shape at rest of the loads that change, each with its largest factor."""
        total = np.zeros_like(self.dead)
        for one in self.live:
            largest = max(one.times, key=lambda moment, one=one: abs(one.factor_at(moment)))  # type: ignore[misc]
            total += one.force(self.rest, None, largest)
        return total

    def drag(self, x: Array, velocity: Array, time: float) -> tuple[Index, Array]:
        """Minus the forces' derivatives (k, 3, 3) [N s/m] by the velocity of their own vertex, at some vertices (k,).

        Of many elements some hundred stand for all: what it serves, the stability of a step, needs no more.
        """
        vertices, blocks = [np.empty(0, dtype=np.int64)], [np.empty((0, 3, 3))]
        for one in self.live:
            if one.by_velocity:
                count, size = one.stencils.shape
                chosen = np.arange(0, count, max(1, count // _SAMPLED))
                slopes = one.drag(x, velocity, time, chosen) * (count / len(chosen) / size)
                vertices.append(one.stencils[chosen].ravel())
                blocks.append(np.repeat(slopes, size, axis=0))
        return np.concatenate(vertices), np.concatenate(blocks)

    def live_energy(self, x: Array, time: float = 0.0) -> float:
        """Potential [J] of the loads that change and have one on some shell, zero at rest; for searches."""
        return sum(one.value(x, time) - one.value(self.rest, time) for one in self.live)

    def live_potential(self, x: Array, time: float = 0.0) -> float:
        """Potential [J] of the loads that change and have one on this shell, zero at rest."""
        total = 0.0
        for one in self._potential:
            if one.constant is None:
                total += one.value(x, time) - one.value(self.rest, time)
            else:
                total -= one.factor_at(time) * float(np.vdot(one.constant, x - self.rest))
        return total

    def energy(self, x: Array, time: float = 0.0) -> float:
        """Potential [J] of all loads that have one on this shell, zero at rest."""
        return self.live_potential(x, time) - float(np.vdot(self.dead, x - self.rest))
