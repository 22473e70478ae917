"""Velocity Verlet of full models (theory 12, eq. 12)."""

from __future__ import annotations

from typing import final

from modalshell.core.typing import Array
from modalshell.integrators.full.base import Body, FullIntegrator, inner_force, led_rates, pull_rate, symplectic_limit
from modalshell.integrators.state import MotionState
from modalshell.shell.damping import Damping


@final
class Verlet(FullIntegrator, key="verlet"):
    """Velocity Verlet, ``x+ - 2 x + x- = h^2 a``, as two half kicks about a drift [hairer2006, section I.1].

    Order two, one in the damping that follows strain rates; symplectic. Damping of the mass is taken at mid-step, so
    that it is stable while ``h^2 lambda + 2 h zeta lambda < 4`` for the stiffest mode. The inner force at the step's
    end is kept for the next one, viscous damping in it: one evaluation a step.
    """

    name = "Verlet"
    explicit = True

    def start(self, body: Body, positions: Array) -> MotionState:
        """State at rest, its inner force with it."""
        state = super().start(body, positions)
        state.memory["force"] = inner_force(body.shell, positions, state.rates, Damping())
        return state

    def step(
        self, body: Body, state: MotionState, dt: float, load: Array, damping: Damping, held: Array | None
    ) -> tuple[MotionState, bool]:
        """Half a kick, a drift, and half a kick."""
        shell, x, inner = body.shell, state.coordinates, state.memory.get("force")
        drag, kick = 0.5 * dt * damping.mass_factor, 0.5 * dt / shell.mass[:, None]
        by_supports = pull_rate(body, x, dt)
        inner = inner_force(body.start_shell, x, state.rates, damping, by_supports) if inner is None else inner
        middle = state.rates * (1.0 - drag) + kick * (load + inner)
        middle = led_rates(shell, middle, x, dt, held)
        x = x + dt * middle
        inner = inner_force(shell, x, middle, damping, by_supports)
        rates = shell.unknowns.project((middle + kick * (load + inner)) / (1.0 + drag), shell.mass)
        rates[shell.clamped] = middle[shell.clamped]
        return MotionState(x, rates, {"force": inner}), True

    def stable_step(self, stiffness: float, drag: float, viscosity: float) -> float:  # noqa: ARG002 (at mid-step)
        """Longest stable step [s]."""
        return symplectic_limit(stiffness, viscosity)
