"""How far the hybrid's motions go: beyond the energies of its training, or next to a snap.

Errors that training measured are those of its own energies, and of motions that keep away from snaps. Next to one the
coarse shell, the reduced one and DS snap under loads, or at times, of their own. The margin that tells is that of error
bars, of the reduced Hessians: ``min v . H v / v . H_1 v`` with the first part ``H_1``. The assumed stresses do not
lock, so that those of the state itself serve.
"""

from __future__ import annotations

import math
from typing import final

import numpy as np
import scipy.linalg

from modalshell.core.cost import counted
from modalshell.core.typing import Array
from modalshell.integrators.state import MotionState
from modalshell.models.hybrid.assumed_stress import StressPotential
from modalshell.shell import EXACT, GAUSS_NEWTON
from modalshell.statics.error_bar import LEAST_MARGIN

_NAME = "farthest"
"""Name in a state's memory of a row (1, 3): the displacement [kg^(1/2) m] last looked at, the largest energy [J] and
the least margin seen."""
_GROWN = 1.15
"""Growth of the displacement from one look to the next: one takes as long as two to three steps."""


@final
class Farthest:
    """Looks at states of a reduced shell as they grow.

    ``problem`` is its potential without a load, ``energy`` [J] the largest of its training, and ``frames`` the number
    of coordinates before its own, those of the frames of free parts.
    """

    def __init__(self, problem: StressPotential, energy: float, frames: int) -> None:
        self._problem, self._trained, self._frames = problem, energy, frames

    def begun(self, state: MotionState) -> MotionState:
        """A start, whose memory knows how far it is from rest."""
        return self._noted(np.array([[0.0, 0.0, 1.0]]), state)

    def seen(self, before: MotionState, after: MotionState) -> MotionState:
        """The state ``after`` a step, whose memory knows how far the motion has gone.

        Those of coarse positions are of another model, and those that no motion has begun with are unknown.
        """
        row = before.memory.get(_NAME)
        return after if row is None else self._noted(row, after)

    def _noted(self, row: Array, state: MotionState) -> MotionState:
        """The state, whose memory has the row of what came before, and of itself."""
        x = state.coordinates
        state.memory[_NAME] = row if x.ndim == 2 else self._looked(row, x[self._frames :])
        return state

    def _looked(self, row: Array, z: Array) -> Array:
        """The row after a state z (m,): looked at where it is farther from rest than the last one by a good part."""
        moved = math.sqrt(z @ z)
        if not _GROWN * row[0, 0] < moved < math.inf:
            return row
        with counted():  # it is no work of the model
            energy, margin = self._problem.potential(z)[0], self._margin(z)
        return np.array([[moved, max(row[0, 1], energy), min(row[0, 2], margin)]])

    def _margin(self, z: Array) -> float:
        """Stability margin at z (m,) under its own stresses; -1e9 where it has no stiffness without them."""
        stressed, stiffness = (self._problem.linearise(z, part)[1] for part in (EXACT, GAUSS_NEWTON))
        try:
            return float(scipy.linalg.eigh(stressed, stiffness, eigvals_only=True)[0])
        except (np.linalg.LinAlgError, ValueError):  # the latter where it is beyond finite numbers
            return -1e9

    def account(self, state: MotionState) -> str:
        """What is said of a motion that ends in a state; "" of one like those of training, away from snaps."""
        if _NAME not in state.memory:
            return ""
        _, energy, margin = state.memory[_NAME][0].tolist()
        said = []
        if energy > self._trained:
            said.append(
                f"its elastic energy was {energy / self._trained:.3g} times the largest of training or more, where no "
                "error is known: train about a larger load, or take coarse-ds"
            )
        if not margin > LEAST_MARGIN:
            said.append(
                f"it came next to a snap (stability margin {'below -1' if margin < -1.0 else f'{margin:.2g}'} of the "
                f"reduced shell, above {LEAST_MARGIN:g} elsewhere): DS may snap earlier, later or not at all, and it "
                "may be off by as far as it has moved: take ds"
            )
        return "; ".join(said)
