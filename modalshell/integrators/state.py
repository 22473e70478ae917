"""What changes from step to step: coordinates, rates, and what a rule keeps from its last step."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import final

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


@final
@dataclass
class MotionState:
    """State of a model in motion.

    Attributes
    ----------
    coordinates, rates : ndarray
        In the model's own unknowns.
    memory : dict of ndarray, shape (n, 3)
        Vectors that the model's rule keeps from its last step, by name; a rule that finds none starts without.
    """

    coordinates: Array
    rates: Array
    memory: dict[str, Array] = field(default_factory=dict)

    def arrays(self) -> dict[str, Array]:
        """Everything in it, by name."""
        return {"coordinates": self.coordinates, "rates": self.rates, **self.memory}

    def with_arrays(self, arrays: dict[str, Array]) -> MotionState:
        """A state of the same kind, made of what :meth:`arrays` gave."""
        return MotionState(arrays["coordinates"], arrays["rates"], {name: arrays[name] for name in self.memory})
