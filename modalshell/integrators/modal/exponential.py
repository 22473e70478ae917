"""Exponential integrator of modal coordinates (theory 12, eq. 5 and 6)."""

from __future__ import annotations

import math
from typing import final

import numpy as np

from modalshell.core.thread_safety import read_only
from modalshell.core.typing import Array
from modalshell.integrators.modal.base import Force, ForceInTime, ModalIntegrator, ModalStep, Step
from modalshell.integrators.modal.exponential_kernels import correct, predict, stand_in
from modalshell.integrators.modal.flow import flow, hardly_followed, outrun, turning_flow
from modalshell.integrators.state import COST, MotionState

VIOLENT = 3e-3
"""Change of the coordinates within a step by what was not expected of the force, as a share of the shell's size in the
norm of the mass, from which the force is asked for again; so it is where the whole force would move modes that are
hardly followed by as much, at rest."""


@final
class Exponential(ModalIntegrator, key="exponential"):
    r"""The exact flow of every damped mode, under a force that is predicted and kept [hochbruck2010, section 2].

    With the :func:`flow`'s coefficients, and :math:`p_n` the force kept from the step before,

    .. math:: q^* = e_{11} q + e_{12} v + a_1 p_n, \quad p^* = p(q^*), \quad
              q_{n+1} = q^* + a_2 (p^* - p_n), \quad v_{n+1} = v^* + b_2 (p^* - p_n), \quad p_{n+1} = p^*.

    Order two, at one modal force a step, and at a second one, at :math:`q_{n+1}`, where the force changes violently.
    Exact at any step, damping too, under dead modal forces that are piecewise linear in time. Forces that turn with the
    shell would feed modes that steps do not resolve: those of fewer than three steps a period take implicit Euler's
    coefficients, and die. Where some have three to four, steps under a large force take a second one: under a small one
    its turning is not felt by modes as stiff. Where a model tells how the force changes over a short way, that serves.

    Parameters
    ----------
    turning : bool
        Whether the forces turn with the shell.
    """

    name = "exponential"
    backward = False

    def __init__(self, *, turning: bool = False) -> None:
        self.turning = turning
        self._coefficients = turning_flow if turning else flow
        self._kept: tuple[Array, Array, float, Array, float | None, Array] | None = None

    def under_turning_forces(self) -> Exponential:
        """The rule whose fast modes take implicit Euler's coefficients."""
        return self if self.turning else Exponential(turning=True)

    def at_rest(self, coordinates: Array) -> MotionState:
        """State at rest; what is kept are the last modal force, its change, and what :data:`COST` names."""
        none = np.zeros_like(coordinates)
        memory = {"force": none.copy(), "gain": none.copy(), "curvature": none.copy(), "step": np.zeros(1)}
        return MotionState(coordinates, none, memory | {COST: np.zeros(3)})

    def advance(self, state: MotionState, force: ForceInTime, step: ModalStep) -> MotionState:
        """State after a step."""
        stiffness, damp, h, size, dead = step
        # A state that was not made by the rule is taken for a start.
        q, v, memory = state.coordinates, state.rates, state.memory
        if "force" not in memory:
            memory = self.at_rest(q).memory
        table, stiff, length = self._flow(stiffness, damp, h)
        last = float(memory["step"][0])
        most, largest = (VIOLENT * size) ** 2, math.inf if stiff is None else (VIOLENT * size * stiff) ** 2
        ends, cost = np.empty((6, q.size)), np.empty(3)
        ahead, rates = ends[0], ends[1]
        if last and dead is not None and dead.step is not None:
            dead.step(table, h / last, most, largest, q, v, memory["force"], memory["gain"], ends, cost)
            pushed = ends[4]
        else:
            kept = memory["force"] if last else force(q, v, 0.0)
            predict(table, q, v, kept, ends)
            pushed = force(ahead, rates, 1.0)
            if not last:  # the force is taken as straight
                last, memory = h, memory | {"gain": pushed - kept}
            change = None if dead is None else dead.change
            foreseen = None if change is None else ahead.copy()
            missed, whole = correct(table, h / last, q, v, kept, pushed, memory["gain"], ends, cost)
            if missed > most or whole > largest:
                further = None if change is None or foreseen is None else change(foreseen, ahead, pushed)
                pushed = force(ahead, rates, 1.0) if further is None else pushed + further
        keeps = {"force": pushed, "gain": ends[2], "curvature": ends[3], "step": length, COST: cost}
        return MotionState(ahead, rates, keeps)

    def stood_in_for(self, before: MotionState, after: MotionState, force: Array, h: float) -> MotionState:
        """``after`` a step of implicit Euler, its force kept, with the error of that step."""
        ends, cost, step = np.empty((2, force.size)), np.empty(3), np.empty(1)
        step[0], ways = h, [(state.coordinates, state.rates) for state in (before, after)]
        stand_in(h, *ways, force, before.memory["force"], ends, cost)
        keeps = {"force": force, "gain": ends[0], "curvature": ends[1], "step": step, COST: cost}
        return MotionState(after.coordinates, after.rates, keeps)

    def step(self, q: Array, v: Array, force: Force, stiffness: Array, damp: Array, h: Step) -> tuple[Array, Array]:
        """Coordinates and rates after a step that keeps nothing: the force of the beginning and one predicted."""
        c = self._coefficients(stiffness, damp, h)
        first = force(q)
        ahead = c.e11 * q + c.e12 * v + c.a1 * first
        change = force(ahead) - first
        return ahead + c.a2 * change, c.e21 * q + c.e22 * v + c.b1 * first + c.b2 * change

    def response(self, stiffness: Array, damp: Array, h: float) -> tuple[Array, Array]:
        """Change (m,) of coordinates and rates by a unit force at the step's end: one that grows from none."""
        table = self._flow(stiffness, damp, h)[0]
        return table[5], table[7]

    def matrix(self, stiffness: Array, damp: Array, h: float, slope: Array) -> Array:
        """Matrix (3m, 3m) of small deviations of coordinates, rates and the kept force, under forces ``slope q``.

        Where modes are hardly followed it is that of two forces a step.
        """
        c, count = self._coefficients(stiffness, damp, h), stiffness.size
        ahead = np.hstack([np.diag(c.e11), np.diag(c.e12), np.diag(c.a1)])
        rates = np.hstack([np.diag(c.e21), np.diag(c.e22), np.diag(c.b1)])
        pushed = slope @ ahead
        change = pushed - np.eye(count, 3 * count, 2 * count)
        ahead = ahead + c.a2[:, None] * change
        again = self.turning and hardly_followed(stiffness, h) is not None
        return np.vstack([ahead, rates + c.b2[:, None] * change, slope @ ahead if again else pushed])

    def _flow(self, stiffness: Array, damp: Array, h: float) -> tuple[Array, float | None, Array]:
        """The coefficients, errors per curvature of a force and change of rates, and the stiffness (11, m); kept.

        And the least stiffness that is hardly followed, under forces that turn, if any is; and the step (1,) [s].

        A straight force misses ``h^3 p'' / 12`` in the rates. A slow mode keeps that for a while, a stiff one answers a
        force at once, a rigid one moves on. A third of it adds up, as measured: the rest comes and goes, as forces turn
        with twice the frequency of the motion.
        """
        kept = self._kept  # read once: another thread may ask for others meanwhile
        if kept is None or kept[0] is not stiffness or kept[1] is not damp or kept[2] != h:
            elastic = np.where(stiffness > 0.0, stiffness, 1.0 / h**2)
            reach = np.minimum(h / np.sqrt(elastic), 1.0 / elastic) / 36.0
            coefficients = np.array(self._coefficients(stiffness, damp, h))
            lost = np.where(outrun(stiffness, h) & self.turning, 0.5 * h, 0.0)
            stiff = hardly_followed(stiffness, h) if self.turning else None
            table = np.vstack([coefficients, reach, lost, stiffness])
            kept = self._kept = stiffness, damp, h, table, stiff, read_only(np.array([h]))
        return kept[3:]
