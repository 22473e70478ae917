"""What implicit rules of order two share: their memory, their start, and steps that are not smooth."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import numpy as np

from modalshell.core.typing import Array
from modalshell.integrators.full.implicit_rule import EulerStart, EulerSteps, ImplicitRule, euler_steps
from modalshell.integrators.state import MotionState

VIOLENT = 0.3
"""Turn [rad] of a vertex, by the last change of velocity over a step, from which motion is not smooth: there a rule of
order two keeps a false velocity."""
GAMMA = 1.0 - np.sqrt(0.5)
"""Share of the step in each of the two parts of SDIRK2, by which it is of order two and L-stable."""


class SecondOrderRule(ImplicitRule):
    """A rule of order two, which keeps the changes of coordinates ("move") and rates ("gain") of the step before.

    Kept are also the curvature ``h^2 v''`` of the rates that they show, the length of the step, and the order that it
    was made with: 0 before the first step, 1 where implicit Euler stood in.
    """

    joins = True
    error_constant: ClassVar[float]
    """Error of a step over ``h^3 v''``."""

    @abstractmethod
    def go_on(self, euler: EulerSteps, state: MotionState, dt: float) -> tuple[MotionState, bool]:
        """A step after another one of ``state``'s memory, and whether it was solved: not where motion is violent."""

    def at_rest(self, coordinates: Array) -> MotionState:
        """State at rest, with room for what is kept of a step."""
        none = np.zeros_like(coordinates)
        memory = {name: none.copy() for name in ("move", "gain", "curvature")}
        return MotionState(coordinates, none, memory | {"step": np.zeros(1), "order": np.zeros(1)})

    def march(self, euler: EulerSteps, state: MotionState, dt: float) -> tuple[MotionState, bool]:
        """Advance by ``dt`` [s]; also returns whether the equations were solved."""
        if "order" not in state.memory:  # not made by the rule: taken for a start
            state = MotionState(state.coordinates, state.rates, self.at_rest(state.coordinates).memory)
        after, solved = self.continued(euler, state, dt)
        if solved:
            return after, True
        if state.memory["order"][0]:
            (end, solved), order = self.standing_in(euler, state, dt), 1
        else:
            end, solved, order = started(euler, state, dt)
        return self._landed(euler, state, end, dt, order), solved

    def continued(self, euler: EulerSteps, state: MotionState, dt: float) -> tuple[MotionState, bool]:
        """The rule's own step after the one before, in which nothing stands in; not solved if there is none."""
        if not ("order" in state.memory and state.memory["order"][0]):
            return state, False
        end, solved = self.go_on(euler, state, dt)
        return (self._landed(euler, state, end, dt, 2), True) if solved else (state, False)

    def _landed(self, euler: EulerSteps, before: MotionState, end: MotionState, dt: float, order: int) -> MotionState:
        """The end of a step of an ``order``, with what is kept of it."""
        after = euler.landed(before, end, dt)
        memory = _memory(before, after, dt, order) | self.further(end, after)
        return MotionState(after.coordinates, after.rates, memory)

    def further(self, end: MotionState, after: MotionState) -> dict[str, Array]:  # noqa: ARG002
        """What else is kept of a step that :meth:`go_on` ended at ``end``, and that landed at ``after``."""
        return {}

    def stood_in_for(self, before: MotionState, after: MotionState, dt: float, *, smooth: bool = False) -> MotionState:
        """``after`` a step of ``dt`` [s] by implicit Euler from ``before``, to go on from as from a start.

        Or, where it was ``smooth``, as from any other.
        """
        none = MotionState(after.coordinates, after.rates)
        memory = _memory(before, after, dt, int(smooth)) | self.further(none, after)
        return MotionState(after.coordinates, after.rates, memory)

    def local_error(self, before: MotionState, after: MotionState, dt: float) -> Array:  # noqa: ARG002
        """Error of a step, and that of implicit Euler where it stood in."""
        memory = after.memory
        if memory["order"][0] == 2.0:
            return self.error_constant * dt * memory["curvature"]
        return 0.5 * dt * memory["gain"]


def _memory(before: MotionState, after: MotionState, dt: float, order: int) -> dict[str, Array]:
    """What is kept of a step of ``dt`` [s], made with ``order``."""
    last = before.memory
    gain, ratio = after.rates - before.rates, dt / last["step"][0] if last["order"][0] else 0.0
    curvature = 2.0 * ratio / (1.0 + ratio) * (gain - ratio * last["gain"])
    changes = {"move": after.coordinates - before.coordinates, "gain": gain, "curvature": curvature}
    return changes | {"step": np.array([dt]), "order": np.array([float(order)])}


def started(euler: EulerSteps, state: MotionState, dt: float) -> tuple[MotionState, bool, int]:
    """A first step, whether it was solved, and its order.

    Two half steps of implicit Euler [rannacher1984], and where these show no violent motion, a step of SDIRK2 in their
    place.
    """
    tried, solved = euler_steps(euler, state, dt, 2)
    if solved:
        after, better = two_parts(euler, state, dt, tried.rates - state.rates)
        if better:
            return after, True, 2
    return tried, solved, 1


def two_parts(euler: EulerSteps, state: MotionState, dt: float, gain: Array) -> tuple[MotionState, bool]:
    r"""Both parts of a step of SDIRK2 of ``dt`` [s]; not solved where the ``gain`` of rates expected in it is violent.

    With the first part's end y, from :math:`x_n, v_n`, its rates w and :math:`k = (w - v_n) / (\gamma h)`, the second
    one begins at :math:`x_n + (1 - \gamma) h w, v_n + (1 - \gamma) h k`.
    """
    x, v = state.coordinates, state.rates
    if euler.turn(x, dt * gain) > VIOLENT:
        return state, False
    part, rest = GAMMA * dt, (1.0 - GAMMA) * dt
    # A reduced shell's viscous matrix of bending is that of where a part ends, else its turning is resisted.
    middle = x + part * (v + 0.5 * GAMMA * gain)
    made_of = ((1.0, state, 0.0),)
    half, solved = euler.solve(EulerStart(x, v, part, GAMMA, v + GAMMA * gain, x, 0.0, middle, made_of))
    if not solved:
        return half, False
    w, lead, near = half.rates, rest / part, half.coordinates
    change, last = lead * (w - v), v + (w - v) / GAMMA
    end, begun = x + 0.5 * dt * (v + last), ((1.0 - lead, state, 0.0), (lead, half, GAMMA))
    last_part = EulerStart(x + rest * w, v + change, part, 1.0, last, near, GAMMA, end, begun, side="before")
    return euler.solve(last_part)
