"""Implicit Euler of full models."""

from __future__ import annotations

from typing import final

from modalshell.core.typing import Array
from modalshell.integrators.full.base import Body, FullIntegrator, hold, step_potential
from modalshell.integrators.state import Damping, MotionState
from modalshell.statics.potential import solve


@final
class ImplicitEuler(FullIntegrator, key="implicit"):
    """Implicit Euler, solved to the model's tolerance as the minimum of the step's potential [hairer2006, section I.1].

    Order one. Stable at any step; it loses energy: small oscillations shrink by ``(1 + h c + h^2 lambda)^(-1/2)`` a
    step. Viscosity is that of the step's beginning.
    """

    name = "implicit Euler"
    takes_live = True

    def step(
        self, body: Body, state: MotionState, dt: float, load: Array, damping: Damping, held: Array | None
    ) -> tuple[MotionState, bool]:
        """Minimise the step's incremental potential, starting from the explicit prediction."""
        x, shell = state.coordinates, body.shell
        problem, scale = step_potential(body, state, dt, load, damping)
        start = hold(shell, x + dt * state.rates, held)
        # Where what clamps the edges has moved on, the stresses there are not those at the step's beginning.
        at = x if shell is body.start_shell else start
        result = solve(problem, start, scale, body.step_tolerance, shell.predicted_stresses(at, start - at))
        return MotionState(result.point, (result.point - x) / dt), result.converged
