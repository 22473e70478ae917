"""BDF2, the backward difference formula of order two."""

from __future__ import annotations

from typing import final

import numpy as np

from modalshell.core.typing import Array
from modalshell.integrators.full.implicit_rule import (
    VIOLENT,
    EulerStart,
    EulerSteps,
    ImplicitRule,
    euler_step,
    two_euler_steps,
)
from modalshell.integrators.state import MotionState


@final
class BDF2(ImplicitRule, key="bdf2"):
    r"""BDF2 [hairer1996, section V.1], as one step of implicit Euler.

    Its length is :math:`h' = 2h/3`, and it begins at

    .. math:: x' = (4 x_n - x_{n-1}) / 3, \qquad v' = (4 v_n - v_{n-1}) / 3.

    Order two, at one solve a step. Stable at any step; stiff motion dies at once. A damping ratio is within 1 % of
    0.01, 0.03 or 0.1 from 75, 45 or 20 steps a period on. It begins with two half steps of implicit Euler, and takes
    one of a whole step where the motion is violent.
    """

    name = "BDF2"

    def at_rest(self, coordinates: Array) -> MotionState:
        """State at rest; the last changes of coordinates and rates, and whether they are known, are kept."""
        none = np.zeros_like(coordinates)
        memory = {"move": none, "gain": none.copy(), "known": np.zeros(1)}
        return MotionState(coordinates, none.copy(), memory)

    def march(self, euler: EulerSteps, state: MotionState, dt: float) -> tuple[MotionState, bool]:
        """One solve, or steps of implicit Euler instead."""
        x, v, memory = state.coordinates, state.rates, state.memory
        move, gain = memory["move"], memory["gain"]
        solved = False
        if not memory["known"][0]:
            after, solved = two_euler_steps(euler, state, dt)
        elif euler.turn(x, dt * gain) <= VIOLENT:
            ahead = x + move
            made_of = (4.0 / 3.0, state), (-1.0 / 3.0, MotionState(x - move, v - gain))
            start = EulerStart(x + move / 3.0, v + gain / 3.0, dt / 1.5, 1.0, v + gain, x, ahead, 1.0, made_of)
            after, solved = euler.solve(start)
        if not solved:
            after, solved = euler_step(euler, state, dt, 0.0, 1.0)
        after = euler.landed(state, after, dt)
        kept = {"move": after.coordinates - x, "gain": after.rates - v, "known": np.ones(1)}
        return MotionState(after.coordinates, after.rates, kept), solved
