"""Frames of the free parts of a shell that fit their shapes at rest best, and what loads do in them."""

from __future__ import annotations

from typing import final

import numpy as np
from scipy.spatial.transform import Rotation

from modalshell.core.typing import Array
from modalshell.integrators.free_parts import FreePart, FreeParts


@final
class FittedFrames:
    """Frames of free parts, of least distance from ``rest`` (k, 3) [m] in the norm of the mass [kabsch1976].

    Displacements in them have no turn, as those of elastic modes. Without parts all stays as it is.
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

    def load_in_frames(self, x: Array, load: Array) -> Array:
        """Load (k, 3) [N] in the world that turns with the frames at x (k, 3) [m], balanced by the parts' inertia."""
        found = load.copy()
        for part in self.parts:
            given, arms = load[part.vertices] @ self.turn(part, x).T, x[part.vertices]
            found[part.vertices] = part.balanced(arms - part.mean(arms), given)
        return found
