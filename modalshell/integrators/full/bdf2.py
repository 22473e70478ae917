"""BDF2, the backward difference formula of order two (theory 12, eq. 7)."""

from __future__ import annotations

import cmath
from typing import final

from modalshell.integrators.full.implicit_rule import EulerStart, EulerSteps
from modalshell.integrators.full.second_order import VIOLENT, SecondOrderRule
from modalshell.integrators.state import MotionState


@final
class BDF2(SecondOrderRule, key="bdf2"):
    r"""BDF2 [hairer1996, section V.1], as one step of implicit Euler.

    With :math:`w = h / h_{n-1}`, one where steps are alike, its length is :math:`h' = h (1 + w) / (1 + 2 w)`, and it
    begins at

    .. math:: x' = x_n + \frac{w^2}{1 + 2 w} (x_n - x_{n-1}), \qquad v' = v_n + \frac{w^2}{1 + 2 w} (v_n - v_{n-1}).

    Order two, at one solve a step. Stable at any step; stiff motion dies at once. A damping ratio is within 1 % of
    0.01, 0.03 or 0.1 from 75, 45 or 20 steps a period on. It begins with a step of SDIRK2, or with two half steps of
    implicit Euler where the motion is violent, and takes one of a whole step there later.
    """

    name = "BDF2"
    error_constant = 1.0 / 3.0  # its truncation error, 2/9, over what is left of a difference from step to step

    def growth(self, rate: complex) -> complex:
        """The larger root of ``(3/2 - h lambda) r^2 - 2 r + 1/2 = 0``."""
        root = cmath.sqrt(1.0 + 2.0 * rate)
        return max((2.0 + root) / (3.0 - 2.0 * rate), (2.0 - root) / (3.0 - 2.0 * rate), key=abs)

    def go_on(self, euler: EulerSteps, state: MotionState, dt: float) -> tuple[MotionState, bool]:
        """One solve."""
        x, v, memory = state.coordinates, state.rates, state.memory
        ratio = dt / memory["step"][0]
        move, gain = ratio * memory["move"], ratio * memory["gain"]
        if not euler.turn(x, dt * gain) <= VIOLENT:
            return state, False
        ahead, length = ratio / (1.0 + 2.0 * ratio), dt * (1.0 + ratio) / (1.0 + 2.0 * ratio)
        earlier = MotionState(x - memory["move"], v - memory["gain"])
        made_of = (1.0 + ahead * ratio, state, 0.0), (-ahead * ratio, earlier, -1.0 / ratio)
        begin, rates = x + ahead * move, v + ahead * gain
        start = EulerStart(begin, rates, length, 1.0, v + gain, x, 0.0, x + move, made_of, viscous_ahead=True)
        return euler.solve(start)
