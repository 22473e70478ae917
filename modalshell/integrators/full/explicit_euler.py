"""Explicit (symplectic) Euler of full models."""

from __future__ import annotations

from typing import final

from modalshell.core.typing import Array
from modalshell.integrators.full.base import Body, FullIntegrator, inner_force, led_rates, pull_rate, symplectic_limit
from modalshell.integrators.state import MotionState
from modalshell.shell.damping import Damping


@final
class ExplicitEuler(FullIntegrator, key="explicit"):
    """Explicit Euler whose new velocity moves the positions: symplectic Euler [hairer2006, section I.1].

    Order one; the choice of [choi2007] for discrete shells. Stable while ``h^2 lambda + 2 h c < 4`` for the stiffest
    mode, with its whole damping ``c = xi + zeta lambda``.
    """

    name = "explicit Euler"
    explicit = True
    leads = 0.0  # ahead, it would not be symplectic under loads that follow positions

    def step(
        self, body: Body, state: MotionState, dt: float, load: Array, damping: Damping, held: Array | None
    ) -> tuple[MotionState, bool]:
        """Velocity first, then positions."""
        shell, x = body.start_shell, state.coordinates
        force = load + inner_force(shell, x, state.rates, damping, pull_rate(body, x, dt))
        rates = state.rates * (1.0 - dt * damping.mass_factor) + dt * force / shell.mass[:, None]
        rates = led_rates(shell, rates, x, dt, held)
        return MotionState(x + dt * rates, rates), True

    def stable_step(self, stiffness: float, drag: float, viscosity: float) -> float:
        """Longest stable step [s]."""
        return symplectic_limit(stiffness, viscosity + drag)
