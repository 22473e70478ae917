"""Base of modal integrators: the step, and the linear theory that follows from it."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modalshell.core.registry import Registry
from modalshell.core.typing import Array
from modalshell.integrators.base import Integrator
from modalshell.integrators.state import MotionState

Force = Callable[[Array], Array]
"""Modal force at coordinates of any shape (..., m), in the same shape."""
ForceInTime = Callable[[Array, Array, float], Array]
"""Modal force (m,) at coordinates (m,) and rates (m,), at a share of the step from its beginning."""
ForceChange = Callable[[Array, Array, Array], Array | None]
"""Change of a modal force from coordinates (m,) to others near by, given the force at the first; None if not known."""
Step = float | Array


class DeadForce(NamedTuple):
    """Modal force of one load, as it is at the end of a step."""

    at: Force
    """The force at coordinates."""
    change: ForceChange | None = None
    """What tells cheaply how it changes over a short way, if anything does."""
    step: Callable[..., None] | None = None
    """A whole step of the exponential rule under it in one call, if there is one, with the arguments of
    :func:`~modalshell.models.reduction.warp_step_kernels.warp_step` from ``c`` on."""
    work: Callable[[Array], float] | None = None
    """The load's work [J] from rest to coordinates, where that takes less than a pass over the vertices."""
    push: tuple[Array, Array] | None = None
    """Modal data and load of :func:`~modalshell.kernels.push.push_frame`, where the force is by that.

    Or no data, and the force, where it stays.
    """
    by_work: bool = False
    """Whether the force is that of :func:`~modalshell.kernels.push.work_frame` instead."""
    stay: Callable[..., Any] | None = None
    """A step of SDIRK2 under it in which some vertices (k,) stay pushed in one call, if there is one. It takes these,
    and the arguments of :func:`~modalshell.models.reduction.rotation_strain_stay.stay_twice` from ``rows`` to ``out``,
    the last without the fit's right side."""


class ModalStep(NamedTuple):
    """What a rule knows of a step."""

    stiffness: Array
    damp: Array
    """As in :meth:`ModalIntegrator.step`. Shape (m,)."""
    h: float
    """Length [s]."""
    size: float
    """Size of the shell in the norm of the mass [m sqrt(kg)]."""
    dead: DeadForce | None = None
    """The force, where it is that of a load by itself."""


class ModalIntegrator(Integrator):
    """A rule for ``q'' + c q' + lambda q = p(q)``, every mode by itself but for the modal force p.

    A subclass defines the step. It is linear in q, v and p, so that its linear theory is obtained by
    stepping unit vectors: a new rule needs no more than :meth:`step`.
    """

    backward: ClassVar[bool] = True
    """Whether rates are the differences of the coordinates over a step."""
    forced_at: ClassVar[float] = 1.0
    """Share of a step at which the last force is taken that it asks for."""

    known: ClassVar[Registry[type[ModalIntegrator]]] = Registry("integrator")

    @abstractmethod
    def step(self, q: Array, v: Array, force: Force, stiffness: Array, damp: Array, h: Step) -> tuple[Array, Array]:
        """Coordinates and rates after one step.

        Parameters
        ----------
        q, v : ndarray, shape (..., m)
            Coordinates and their rates, of one motion or of many.
        force : callable
            Modal force p at given coordinates.
        stiffness : ndarray, shape (m,)
            Squared angular frequencies lambda [1/s^2].
        damp : ndarray, shape (m,)
            Modal damping c = xi + zeta lambda [1/s].
        h : float or ndarray, shape (m,)
            Step [s].
        """

    def at_rest(self, coordinates: Array) -> MotionState:
        """State at rest, with what the rule keeps from step to step."""
        return MotionState(coordinates, np.zeros_like(coordinates))

    def under_turning_forces(self) -> ModalIntegrator:
        """The rule for forces that turn with the shell; itself, unless it has another one for them."""
        return self

    def advance(self, state: MotionState, force: ForceInTime, step: ModalStep) -> MotionState:
        """State after one step from ``state``, under a modal force whose rates are those of the coordinates."""
        q, v, h = state.coordinates, state.rates, step.h
        return MotionState(*self.step(q, v, lambda q: force(q, v, 1.0), step.stiffness, step.damp, h))

    def stood_in_for(
        self,
        before: MotionState,  # noqa: ARG002 (for rules that keep something)
        after: MotionState,
        force: Array,  # noqa: ARG002
        h: float,  # noqa: ARG002
    ) -> MotionState:
        """``after`` a step of ``h`` [s] by implicit Euler from ``before`` under a ``force`` (m,)."""
        return MotionState(after.coordinates, after.rates)

    def response(self, stiffness: Array, damp: Array, h: float) -> tuple[Array, Array]:
        """Change (m,) of coordinates and rates within a step per unit of modal force at its end."""
        return self.impulse(stiffness, damp, h)

    def local_error(
        self,
        before: MotionState,  # noqa: ARG002
        after: MotionState,  # noqa: ARG002
        stiffness: Array,  # noqa: ARG002
        h: float,  # noqa: ARG002
    ) -> Array | None:
        """Error (m,) in the coordinates that a step has made; None where it is not known."""
        return None

    def impulse(self, stiffness: Array, damp: Array, h: float) -> tuple[Array, Array]:
        """Change (m,) of coordinates [s^2] and rates [s] within a step per unit of a modal force throughout it."""
        rest = np.zeros_like(stiffness)
        return self.step(rest, rest, np.ones_like, stiffness, damp, h)

    def matrix(self, stiffness: Array, damp: Array, h: float, slope: Array) -> Array:
        """Matrix (2m, 2m) that takes small deviations of q and v over a step, under modal forces ``slope q`` (m, m).

        Larger where a rule keeps more.
        """
        q, v = np.split(np.eye(2 * stiffness.size), 2, axis=1)
        return np.hstack(self.step(q, v, lambda q: q @ slope.T, stiffness, damp, h)).T

    def multipliers(self, stiffness: ArrayLike, damp: ArrayLike, h: ArrayLike) -> NDArray[np.complex128]:
        """Eigenvalues (k, 2) of the step of free motion: what its two parts are multiplied by.

        The three may each be one number or k of them.
        """
        each: list[Array] = np.atleast_1d(*np.broadcast_arrays(stiffness, damp, h))
        q, v = np.eye(2)[:, :, None] * np.ones(each[0].size)
        matrices = np.stack(self.step(q, v, np.zeros_like, *each)).transpose(2, 0, 1)
        return np.linalg.eigvals(matrices).astype(np.complex128)

    def amplification(self, stiffness: ArrayLike, damp: ArrayLike, h: ArrayLike) -> Array:
        """Factor (k,) by which the slower part of free motion decays per step."""
        return np.abs(self.multipliers(stiffness, damp, h)).max(axis=1)

    def frequency(self, stiffness: ArrayLike, damp: ArrayLike, h: ArrayLike) -> Array:
        """Angular frequency (k,) [rad/s] with which steps of ``h`` oscillate; zero for motion that creeps."""
        return np.abs(np.angle(self.multipliers(stiffness, damp, h))).max(axis=1) / h

    def decay_rate(self, stiffness: Array, damp: Array, h: float) -> float:
        """Rate [1/s] at which the slowest mode loses energy, numerical damping included; 0 with rigid modes."""
        factor = max(float(self.amplification(stiffness, damp, h).max()), np.finfo(float).tiny)
        return max(0.0, -2.0 * float(np.log(factor)) / h)
