"""What motions of modal and reduced models share where contacts press on them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np

from modalshell.contact.contact import Contact
from modalshell.contact.modal import ModalContacts
from modalshell.contact.modal_kernels import given_back
from modalshell.contact.pressed import Pressed
from modalshell.contact.steps import refuse_fast
from modalshell.contact.touching import Touching, checked_contacts
from modalshell.core.touched import TouchedFrame
from modalshell.core.typing import Array
from modalshell.integrators.state import PUSHES, MotionState
from modalshell.models.base.settle import extrapolated
from modalshell.models.base.setup import MotionSetup

LOCAL, BEYOND = "local", "beyond"
"""Names in a state's memory of the displacement (n, 3) [m] beyond the modes, and of its elastic energy (1,) [J]."""
TAKEN = "derivatives_at"
"""Name of the coordinates (m,) at which derivatives at contacts were taken; infinite for none."""
_STIFF = 1e-6
"""Softness of modes by which a start stays as it is, but for what is beyond them."""
_AGAIN = 8
"""Projections of a start at most that account for what is pressed in."""
_SETTLED = 1e-7
"""Change of what is pressed in, as a share of the shell's size, at which it has settled."""


class PressedMotion(ABC):
    """Contacts of one motion, and what they press in beyond the modes, which states carry in their memory.

    OptionError for contacts that the model cannot take, and colliders that move too fast.
    """

    presses = True
    """Whether contacts press displacements in beyond the model's own unknowns."""
    holds = True
    """Whether the supports hold the shell."""

    def __init__(self, model: Any, setup: MotionSetup) -> None:
        given, rest = checked_contacts(setup.contacts, setup.supports), model.shell.rest_positions
        refuse_fast(given, rest, setup.dt)
        self._model, self._setup = model, setup
        self._pressing = self._contacts_of(model, given)
        self._none = self._memory(Pressed(np.empty(0), np.zeros_like(rest), self._pressing.no_pushes, True))

    @property
    def note(self) -> str:
        """What is said of friction; "" without it."""
        return ""

    @staticmethod
    @abstractmethod
    def _contacts_of(model: Any, contacts: Sequence[Contact]) -> ModalContacts:
        """The contacts of a model; OptionError where it cannot take them."""

    @staticmethod
    def _memory(pressed: Pressed) -> dict[str, Array]:
        return {LOCAL: pressed.local, PUSHES: pressed.pushes, BEYOND: np.array([pressed.energy])}

    @property
    def touching(self) -> Touching:
        """The contacts at the time that was looked at last."""
        return self._pressing.touching

    def begin(self, state: MotionState, positions: Array) -> MotionState:
        """A start, refused where it, or the ``positions`` (n, 3) [m] that it stands for, are inside a collider.

        Of positions outside, what the modes lack is pressed in: such are a model's own answers with contacts.
        """
        touching, begun = self._pressing.touching, self.clear(state)
        touching.refuse_inside(positions)
        if self.holds and touching.inside(self._model.positions(state), touching.vertices):
            begun = self._pressed_to(positions, self.pressed(state, _STIFF))
        touching.refuse_inside(self._model.positions(begun) + self.local(begun))
        return begun

    def _pressed_to(self, positions: Array, begun: MotionState) -> MotionState:
        """A start nearer to ``positions`` (n, 3) [m] than ``begun``, whose modes hold a part of what is beyond them.

        What is pressed in is taken from the positions before these are projected onto the modes, until that settles; by
        Anderson's extrapolation, as modes may hold nearly all of it.
        """

        def off(state: MotionState) -> float:
            return float(np.abs(self._model.positions(state) + self.local(state) - positions).max())

        least, taken = off(begun), self.local(begun)
        points: list[Array] = []
        misses: list[Array] = []
        for _ in range(_AGAIN):
            again = self.pressed(self._model.start_motion(positions - taken), _STIFF)
            left = off(again)
            begun, least = (again, left) if left < least else (begun, least)
            points, misses = [*points, taken], [*misses, self.local(again) - taken]
            if np.abs(misses[-1]).max() <= _SETTLED * self._model.shell.size:
                break
            taken = extrapolated(points, misses)
        return begun

    def pressed(self, state: MotionState, softness: float = 1.0) -> MotionState:
        """A state with its shape led out of the colliders as at rest, by modes of a ``softness`` times their own."""
        pressing, q, clear = self._pressing, state.coordinates, self.clear(state)
        base, memory = pressing.positions(q), clear.memory
        gaps = pressing.gaps(base)
        if not pressing.touched(gaps):
            return clear
        kept = memory[LOCAL], memory[PUSHES], memory.get(TAKEN)
        found = pressing.press(q, softness / self._model.basis.eigenvalues, (q, q, base), gaps, kept)
        taken = {TAKEN: found.at} if TAKEN in memory and found.at is not None else {}
        return MotionState(found.q, state.rates, memory | self._memory(found) | taken)

    def entered(self, state: MotionState, time: float) -> MotionState:
        """A state at ``time`` [s] that is not of this motion, with its shape led out of the colliders as at rest."""
        self._pressing.at(time)
        return self.pressed(state)

    def clear(self, state: MotionState) -> MotionState:
        """The end of a step that nothing touches."""
        return MotionState(state.coordinates, state.rates, state.memory | self._none)

    def slower(self, before: MotionState, after: MotionState, work: float) -> float:
        """Factor of the rates that gives back what a step has gained beyond the ``work`` [J] of its load.

        0 where that is more than little; see :func:`given_back`.
        """
        model = self._model
        ends = ((model.kinetic_energy(one), model.elastic_energy(one), self.energy(one)) for one in (after, before))
        return float(given_back(*ends, work))

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
        return self._pressing.frame(positions, state.memory[PUSHES])
