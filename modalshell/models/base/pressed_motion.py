"""What motions of modal and reduced models share where contacts press on them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from modalshell.contact.contact import Contact
from modalshell.contact.modal import ModalContacts, Pressed
from modalshell.contact.steps import refuse_fast
from modalshell.contact.touching import checked_contacts, touched_frame
from modalshell.core.touched import TouchedFrame
from modalshell.core.typing import Array
from modalshell.integrators.state import PUSHES, MotionSetup, MotionState

LOCAL, BEYOND = "local", "beyond"
"""Names in a state's memory of the displacement (n, 3) [m] beyond the modes, and of its elastic energy (1,) [J]."""


class PressedMotion:
    """Contacts of one motion, and what they press in beyond the modes, which states carry in their memory.

    Parameters
    ----------
    model : Model
        The model.
    setup : MotionSetup
        What decides the motion.
    pressing_of : callable
        The contacts of a model; OptionError where it cannot take them.

    Raises
    ------
    OptionError
        For colliders that move too fast, too.
    """

    def __init__(
        self, model: Any, setup: MotionSetup, pressing_of: Callable[[Any, Sequence[Contact]], ModalContacts]
    ) -> None:
        given, rest = checked_contacts(setup.contacts, setup.supports), model.shell.rest_positions
        refuse_fast(given, rest, setup.dt)
        self._model, self._setup = model, setup
        self._pressing = pressing_of(model, given)
        self._none = self._memory(Pressed(np.empty(0), np.zeros_like(rest), self._pressing.no_pushes, True))

    @staticmethod
    def _memory(pressed: Pressed) -> dict[str, Array]:
        return {LOCAL: pressed.local, PUSHES: pressed.pushes, BEYOND: np.array([pressed.energy])}

    def clear(self, state: MotionState) -> MotionState:
        """The end of a step that nothing touches."""
        return MotionState(state.coordinates, state.rates, state.memory | self._none)

    def local(self, state: MotionState) -> Array:
        """Displacement (n, 3) [m] of a state beyond the modes."""
        found = state.memory.get(LOCAL)
        return self._none[LOCAL] if found is None else found

    def energy(self, state: MotionState) -> float:
        """Elastic energy [J] of a state beyond the modes."""
        return float(state.memory[BEYOND][0])

    def frame(self, state: MotionState, positions: Array, time: float) -> TouchedFrame:
        """What touches in a state at ``positions`` (n, 3) [m] and ``time`` [s]."""
        self._pressing.at(time)
        return touched_frame(self._pressing.touching, positions, state.memory[PUSHES])
