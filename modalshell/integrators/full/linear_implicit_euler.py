"""Linearised implicit Euler of full models."""

from __future__ import annotations

import copy
import math
from dataclasses import replace
from typing import final

import numpy as np

from modalshell.core.typing import Array
from modalshell.integrators.full.base import Body, EulerRule, hold, pull_rate, step_potential
from modalshell.integrators.state import MotionState
from modalshell.shell import PROJECTED, Shell
from modalshell.shell.damping import Damping

_HELD_UP = "held_up"
"""Name in a state's memory of what :func:`_held_up` finds of a step (3,)."""


class LinearisedEuler(EulerRule):
    """A rule of one linearised step of implicit Euler."""


@final
class LinearImplicitEuler(LinearisedEuler, key="linear_implicit"):
    """One Newton step of implicit Euler from where the shell is, its Hessian projected [baraff1998, eq. 6].

    Order one. As stable as implicit Euler while one linearisation serves a step. Where sheets turn by more than a small
    angle in a step, it stretches them, and the tension holds the motion up. The error counts the velocity that the work
    of the force left at the step's end costs, and is known to a factor of three or so: where that force gives back what
    it took, as where a clamp turns slowly, it is said too high.
    """

    name = "linearised implicit Euler"
    takes_live = True

    def start(self, body: Body, positions: Array) -> MotionState:
        """State at rest, with what is kept of steps: see :func:`_held_up`."""
        state = super().start(body, positions)
        return MotionState(state.coordinates, state.rates, {_HELD_UP: np.zeros(3)})

    def local_error(self, before: MotionState, after: MotionState, dt: float) -> Array:
        """That of implicit Euler, and what the one linearisation costs, which is along the step's move."""
        error, move = super().local_error(before, after, dt), after.coordinates - before.coordinates
        share = float(after.memory[_HELD_UP][0])
        return error + np.copysign(share, np.vdot(error, move)) * move  # both count, whatever their signs

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
        move = hold(shell, x, held) - x
        if body.live is not None and body.live.loading.by_velocity:
            body, load = _extrapolated(body, hold(shell, x + dt * state.rates, held) - x, load)
        problem, _ = step_potential(body, x, state.rates, dt, load, damping, viscosity)
        gradient, hessian = problem.linearise(x, PROJECTED, led=move)
        factor = problem.definite_factor(hessian)
        if factor is None:
            return MotionState(x.copy(), np.zeros_like(x), {_HELD_UP: np.zeros(3)}), False
        move += shell.unknowns.prolong(problem.step(factor, gradient)).reshape(-1, 3)
        left = problem.residual(x + move)
        work = abs(float(left @ shell.unknowns.values(move.ravel())))
        return MotionState(x + move, move / dt, {_HELD_UP: _held_up(shell, state, move, dt, work)}), True


def _held_up(shell: Shell, state: MotionState, move: Array, dt: float, work: float) -> Array:
    """Error of a step by the ``work`` [J] of the force left at its end, as a share of its ``move`` (n, 3) [m].

    The velocity that is missing leads the motion astray by as much as it goes in a radian, ``1 / omega``, of its
    frequency so far. After the share, the sums of squares of changes of rates and coordinates of which that is, (3,).
    """
    mass, earlier = shell.mass[:, None], state.memory.get(_HELD_UP)  # none of a state that no step has led to
    gained, moved = (float(np.sum(mass * change**2)) for change in (move / dt - state.rates, move))
    sums = (np.zeros(2) if earlier is None else earlier[1:]) + np.array([gained, moved])
    if not moved > 0.0 or not sums[0] > 0.0:
        return np.array([0.0, *sums])
    speed, omega = math.sqrt(moved) / dt, math.sqrt(sums[0] / sums[1])
    slowed = 2.0 * work / (math.sqrt(speed**2 + 2.0 * work) + speed)
    return np.array([slowed / (omega * speed * dt), *sums])


def _extrapolated(body: Body, way: Array, load: Array) -> tuple[Body, Array]:
    """Body and dead load (n, 3) [N] of a step whose live loads are linear about the end of the ``way`` (n, 3) [m].

    That is where the shell goes at its rates. About where it is, all that a step knows of velocities would be those of
    a shell at rest: the drag of a wind, quadratic in them, would be that of a linear one, however short the steps.
    """
    live, pattern = body.live, body.shell.pattern
    assert live is not None
    assert live.before is not None
    body = copy.copy(body)
    body.live = replace(live, origin=live.origin + way, before=live.before - way)
    data = np.zeros(pattern.size)
    body.live.add_stiffness(pattern, live.before, data)
    return body, load + pattern.product(data, way.ravel()).reshape(-1, 3)
