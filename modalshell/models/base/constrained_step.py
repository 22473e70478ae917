"""Steps of modal models under constraints: their ends are moved onto these."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from modalshell.core.typing import Array
from modalshell.integrators.modal.base import ForceInTime, ModalIntegrator
from modalshell.integrators.state import MotionState
from modalshell.models.base.manipulation import REACHED, PatchTargets, meet
from modalshell.models.base.modal_motion import CONSTRAINT_MET, ModalMotion
from modalshell.models.base.stepper import LEAD
from modalshell.shell.damping import Damping

_OUT_OF_REACH = 1.01
"""Factor on the part of a target that modes do not reach, up to which it was missed before as well."""
HELD = "held"
"""Name in a state's memory of the modal forces (m,) with which constraints pushed throughout its step; zeros where a
target jumped, and at a start."""


def begun(model: ModalMotion, state: MotionState) -> MotionState:
    """``state``, on which no constraint has pushed yet."""
    if not model.integrator.backward:
        state.memory[HELD] = np.zeros_like(state.rates)
    return state


def force_held(
    model: ModalMotion,
    state: MotionState,
    step: tuple[float, Damping],
    force: ForceInTime,
    falls: list[tuple[Array, Array]],
) -> ForceInTime:
    """The modal ``force`` of a step, taken where the shell will be if constraints push as in the step before.

    Taken where the shell would go without constraints, loads that change with its shape are others, and it would come
    to rest off its equilibrium. ``step`` is its length [s] and the damping. ``falls`` lists the rates (m,) at which the
    force was asked for, and how it falls with them (m, m); the rates are put back to those without constraints, as the
    end that they correct is the one without constraints.
    """
    push, (dt, damping) = state.memory.get(HELD), step
    if push is None or not push.any():
        return force
    move, faster = (part * push for part in model.impulse(damping, dt))
    if model.integrator.forced_at < 1.0:
        faster = move / dt

    def held(q: Array, rates: Array, share: float) -> Array:
        if q is state.coordinates:  # where the step begins the shell is held already
            return force(q, rates, share)
        pushed = force(q + share * move, rates + (faster if share > 0.0 else 0.0), share)
        falls[:] = [(rates, fall) for _, fall in falls]
        return pushed

    return held


def meet_constraints(
    model: ModalMotion,
    before: MotionState,
    free: MotionState,
    step: tuple[float, Damping],
    targets_at: Callable[[float], PatchTargets],
    rule: ModalIntegrator,
) -> tuple[MotionState, Array]:
    """Move a step's end onto the constraints by the modal forces of least work [choi2007, section 4.4].

    ``free`` is the end of a ``rule``'s step from ``before`` without them, of a length [s] and with damping,
    ``targets_at`` gives targets at a share of the step. The forces act throughout the step, and patches then move with
    their targets. Where rates are the differences of coordinates, and where a target was not met at the step's
    beginning, but is at its end, as it jumps, the forces act at the step's end.
    """
    targets, (dt, damping) = targets_at(1.0), step
    compliance, by_rate = model.impulse(damping, dt, rule)
    q, residual, jacobian = meet(targets, free.coordinates, compliance, before.coordinates)
    move = q - free.coordinates
    missed = np.abs(targets_at(0.0)(before.coordinates)[0]).max()
    if rule.backward or missed > CONSTRAINT_MET + _OUT_OF_REACH * np.abs(residual).max():
        after = begun(model, MotionState(q, free.rates + move / dt, free.memory))
    else:
        rates = free.rates + by_rate / compliance * move
        wanted = (residual - targets_at(1.0 - LEAD)(q)[0]) / (LEAD * dt)
        rates = rates + np.linalg.lstsq(jacobian, wanted - jacobian @ rates, rcond=REACHED)[0]
        after = MotionState(q, rates, free.memory | {HELD: move / compliance})
    return after, targets.lengths(residual)
