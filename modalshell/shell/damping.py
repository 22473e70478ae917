"""Damping of a shell by its mass, by its stiffness, and of single modes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from modalshell.core.checks import checked_number, checked_vectors, shown
from modalshell.core.errors import OptionError
from modalshell.core.typing import Array


@final
@dataclass(frozen=True)
class Damping:
    """Rayleigh damping ``C = mass_factor M + stiffness_factor K``, and damping of single modes.

    Parameters
    ----------
    mass_factor : float
        xi [1/s].
    stiffness_factor : float
        zeta [s].
    ratios : tuple of float
        Additional fractions of critical damping of the modes of a modal model: one for all, or one per mode.

    Raises
    ------
    OptionError
        For values that are not finite or negative.
    """

    mass_factor: float = 0.0
    stiffness_factor: float = 0.0
    ratios: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        for name in ("mass_factor", "stiffness_factor"):
            value = checked_number("each damping factor", getattr(self, name), at_least=0.0)
            object.__setattr__(self, name, value)
        if not isinstance(self.ratios, list | tuple):
            raise OptionError(f"ratios must be a tuple of numbers (got {shown(self.ratios)})")
        checked = tuple(checked_number("each of ratios", ratio, at_least=0.0) for ratio in self.ratios)
        object.__setattr__(self, "ratios", checked)

    @classmethod
    def from_ratios(cls, first: tuple[float, float], second: tuple[float, float]) -> Damping:
        """Rayleigh damping by the shares of critical damping that were measured at two frequencies.

        Parameters
        ----------
        first, second : (float, float)
            Frequency [Hz] and share of critical damping there.

        Raises
        ------
        OptionError
            For frequencies that do not differ, values out of range, or ratios that no factors at least 0 give: the one
            at the higher frequency must lie between f_1 / f_2 and f_2 / f_1 times the other.
        """
        pairs = [
            checked_vectors(name, pair, (2,), OptionError) for name, pair in (("first", first), ("second", second))
        ]
        for name, (frequency, ratio) in zip(("first", "second"), pairs, strict=True):
            checked_number(f"{name}'s frequency", float(frequency), above=0.0, unit="Hz")
            checked_number(f"{name}'s ratio", float(ratio), at_least=0.0)
        (low, at_low), (high, at_high) = sorted((2.0 * np.pi * float(f), float(ratio)) for f, ratio in pairs)
        if high - low <= 1e-9 * high:
            raise OptionError(f"first and second must be at two frequencies (got {first[0]} and {second[0]} Hz)")
        # ratio = (xi / omega + zeta omega) / 2
        mass = 2.0 * low * high * (at_low * high - at_high * low) / (high**2 - low**2)
        stiffness = 2.0 * (at_high * high - at_low * low) / (high**2 - low**2)
        if min(mass * high, stiffness * high**3) < -1e-9 * high**2 * (at_low + at_high):
            raise OptionError(
                f"no Rayleigh factors at least 0 give these ratios: at {high / (2.0 * np.pi):g} Hz the ratio must be "
                f"between {at_low * low / high:g} and {at_low * high / low:g} (got {at_high:g})"
            )
        return cls(max(mass, 0.0), max(stiffness, 0.0))

    @property
    def any(self) -> bool:
        """Whether anything is damped."""
        return self.mass_factor > 0.0 or self.strains

    @property
    def strains(self) -> bool:
        """Whether rates of strain are damped, and not velocities alone."""
        return self.stiffness_factor > 0.0 or any(ratio > 0.0 for ratio in self.ratios)

    def of_modes(self, stiffness: Array) -> Array:
        """Damping ``c = xi + zeta lambda`` [1/s] of modes of ``stiffness`` lambda (m,) [1/s^2].

        And twice the ratios times the angular frequencies; OptionError if there are not as many as modes.
        """
        rayleigh = self.mass_factor + self.stiffness_factor * stiffness
        if not self.ratios:
            return rayleigh
        if len(self.ratios) not in (1, stiffness.size):
            raise OptionError(f"ratios must be one number or {stiffness.size}, one per mode (got {len(self.ratios)})")
        return np.asarray(rayleigh + 2.0 * np.array(self.ratios) * np.sqrt(np.maximum(stiffness, 0.0)))
