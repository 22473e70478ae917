"""BDF2, the backward difference formula of order two."""

from __future__ import annotations

import cmath
from typing import final

from modalshell.core.typing import Array
from modalshell.integrators.full.implicit_rule import (
    VIOLENT,
    EulerStart,
    EulerSteps,
    ImplicitRule,
    euler_step,
    kept,
    second_order_at_rest,
    second_order_error,
    two_euler_steps,
)
from modalshell.integrators.state import MotionState


@final
class BDF2(ImplicitRule, key="bdf2"):
    r"""BDF2 [hairer1996, section V.1], as one step of implicit Euler.

    With :math:`w = h / h_{n-1}`, one where steps are alike, its length is :math:`h' = h (1 + w) / (1 + 2 w)`, and it
    begins at

    .. math:: x' = x_n + \frac{w^2}{1 + 2 w} (x_n - x_{n-1}), \qquad v' = v_n + \frac{w^2}{1 + 2 w} (v_n - v_{n-1}).

    Order two, at one solve a step. Stable at any step; stiff motion dies at once. A damping ratio is within 1 % of
    0.01, 0.03 or 0.1 from 75, 45 or 20 steps a period on. It begins with two half steps of implicit Euler, and takes
    one of a whole step where the motion is violent.
    """

    name = "BDF2"

    def at_rest(self, coordinates: Array) -> MotionState:
        """State at rest, with room for what is kept of a step."""
        return second_order_at_rest(coordinates)

    def growth(self, rate: complex) -> complex:
        """The larger root of ``(3/2 - h lambda) r^2 - 2 r + 1/2 = 0``."""
        root = cmath.sqrt(1.0 + 2.0 * rate)
        return max((2.0 + root) / (3.0 - 2.0 * rate), (2.0 - root) / (3.0 - 2.0 * rate), key=abs)

    def local_error(self, before: MotionState, after: MotionState, dt: float) -> Array:  # noqa: ARG002
        """``h^3 v'' / 3``: its truncation error, 2/9 of that, over what is left of a difference from step to step."""
        return second_order_error(1.0 / 3.0, after, dt)

    def march(self, euler: EulerSteps, state: MotionState, dt: float) -> tuple[MotionState, bool]:
        """One solve, or steps of implicit Euler instead."""
        x, v, memory = state.coordinates, state.rates, state.memory
        solved, order = False, 1
        if not memory["order"][0]:
            after, solved = two_euler_steps(euler, state, dt)
        else:
            ratio = dt / memory["step"][0]
            move, gain = ratio * memory["move"], ratio * memory["gain"]
            if euler.turn(x, dt * gain) <= VIOLENT:
                ahead, length = ratio / (1.0 + 2.0 * ratio), dt * (1.0 + ratio) / (1.0 + 2.0 * ratio)
                start = EulerStart(x + ahead * move, v + ahead * gain, length, 1.0, v + gain, x, x + move, 1.0)
                after, solved = euler.solve(start)
                order = 2
        if not solved:
            after, solved = euler_step(euler, state, dt, 0.0, 1.0)
            order = 1
        return kept(state, after, dt, order), solved
