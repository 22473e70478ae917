"""Implicit Euler of full models (theory 12, eq. 3 and 4)."""

from __future__ import annotations

from typing import final

from modalshell.integrators.full.base import EulerRule
from modalshell.integrators.full.implicit_rule import EulerSteps, ImplicitRule, euler_step
from modalshell.integrators.state import MotionState


@final
class ImplicitEuler(EulerRule, ImplicitRule, key="implicit", alias="implicit_euler"):
    """Implicit Euler, solved to the model's tolerance as the minimum of the step's potential [hairer2006, section I.1].

    Order one. Stable at any step; it loses energy: small oscillations shrink by ``(1 + h c + h^2 lambda)^(-1/2)`` a
    step, as by an additional damping ratio of ``h omega / 2``. Damping by the stiffness
    takes the change of the measures over the step (theory 12, eq. 10).
    """

    name = "implicit Euler"

    def march(self, euler: EulerSteps, state: MotionState, dt: float) -> tuple[MotionState, bool]:
        """One step, from the state itself."""
        after, solved = euler_step(euler, state, dt, 0.0, 1.0)
        return euler.landed(state, after, dt), solved
