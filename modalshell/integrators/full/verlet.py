"""Velocity Verlet of full models."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from modalshell.integrators.full.base import (
    Body,
    FullIntegrator,
    inner_force,
    led_rates,
    symplectic_limit,
)
from modalshell.integrators.state import Damping, Memory, MotionState
from modalshell.typing import Array


@final
@dataclass(frozen=True)
class InnerForce(Memory):
    """Elastic force and viscous damping (n, 3) [N] at the state's positions."""

    force: Array

    def turned(self, rotation: Array) -> InnerForce:
        """The same in a frame that ``rotation`` (3, 3) leads to."""
        return InnerForce(self.force @ rotation.T)


@final
class Verlet(FullIntegrator, key="verlet"):
    """Velocity Verlet, ``x+ - 2 x + x- = h^2 a``, as two half kicks about a drift [hairer2006, section I.1].

    Order two, one in the damping that follows strain rates; symplectic. Damping of the mass is taken at mid-step, so
    that it is stable while ``h^2 lambda + 2 h zeta lambda < 4`` for the stiffest mode. The inner force at the step's
    end is kept for the next one: one evaluation a step.
    """

    name = "Verlet"
    explicit = True

    def start(self, body: Body, positions: Array) -> MotionState:
        """State at rest, its inner force with it."""
        state = super().start(body, positions)
        state.memory = InnerForce(inner_force(body.shell, positions, state.rates, Damping()))
        return state

    def step(
        self, body: Body, state: MotionState, dt: float, load: Array, damping: Damping, held: Array | None
    ) -> tuple[MotionState, bool]:
        """Half a kick, a drift, and half a kick."""
        shell, x, kept = body.shell, state.coordinates, state.memory
        drag, kick = 0.5 * dt * damping.mass_factor, 0.5 * dt / shell.mass[:, None]
        inner = kept.force if isinstance(kept, InnerForce) else inner_force(shell, x, state.rates, damping)
        middle = state.rates * (1.0 - drag) + kick * (load + inner)
        middle[shell.clamped] = led_rates(shell, x, dt, held)
        x = x + dt * middle
        inner = inner_force(shell, x, middle, damping)
        rates = (middle + kick * (load + inner)) / (1.0 + drag)
        rates[shell.clamped] = middle[shell.clamped]
        return MotionState(x, rates, InnerForce(inner)), True

    def stable_step(self, stiffness: float, drag: float, viscosity: float) -> float:  # noqa: ARG002 (at mid-step)
        """Longest stable step [s]."""
        return symplectic_limit(stiffness, viscosity)
