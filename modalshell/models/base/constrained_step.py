"""Steps of modal models under constraints: their ends are moved onto these."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from modalshell.core.typing import Array
from modalshell.integrators.modal.base import ForceInTime
from modalshell.integrators.state import MotionState
from modalshell.models.base.manipulation import REACHED, PatchTargets, meet
from modalshell.models.base.modal_motion import CONSTRAINT_MET, ModalMotion
from modalshell.models.base.stepper import LEAD
from modalshell.shell.damping import Damping

HELD = "held"
"""Name in a state's memory of the modal forces (m,) of constraints throughout its step; none where these jump."""


def begun(model: ModalMotion, state: MotionState) -> MotionState:
    """A start that no constraint has pushed on."""
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
    """The ``force`` of a step where constraints leave the shell if they push as in the step before.

    Where they do not let it go the load is another, and a shell would come to rest off its equilibrium. ``step`` is
    its length [s] and the damping. ``falls`` are rates (m,), if any, at which the force was asked for, and its fall
    (m, m) with them: those of the shell without constraints, as the end is that it corrects.
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
        pushed = force(q + share * move, rates + faster, share)
        falls[:] = [(rates, fall) for _, fall in falls]
        return pushed

    return held


def meet_constraints(
    model: ModalMotion,
    before: MotionState,
    free: MotionState,
    step: tuple[float, Damping],
    targets_at: Callable[[float], PatchTargets],
) -> tuple[MotionState, Array]:
    """Move a step's end onto the constraints by the modal forces of least work [choi2007, section 4.4].

    ``free`` is the end of a step from ``before`` without them, of a length [s] and with damping, ``targets_at`` gives
    targets at a share of the step. The forces act throughout the step, and patches then move with their targets. Where
    rates are the differences of coordinates, and where a target was not met at the step's beginning, so that it jumps,
    the forces act at the step's end.
    """
    targets, (dt, damping), rule = targets_at(1.0), step, model.integrator
    compliance, by_rate = model.impulse(damping, dt)
    q, residual, jacobian = meet(targets, free.coordinates, compliance, before.coordinates)
    move = q - free.coordinates
    if rule.backward or np.abs(targets_at(0.0)(before.coordinates)[0]).max() > CONSTRAINT_MET:
        after = begun(model, MotionState(q, free.rates + move / dt, free.memory))
    else:
        rates = free.rates + by_rate / compliance * move
        wanted = (residual - targets_at(1.0 - LEAD)(q)[0]) / (LEAD * dt)
        rates = rates + np.linalg.lstsq(jacobian, wanted - jacobian @ rates, rcond=REACHED)[0]
        after = MotionState(q, rates, free.memory | {HELD: move / compliance})
    return after, targets.lengths(residual)
