"""Free parts of a coarse shell, with the momenta of the fine surface."""

from __future__ import annotations

from collections.abc import Callable
from typing import final

import numpy as np

from modalshell.core.typing import Array
from modalshell.integrators.free_parts import FreeParts
from modalshell.integrators.state import MotionState
from modalshell.models.coarse.prolongation import Prolongation
from modalshell.shell import Shell

_LEAD = 1e-6
"""Move about a state, as a share of the shell's size, over which velocities of the fine surface are differences."""


def flow(shape: Callable[[Array], Array], at: Array, rates: Array, speed: float, size: float) -> Array:
    """Velocities (n, 3) [m/s] of the positions of a ``shape`` at coordinates that change by ``rates``.

    ``speed`` [m/s] is the largest of the coarse vertices, and ``size`` [m] that of the shell.
    """
    lead = _LEAD * size / (speed or 1.0)
    return np.asarray((shape(at + lead * rates) - shape(at - lead * rates)) / (2.0 * lead))


@final
class ProlongedParts:
    """Parts of a coarse shell that nothing holds: their momenta are those of the fine surface and its masses.

    The fine surface moves rigidly where the coarse one does, so that rigid moves of the one are those of the other.
    """

    def __init__(
        self, fine: FreeParts, coarse: FreeParts, surface: Prolongation, masses: tuple[Array, Array], size: float
    ) -> None:
        self._fine, self._coarse, self._surface, self._size = fine, coarse, surface, size
        own, spread = masses
        self._missing = np.zeros_like(own)
        """What the coarse shell's mass, scaled to that of the fine one, is above the weights of a load by mass [kg]."""
        for part, above in zip(coarse.parts, fine.parts, strict=True):
            at = part.vertices
            self._missing[at] = own[at] * (above.total / part.total) - spread[at]

    @classmethod
    def of(cls, shell: Shell, coarse: Shell, surface: Prolongation) -> ProlongedParts | None:
        """The parts that no support holds, each of the fine shell with that of the coarse one; None without any."""
        fine, under = FreeParts.of(shell), FreeParts.of(coarse)
        if fine is None or under is None or len(fine.parts) != len(under.parts):
            return None
        weights, below = surface.matrix, np.full(len(coarse.mass), -1)
        for number, part in enumerate(under.parts):
            below[part.vertices] = number
        numbers = np.arange(len(shell.mass))
        order = [below[weights.indices[weights.indptr[numbers[part.vertices][0]]]] for part in fine.parts]
        if sorted(order) != list(range(len(order))):
            return None
        matched = FreeParts(tuple(under.parts[number] for number in order))
        masses = np.asarray(coarse.mass), np.asarray(weights.T @ shell.mass)
        return cls(fine, matched, surface, masses, shell.mesh.moment_length)

    @property
    def under(self) -> FreeParts:
        """The parts of the coarse shell, in the order of those of the fine one."""
        return self._coarse

    def balanced(self, load: Array, down: Array) -> Array:
        """The coarse load ``down`` (k, 3) [N] of a ``load`` (n, 3), whose uniform share accelerates all alike.

        Masses of the coarse vertices are not those that weigh on them: gravity would bend a shell that falls.
        """
        down = down.copy()
        for part, above in zip(self._coarse.parts, self._fine.parts, strict=True):
            at = part.vertices
            down[at] += self._missing[at, None] * (load[above.vertices].sum(axis=0) / above.total)
        return down

    def momenta(self, x: Array, rates: Array) -> Array:
        """Momenta at coarse positions (k, 3) [m] and velocities (k, 3) [m/s]."""
        return self._fine.momenta(self._surface.prolong(x), self._velocities(x, rates))

    def wrenches(self, x: Array, load: Array) -> Array:
        """Forces and torques of a load (n, 3) [N] at coarse positions (k, 3) [m]."""
        return self._fine.wrenches(self._surface.prolong(x), load)

    def carried(self, before: MotionState, after: MotionState, first: Array, last: Array, dt: float) -> MotionState:
        """``after`` a step from ``before``, brought to its momenta."""
        x = after.coordinates
        above = MotionState(self._surface.prolong(x), self._velocities(x, after.rates))
        moves = self._fine.moves(self._surface.prolong(before.coordinates), above, first, last, dt)
        return self._coarse.moved(after, moves)

    def _velocities(self, x: Array, rates: Array) -> Array:
        return flow(self._surface.prolong, x, rates, float(np.abs(rates).max()), self._size)
