"""Implicit midpoint rule of modal coordinates."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar, final

from modalshell.core.typing import Array
from modalshell.integrators.modal.base import Force, ForceInTime, ModalIntegrator, ModalStep, Step
from modalshell.integrators.state import MotionState


@final
class ImplicitMidpoint(ModalIntegrator, key="implicit_midpoint"):
    r"""The implicit midpoint rule, with the modal force of a predicted middle [hairer2006, section I.1].

    Half a step of implicit Euler, extrapolated to the end. Second order, at two modal forces a step, both at its
    middle. Stable at any step under dead modal forces; it keeps the energy of undamped linear motion, stiff modes
    ringing on at the frequency :math:`2 \arctan(h \omega / 2) / h`. Forces that turn with the shell lag by half a step,
    and can feed undamped motion more than by implicit Euler.
    """

    name = "midpoint"
    backward = False
    forced_at: ClassVar[float] = 0.5

    def advance(self, state: MotionState, force: ForceInTime, step: ModalStep) -> MotionState:
        """State after a step."""
        q, v = state.coordinates, state.rates
        return MotionState(*_moved(q, v, lambda q, v: force(q, v, 0.5), step.stiffness, step.damp, step.h))

    def step(self, q: Array, v: Array, force: Force, stiffness: Array, damp: Array, h: Step) -> tuple[Array, Array]:
        """Coordinates and rates after a step."""
        return _moved(q, v, lambda q, _: force(q), stiffness, damp, h)


def _moved(
    q: Array, v: Array, force: Callable[[Array, Array], Array], stiffness: Array, damp: Array, h: Step
) -> tuple[Array, Array]:
    """Coordinates and rates after a step under a force of both at its middle."""
    half = 0.5 * h
    inertia = 1.0 + half * damp + half**2 * stiffness
    middle = (v + half * (force(q, v) - stiffness * q)) / inertia
    # The force at the step's beginning would feed energy into large motion: it only leads to where the middle is.
    middle = (v + half * (force(q + half * middle, middle) - stiffness * q)) / inertia
    return q + h * middle, 2.0 * middle - v
