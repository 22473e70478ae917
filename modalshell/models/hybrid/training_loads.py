"""Loads that the hybrid of a shell with free parts is trained on."""

from __future__ import annotations

from typing import final

import numpy as np

from modalshell.core.typing import Array
from modalshell.integrators.free_parts import FreeParts
from modalshell.models.base.fitted_frames import FittedFrames
from modalshell.modes import lowest_modes
from modalshell.shell import Shell

_FALLING = 0.05
"""Turn [rad] to train on where loads bend free parts less: what bends them in flight follows from their motion."""


@final
class TrainingLoads:
    """What parts without supports are trained on: loads that leave their frames at rest.

    A dead load in the frame, balanced by inertia, and loads of the lowest elastic modes; these turn a vertex as the
    balanced load does, or by a twentieth of a radian where that is less.
    """

    def __init__(self, coarse: Shell, load: Array, count: int) -> None:
        self.frames = FittedFrames(coarse.rest_positions, FreeParts.of(coarse))
        self.rigid = 6 * len(self.frames.parts)
        modes = lowest_modes(coarse, min(self.rigid + count, coarse.free_unknowns.size))[0]
        self.lowest, self.eigenvalues = modes.modes[:, self.rigid :], modes.eigenvalues[self.rigid :]
        turns = np.linalg.norm(modes.rotations[:, self.rigid :].reshape(-1, 3, self.eigenvalues.size), axis=1)
        self._turns, self._mass = turns.max(axis=0), np.repeat(coarse.mass, 3)
        balanced = self.frames.load_in_frames(coarse.rest_positions, load).ravel() @ self.lowest / self.eigenvalues
        self.size = max(_FALLING, float(np.abs(balanced * self._turns).max(initial=0.0)))
        """Turn [rad] of a vertex."""

    def drawn(self, load: Array, rng: np.random.Generator) -> Array:
        """A load (k, 3) [N] about one that was drawn; that itself where all parts are held."""
        if not self.frames.parts:
            return load
        softer = self.eigenvalues[0] / self.eigenvalues  # forces of all modes are alike: stiff ones bend less
        q = self.size * softer / self._turns * rng.standard_normal(self._turns.size)
        further = self._mass * (self.lowest @ (self.eigenvalues * q))
        return self.frames.load_in_frames(self.frames.rest, load) + further.reshape(-1, 3)
