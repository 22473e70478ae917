"""Wing beats: modal forcing in proportion to the thrust that a boid needs."""

from __future__ import annotations

from typing import final

import numpy as np
from numpy.typing import ArrayLike

from modalshell.core.checks import checked_kind, checked_number, checked_vectors
from modalshell.core.errors import OptionError
from modalshell.core.typing import Array
from modalshell.modes import Basis


@final
class Flap:
    """Beats up and down, along z, of a shell held along its body.

    The force on a vertex is its mass times one acceleration along z, so that wings bend about where they are held. Its
    strength follows the load factor ``n = |g - a| / |g|`` of the flight: one at steady flight, more in a turn or a
    climb that speeds up, less in a dive.

    Parameters
    ----------
    basis : Basis
        Modes of a held shell.
    amplitude : float
        Largest displacement of a vertex [m] under the force at n = 1, were it applied slowly to the linear modes.
        Beats near the lowest frequency have larger amplitudes.
    frequency : float
        Beats per second [Hz].
    largest_load_factor : float
        n above which the beats grow no more.

    Attributes
    ----------
    force : ndarray, shape (m,)
        Modal force at the height of a beat at n = 1.

    Raises
    ------
    OptionError
        If a parameter is out of range, the shell is free, or its modes do not answer to a force along z.
    """

    def __init__(self, basis: Basis, *, amplitude: float, frequency: float, largest_load_factor: float = 3.0) -> None:
        amplitude = checked_number("amplitude", amplitude, at_least=0.0, unit="m")
        self.frequency = checked_number("frequency", frequency, at_least=0.0, unit="Hz")
        self.largest_load_factor = checked_number("largest_load_factor", largest_load_factor, above=0.0)
        if checked_kind("basis", basis, Basis).rigid_modes:
            raise OptionError("flapping needs a shell that its supports hold: clamp the bird's body")
        force = basis.modes[2::3].T @ basis.shell.mass
        static = (basis.modes @ (force / basis.eigenvalues)).reshape(-1, 3)
        reach = float(np.linalg.norm(static, axis=1).max())
        if not reach > 0.0:
            raise OptionError("no mode of the basis answers to a force along z")
        self.force = amplitude / reach * force

    def forcing(self, time: float, phases: ArrayLike, felt: ArrayLike, gravity: float = 9.81) -> Array:
        """Modal forces (B, m) at ``time`` [s].

        ``phases`` (B,) [rad] are those of each bird's beat, ``felt`` (B, 3) [m/s^2] is gravity less its acceleration,
        in any frame, and ``gravity`` [m/s^2] the strength of gravity.
        """
        shift = checked_vectors("phases", phases, (np.size(phases),), OptionError)
        loads = checked_vectors("felt", felt, (shift.size, 3), OptionError)
        gravity = checked_number("gravity", gravity, above=0.0, unit="m/s^2")
        factor = np.minimum(np.linalg.norm(loads, axis=1) / gravity, self.largest_load_factor)
        beat = np.sin(2.0 * np.pi * self.frequency * time + shift)
        return (factor * beat)[:, None] * self.force
