"""The motion of supports in numbers, by which the model that switches itself compares states."""

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
    """Numbers, ``count`` of them, that say what a path of supports does to a shell at rest in their frame.

    Those are the acceleration of the supports, and of a path that turns the angular velocity and acceleration, and how
    far the world has turned, in which loads act: each over its largest length on the path.
    """

    def __init__(self, path: SupportPath) -> None:
        self._path = path
        looked = [self._parts(time) for time in path.samples(_LOOKS).tolist()]
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
