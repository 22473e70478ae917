"""Configuration-dependent loads at one time: forces, energy, and entries of the Hessian (theory 16, eq. 5)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import final

import numpy as np

from modalshell.core.errors import OptionError
from modalshell.core.typing import Array, Index
from modalshell.loads import AppliedLoad, Loading
from modalshell.shell.pattern import SparsePattern


@final
@dataclass(frozen=True, eq=False)
class LiveLoads:
    """The loads of a :class:`Loading` that change, for a problem whose positions are x."""

    loading: Loading
    """The loads."""
    time: float = 0.0
    """Time [s]."""
    origin: Array = field(default_factory=lambda: np.zeros(3))
    """Where the problem's origin lies in the world [m], or whence each vertex is seen from its place; shape (3,) or
    (n, 3)."""
    before: Array | None = None
    """Positions [m] a step earlier; velocities are the difference times ``rate``. None in statics. Shape (n, 3)."""
    rate: float = 0.0
    """One over the step [1/s]; 0 in statics."""
    share: float = 1.0
    """Factor on all of them."""

    @property
    def conservative(self) -> bool:
        """Whether they have a potential, and do not depend on velocities."""
        return self.loading.conservative and not (self.rate and self.loading.by_velocity)

    def scaled(self, share: float) -> LiveLoads:
        """The same loads times a factor."""
        return replace(self, share=share * self.share)

    def force(self, x: Array) -> Array:
        """Forces (n, 3) [N]."""
        return self.share * self.loading.live_force(x + self.origin, self._velocity(x), self.time)

    def energy(self, x: Array) -> float:
        """Potential [J]."""
        return self.share * self.loading.live_energy(x + self.origin, self.time)

    def add_stiffness(self, pattern: SparsePattern, x: Array, data: Array) -> None:
        """Add minus the forces' derivatives to the entries of a Hessian, both halves of the unsymmetric ones."""
        world, velocity = x + self.origin, self._velocity(x)
        for one in self.loading.live:
            if one.by_position or (one.by_velocity and self.rate):
                blocks = one.stiffness(world, velocity, self.time, self.rate)
                places = entry_places(pattern, one)
                data += np.bincount(places, self.share * blocks.ravel(), data.size)

    def _velocity(self, x: Array) -> Array | None:
        return None if self.before is None else self.rate * (x - self.before)


def entry_places(pattern: SparsePattern, load: AppliedLoad) -> Index:
    """Positions of the flattened entries of the blocks (E, k, 3, k, 3) in the values of a pattern."""
    stencils = load.stencils
    count = len(pattern.strides)
    blocks = pattern.blocks
    keys = count * np.repeat(np.arange(count), np.diff(blocks.indptr)) + blocks.indices
    wanted = stencils[:, :, None] * count + stencils[:, None, :]
    found = np.minimum(np.searchsorted(keys, wanted), keys.size - 1)
    if not np.array_equal(keys[found], wanted):
        missing = stencils[(keys[found] != wanted).any(axis=(1, 2))][0].tolist()
        raise OptionError(
            f"the stiffness of a load couples the vertices {missing}, which no element of the model joins: let springs "
            "join the corners of every triangle, or take a dead load"
        )
    at = stencils[:, :, None]
    corner = 6 * blocks.indptr.astype(np.int64)[at] + 3 * found  # (E, k, k)
    axis = np.arange(3)
    places = corner[:, :, None, :, None] + axis[:, None, None] * pattern.strides[at][:, :, None, :, None] + axis
    return np.asarray(places.ravel())
