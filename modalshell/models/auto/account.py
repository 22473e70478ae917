"""What steps of the model that switches itself cost, and what it says of its switches."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from modalshell.core.typing import Array
from modalshell.integrators.state import COST, MotionState
from modalshell.models.base.stepper import Stepper
from modalshell.statics.error_bar import LEAST_MARGIN, share_as_text

LACKS_LOAD, LACKS_START, STRIKES, TOUCHES, DRIFTS, LED = 1.0, 2.0, 3.0, 4.0, 5.0, 6.0
"""Marks of switches for what the modes lack: of the linear answer to the load, and of where the motion starts; for a
strike on a collider that is ahead; for one that modes do not take, which is about to touch; for errors that have added
up; and for constraints."""
NO_MARGIN = -1e9
"""Margin of a switch whose check has found no bar."""
_LITTLE = 1e-4
"""Share of the energy that a switch may change untold."""


def energy_change(steppers: tuple[Stepper, Stepper], states: tuple[MotionState, MotionState], force: Array) -> float:
    """Change of a motion's energy where a level's state takes the place of another, over the larger of the two.

    That is of kinetic and elastic energy, less what a ``force`` (n, 3) [N] does on the way between their positions; the
    larger is counted from what stresses at rest have stored.
    """
    both = [
        stepper.model.kinetic_energy(state) + stepper.model.elastic_energy(state) + stepper.further_energy(state)
        for stepper, state in zip(steppers, states, strict=True)
    ]
    before, after = (stepper.own_positions(state) for stepper, state in zip(steppers, states, strict=True))
    change = both[1] - both[0] - float(np.vdot(force, after - before))
    larger = max(both) - steppers[1].model.shell.energy_at_rest
    return change / larger if larger > 0.0 else 0.0


def cost_of(stepper: Stepper, before: MotionState, after: MotionState, dt: float) -> Array:
    """What :data:`COST` names of a level's step."""
    if (known := after.memory.get(COST)) is not None:
        return known
    error = stepper.model.local_error(before, after, dt)
    assert error is not None  # the rules that levels take by default know theirs
    changes = (error, after.rates - before.rates, after.coordinates - before.coordinates)
    return np.array([stepper.model.squared(change) for change in changes])


def _signed(share: float) -> str:
    """A share in percent with its sign, to two digits or whole: never with a power of ten."""
    percent = 100.0 * share
    return f"{percent:+.2g}" if abs(percent) < 99.5 else f"{percent:+.0f}"


def level_note(state: MotionState, names: Sequence[str]) -> str:
    """Steps of each level, and switches with their reasons."""
    memory = state.memory
    steps = memory["steps"]
    total = max(float(steps.sum()), 1.0)
    taken = [(name, count) for name, count in zip(names, steps, strict=True) if count]
    shares = ", ".join(f"{name} {100.0 * count / total:.0f} %" for name, count in taken)
    lines = []
    for time, level, bar, margin, mark, gained in memory["log"][: int(memory["switches"][0])]:
        if mark == LACKS_START and margin > LEAST_MARGIN:
            reason = f"the modes are {share_as_text(bar)} off the start"
        elif mark == LACKS_LOAD:
            reason = f"the modes lack {share_as_text(bar)} of the linear answer to the load"
        elif mark == STRIKES:
            reason = "it is about to strike a collider"
        elif mark == TOUCHES:
            reason = "it touches a collider with friction, restitution or push_out"
        elif mark == LED:
            reason = "constraints lead it"
        elif mark == DRIFTS:
            reason = f"errors of phase may have added up to {share_as_text(bar)}"
        elif int(level) == 0 or margin <= LEAST_MARGIN:
            reason = "no error bar was found" if margin <= NO_MARGIN else f"stability margin {margin:.2f}"
        else:
            reason = f"{share_as_text(bar)} from DS"
        changed = f"; its energy changed by {_signed(gained)} %" if abs(gained) > _LITTLE else ""
        lines.append(f"to {names[int(level)]} at {time:.4g} s ({reason}{changed})")
    return f"steps by {shares}" + (f"; {', '.join(lines)}" if lines else "")
