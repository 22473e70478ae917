"""Implicit Euler of modal coordinates."""

from __future__ import annotations

from typing import final

from modalshell.core.typing import Array
from modalshell.integrators.modal.base import Force, ModalIntegrator, Step
from modalshell.integrators.state import MotionState


@final
class ImplicitEuler(ModalIntegrator, key="implicit_euler"):
    r"""Implicit Euler, with the modal force of the step's beginning [hairer2006, section I.1].

    .. math:: v_{n+1} = \frac{v_n + h (p(q_n) - \lambda q_n)}{1 + h c + h^2 \lambda}, \qquad q_{n+1} = q_n + h v_{n+1}

    Order one, at one modal force a step. Stable at any step under dead modal forces; it loses energy: oscillations
    shrink by :math:`(1 + h c + h^2 \lambda)^{-1/2}` a step. Forces that turn with the shell lag by a step, and can feed
    undamped motion.
    """

    name = "implicit Euler"

    def local_error(self, before: MotionState, after: MotionState, stiffness: Array, h: float) -> Array:  # noqa: ARG002
        """``h^2 v' / 2``."""
        return 0.5 * h * (after.rates - before.rates)

    def step(self, q: Array, v: Array, force: Force, stiffness: Array, damp: Array, h: Step) -> tuple[Array, Array]:
        """Coordinates and rates after a step."""
        v = (v + h * (force(q) - stiffness * q)) / (1.0 + h * damp + h**2 * stiffness)
        return q + h * v, v
