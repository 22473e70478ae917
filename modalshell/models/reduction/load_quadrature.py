"""Hyper-reduction of loads that change: their modal forces from a few weighted points."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from modalshell.core.typing import Array
from modalshell.integrators.modal.base import DeadForce
from modalshell.kernels import rotations
from modalshell.loads import AppliedLoad, Loading
from modalshell.loads.surface_kernels import APART, LINEAR
from modalshell.models.reduction.load_points import LoadPoints
from modalshell.modes import Basis

_PATCHES = 64
"""Patches of the surface: wind is then within some 1 % of the sum over all triangles, pressure within 0.1 %."""
OfSum = Callable[[Sequence[Array]], Callable[[Array], DeadForce]]


@final
@dataclass(frozen=True)
class ModalPush:
    """How forces push on a model's coordinates."""

    way: int
    """LINEAR or TURNED where forces at points do by the modes there; else APART, and ``at_points`` says how."""
    at_points: Callable[[Array, Array], Array] | None = None
    """Modal forces (m,) at q (m,) of forces (k, 3) [N] at the points."""
    of_constant: Callable[[Array], Callable[[Array], Array]] | None = None
    """Modal forces (m,) at q (m,) of forces (n, 3) [N] that do not change, as a function of q."""
    of_sum: OfSum | None = None
    """Modal force of a sum of some forces (n, 3) [N] times factors, as a function of these (k,). Without either, forces
    that do not change are better added to the load."""

    @classmethod
    def by_modes(cls, basis: Basis) -> ModalPush:
        """By the modes as they are."""

        def of_sum(forces: Sequence[Array]) -> Callable[[Array], DeadForce]:
            pushed = np.array([basis.modes.T @ force.ravel() for force in forces])
            return lambda factors: DeadForce(lambda _: factors @ pushed)

        return cls(LINEAR, of_sum=of_sum)

    @classmethod
    def by_work(cls, points: LoadPoints, of_sum: OfSum) -> ModalPush:
        """By the gradient of the work on warped points."""
        modes, turns = (rows.reshape(-1, rows.shape[2]) for rows in (points.modes, points.turns))

        def at_points(q: Array, forces: Array) -> Array:
            averaged, slope = np.empty_like(forces), np.empty_like(forces)
            rotations.warped_work((turns @ q).reshape(-1, 3), (modes @ q).reshape(-1, 3), forces, averaged, slope)
            return np.asarray(averaged.ravel() @ modes + slope.ravel() @ turns)

        return cls(APART, at_points, of_sum=of_sum)


def _constant(load: AppliedLoad, rest: Array) -> Array:
    """Forces (n, 3) [N] of a load at ``rest`` (n, 3) [m] without its factor."""
    return replace(load, factor=None).force(rest) if load.constant is None else load.constant


@final
class LoadQuadrature:
    """The loads that change, as modal forces: those on the shell at rest in full, what they change by at points.

    They change by a factor alone, or are of a form; ``push`` says how a model is pushed at given points.
    """

    def __init__(self, basis: Basis, loads: tuple[AppliedLoad, ...], push: Callable[[LoadPoints], ModalPush]) -> None:
        self._count = basis.count
        self._points = LoadPoints(basis, tuple(load for load in loads if load.constant is None), _PATCHES)
        self._push = push(self._points)
        self._rest = basis.shell.mesh.vertices
        self._fields = [load for load in loads if load.constant is None and load.is_field]
        constant = [(load, _constant(load, self._rest)) for load in loads if load not in self._fields]
        known = self._push.of_constant
        self._kept = [(load, known(force)) for load, force in constant] if known else []
        self._added = [] if known else constant
        self._summed: tuple[Array, Callable[[Array], DeadForce]] | None = None

    @classmethod
    def of(cls, basis: Basis, loading: Loading, push: Callable[[LoadPoints], ModalPush]) -> LoadQuadrature | None:
        """The quadrature of the loads that change; None without any, or where one cannot be summed so."""
        if not loading.live or any(load.constant is None and load.form is None for load in loading.live):
            return None
        return cls(basis, loading.live, push)

    @property
    def by_points(self) -> bool:
        """Whether any load is summed at points, which takes positions."""
        return bool(self._points.count)

    def dead_force(self, load: Array, time: float) -> DeadForce | None:
        """Modal force of a load (n, 3) [N] with those of :meth:`dead`; None where that is to be asked for.

        The load is known by its array.
        """
        if self._push.of_sum is None or self._fields:
            return None
        if self._summed is None or self._summed[0] is not load:
            self._summed = load, self._push.of_sum([load, *(force for _, force in self._added)])
        return self._summed[1](np.array([1.0, *(changing.factor_at(time) for changing, _ in self._added)]))

    def dead(self, load: Array, time: float) -> Array:
        """The load (n, 3) [N] with those on the shell at rest that are best added to it."""
        for changing, force in self._added:
            load = load + changing.factor_at(time) * force
        if self._fields:
            load = load.copy()
            for field in self._fields:
                field.add_force(self._rest, self._rest, 0.0, time, load)
        return load

    def push(self, q: Array, x: Array, before: Array, rate: float, time: float) -> tuple[Array, Array]:
        """Modal forces (m,) at coordinates q and positions (n, 3), and minus their derivatives by the rates (m, m).

        Velocities are ``rate (x - before)``. Without those of :meth:`dead`.
        """
        push, drag = np.zeros(self._count), np.zeros((self._count, self._count))
        if self.by_points:
            forces = self._points.forces(q, x, before, rate, time, self._push.way, push, drag)
            if self._push.at_points is not None:
                push += self._push.at_points(q, forces)
        for load, modal in self._kept:
            push += load.factor_at(time) * modal(q)
        return push, drag
