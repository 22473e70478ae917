"""State of a motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, final

from modalshell.core.typing import Array

COST = "cost"
"""Name in a state's memory of the squares, in the norm of the mass, of the last step's error and of its changes of
rates and coordinates, where the rule has found them (3,)."""

FLAGS = "step", "order", "middle"
"""Names in a state's memory of numbers (1,) that rules of order two keep of their last step: no vectors, whatever the
unknowns."""

PUSHES = "pushes"
"""Name in a state's memory of the contact forces (r,) [N] along the normals of its step."""
GIVEN, MIDDLE_GIVEN = "given", "middle_given"
"""Names in a state's memory of the impulses (n, 3) [N s] of contacts in its step, and since the middle of it."""
PRESSED = "pressed"
"""Name in a state's memory of whether contacts pressed on a shell in its step (1, 1), of what a coarse shell bears."""

CREASES, HEAT = "creases", "crease_heat"
"""Names in a state's memory of the plastic folds (C,) [rad] of creases, and of the heat (1,) [J] they have made."""


_FIND = "_find"

Found = tuple[Array, dict[str, Array]]
"""Rates, and further memory."""


@final
@dataclass
class MotionState:
    """State of a model in motion."""

    coordinates: Array
    rates: Array
    """In the model's own unknowns."""
    memory: dict[str, Array] = field(default_factory=dict)
    """What the model's rule keeps from its last step, by name: vectors in the unknowns' shape, and flags (1,)."""

    @classmethod
    def late(cls, coordinates: Array, memory: dict[str, Array], find: Callable[[], Found]) -> MotionState:
        """A state whose rates, and what its memory lacks, are found when rates or :meth:`arrays` are first wanted."""
        state = cls.__new__(cls)
        state.coordinates, state.memory = coordinates, memory
        state.__dict__[_FIND] = find
        return state

    if not TYPE_CHECKING:

        def __getattr__(self, name):
            """Find the rates of a :meth:`late` state: no other attribute is ever missing."""
            find = self.__dict__.get(_FIND) if name == "rates" else None
            if find is None:
                raise AttributeError(name)
            self.rates, further = find()
            self.memory |= further
            return self.rates

    def __getstate__(self) -> dict[str, Any]:
        """Everything in it, to be copied or stored."""
        return {"coordinates": self.coordinates, "rates": self.rates, "memory": self.memory}

    def arrays(self) -> dict[str, Array]:
        """Everything in it, by name."""
        return {"coordinates": self.coordinates, "rates": self.rates, **self.memory}

    def with_arrays(self, arrays: dict[str, Array]) -> MotionState:
        """A state of the same kind from the arrays of :meth:`arrays`."""
        return MotionState(arrays["coordinates"], arrays["rates"], {name: arrays[name] for name in self.memory})

    def mapped(self, place: Callable[[Array], Array], turn: Callable[[Array], Array]) -> MotionState:
        """It in other unknowns: coordinates by ``place``, rates and what a rule keeps of them by ``turn``."""
        same = {name for name, vector in self.memory.items() if vector.shape == self.rates.shape}
        kept = same - {PUSHES, *FLAGS}
        memory = {name: turn(vector) if name in kept else vector for name, vector in self.memory.items()}
        return MotionState(place(self.coordinates), turn(self.rates), memory)
