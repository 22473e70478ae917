"""Linearised implicit Euler of full models."""

from __future__ import annotations

import copy
from typing import final

import numpy as np

from modalshell.core.typing import Array
from modalshell.integrators.full.base import Body, FullIntegrator, hold, pull_rate, step_potential
from modalshell.integrators.state import MotionState
from modalshell.shell import PROJECTED
from modalshell.shell.damping import Damping


class LinearisedEuler(FullIntegrator):
    """A rule of one linearised step of implicit Euler; small oscillations go as by that one."""

    def growth(self, rate: complex) -> complex:
        """``1 / (1 - h lambda)``."""
        return 1.0 / (1.0 - rate)

    def local_error(self, before: MotionState, after: MotionState, dt: float) -> Array:
        """``h^2 v' / 2``."""
        return 0.5 * dt * (after.rates - before.rates)


@final
class LinearImplicitEuler(LinearisedEuler, key="linear_implicit"):
    """One Newton step of implicit Euler from where the shell is, its Hessian projected [baraff1998, eq. 6].

    Order one. As stable as implicit Euler while one linearisation serves a step.
    """

    name = "linearised implicit Euler"
    takes_live = True

    def step(
        self, body: Body, state: MotionState, dt: float, load: Array, damping: Damping, held: Array | None
    ) -> tuple[MotionState, bool]:
        """Solve one system of linear equations; a shell whose equations cannot be factored stays where it is."""
        x, shell = state.coordinates, body.shell
        if shell is not body.start_shell:  # linear in the way of what clamps the edges, too
            by_supports = pull_rate(body, x, dt)
            load = load - (dt + damping.stiffness_factor) * by_supports
            body, shell = copy.copy(body), body.start_shell
            body.shell = shell
        viscosity = None
        if damping.stiffness_factor or shell.has_dashpots:
            viscosity = shell.damping_matrix(x, damping.stiffness_factor)
        problem, _ = step_potential(body, x, state.rates, dt, load, damping, viscosity)
        move = hold(shell, x, held) - x
        gradient, hessian = problem.linearise(x, PROJECTED, led=move)
        factor = problem.definite_factor(hessian)
        if factor is None:
            return MotionState(x.copy(), np.zeros_like(x)), False
        move += shell.unknowns.prolong(problem.step(factor, gradient)).reshape(-1, 3)
        return MotionState(x + move, move / dt), True
