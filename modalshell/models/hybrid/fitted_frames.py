"""Frames of the free parts of a coarse shell that fit their shapes at rest best, and what loads do in them."""

from __future__ import annotations

from typing import final

import numpy as np
from scipy.spatial.transform import Rotation

from modalshell.core.typing import Array
from modalshell.integrators.free_parts import FreePart, FreeParts, axial, crossed, inertia_of
from modalshell.modes import lowest_modes
from modalshell.shell import Shell

_FALLING = 0.05
"""Turn [rad] to train on where loads bend free parts less: what bends them in flight follows from their motion."""


@final
class FittedFrames:
    """Frames of free parts, of least distance from rest in the norm of the mass [kabsch1976].

    Displacements in them have no turn, as those of elastic modes.

    Parameters
    ----------
    rest : ndarray, shape (k, 3)
        Positions at rest [m].
    parts : FreeParts, optional
        The parts; without any all stays as it is.
    """

    def __init__(self, rest: Array, parts: FreeParts | None) -> None:
        self.rest, self.parts = rest, () if parts is None else parts.parts

    def turn(self, part: FreePart, x: Array) -> Array:
        """Rotation (3, 3) of a part at positions (k, 3) [m] of all vertices."""
        arms, first = x[part.vertices], self.rest[part.vertices]
        arms, first = arms - part.mean(arms), first - part.mean(first)
        return np.asarray(Rotation.align_vectors(arms, first, part.mass)[0].as_matrix())

    def local(self, x: Array) -> Array:
        """Positions (k, 3) [m] in the frames."""
        found = x.copy()
        for part in self.parts:
            arms = x[part.vertices]
            found[part.vertices] = (arms - part.mean(arms)) @ self.turn(part, x) + part.mean(self.rest[part.vertices])
        return found

    def felt(self, x: Array, load: Array) -> Array:
        """Load (k, 3) [N] in the world that turns with the frames at x (k, 3) [m], less what moves and turns these."""
        found = load.copy()
        for part in self.parts:
            given, arms = load[part.vertices] @ self.turn(part, x).T, x[part.vertices]
            arms, force = arms - part.mean(arms), given.sum(axis=0)
            faster = np.asarray(np.linalg.solve(inertia_of(part.moments(arms, arms)), axial(given.T @ arms)))
            found[part.vertices] = given - part.mass[:, None] * (force / part.total + crossed(faster, arms))
        return found


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
        balanced = self.frames.felt(coarse.rest_positions, load).ravel() @ self.lowest / self.eigenvalues
        self.size = max(_FALLING, float(np.abs(balanced * self._turns).max(initial=0.0)))
        """Turn [rad] of a vertex."""

    def drawn(self, load: Array, rng: np.random.Generator) -> Array:
        """A load (k, 3) [N] about one that was drawn; that itself where all parts are held."""
        if not self.frames.parts:
            return load
        softer = self.eigenvalues[0] / self.eigenvalues  # forces of all modes are alike: stiff ones bend less
        q = self.size * softer / self._turns * rng.standard_normal(self._turns.size)
        further = self._mass * (self.lowest @ (self.eigenvalues * q))
        return self.frames.felt(self.frames.rest, load) + further.reshape(-1, 3)
