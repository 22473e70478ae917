"""Supports that move, as the model that switches itself sees them: what they do to its loads, and its measure."""

from __future__ import annotations

from typing import final

import numpy as np

from modalshell.core.typing import Array
from modalshell.supports import SupportPath

_LOOKS = 200
"""Times at which a path is looked at for the sizes of its accelerations and turns."""
_LITTLE = 1e-9
"""Share of such a size that is rounding."""


@final
class LedSupports:
    """Numbers that say what a path of supports does to a shell at rest in their frame.

    Those are the acceleration of the supports, and of a path that turns the angular velocity and acceleration, and how
    far the world has turned, in which loads act: each over its largest length on the path.

    Parameters
    ----------
    path : SupportPath
        How the supports move.

    Attributes
    ----------
    count : int
        How many numbers there are.
    """

    def __init__(self, path: SupportPath) -> None:
        self._path = path
        looked = [self._parts(float(time)) for time in np.linspace(path.times[0], path.times[-1], _LOOKS)]
        sizes = np.max([[np.linalg.norm(part) for part in parts] for parts in looked], axis=0)
        self._sizes = np.where(sizes > 0.0, sizes, 1.0).tolist()
        self.count = sum(part.size for part in looked[0])

    def _parts(self, time: float) -> tuple[Array, ...]:
        pose = self._path.at(time)
        if not self._path.turns:
            return (pose.acceleration,)
        return pose.acceleration, pose.turn_rate, pose.turn_acceleration, (pose.rotation - np.eye(3)).ravel()

    def values(self, time: float) -> list[float]:
        """The numbers at ``time`` [s]."""
        numbers = np.concatenate([part / size for part, size in zip(self._parts(time), self._sizes, strict=True)])
        numbers[np.abs(numbers) < _LITTLE] = 0.0
        return numbers.tolist()

    def felt(self, force: Array, mass: Array, x: Array, v: Array, time: float) -> Array:
        """Load (n, 3) [N] in the frame at x (n, 3) [m] and v (n, 3) [m/s], of forces (n, 3) [N] of the world."""
        return self._path.at(time).shell_load(force, mass, x, v)

    def in_world(self, x: Array, v: Array, time: float) -> tuple[Array, Array]:
        """Positions (n, 3) [m] and velocities (n, 3) [m/s] of the world of those in the frame."""
        pose = self._path.at(time)
        return pose.to_world(x), pose.world_velocities(x, v)
