"""What changes from step to step: coordinates, rates, and what a rule keeps from its last step."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Self, final

from modalshell.typing import Array


@final
@dataclass(frozen=True)
class Damping:
    """Rayleigh damping ``C = mass_factor M + stiffness_factor K`` (xi [1/s] and zeta [s])."""

    mass_factor: float = 0.0
    stiffness_factor: float = 0.0

    def of_modes(self, stiffness: Array) -> Array:
        """Damping ``c = xi + zeta lambda`` [1/s] of modes of ``stiffness`` lambda (m,) [1/s^2]."""
        return self.mass_factor + self.stiffness_factor * stiffness


class Memory(ABC):
    """What a rule keeps from its last step besides: a frozen dataclass of arrays."""

    @abstractmethod
    def turned(self, rotation: Array) -> Self:
        """The same in a frame that ``rotation`` (3, 3) leads to."""


@final
@dataclass
class MotionState:
    """State of a model in motion.

    Attributes
    ----------
    coordinates, rates : ndarray
        In the model's own unknowns.
    memory : Memory or None
        What the model's rule keeps from its last step; a rule that finds none starts without.
    """

    coordinates: Array
    rates: Array
    memory: Memory | None = None

    def arrays(self) -> dict[str, Array]:
        """Everything in it, by name."""
        kept = {} if self.memory is None else vars(self.memory)
        return {"coordinates": self.coordinates, "rates": self.rates, **kept}

    def with_arrays(self, arrays: dict[str, Array]) -> MotionState:
        """A state of the same kind, made of what :meth:`arrays` gave."""
        memory = self.memory
        if memory is not None:
            memory = replace(memory, **{name: arrays[name] for name in vars(memory)})  # type: ignore[type-var]
        return MotionState(arrays["coordinates"], arrays["rates"], memory)
