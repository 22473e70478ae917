"""Colliders in pictures and films of what touches them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from modalshell.core.typing import Array
from modalshell.render.content import ShadedSurface

if TYPE_CHECKING:
    from modalshell.contact import Contact

_BODY: dict[str, Any] = {"color": "#c9b79c", "smooth": False, "lined": False}
"""How colliders are painted."""
_AROUND = 0.1
"""What planes show beyond the motion, as a share of its size."""
_SEEN = 1.0
"""How far about the motion a picture reaches for the sake of colliders, as a share of the motion's size."""
_INSET = 5e-3
"""Depth below their surfaces at which they are drawn, as a share of the motion's size: what lies on them shows."""


def corners_about(positions: NDArray[np.floating]) -> tuple[Array, float]:
    """Corners (8, 3) [m] of a box a little larger than a motion (F, n, 3), and the depth [m] at which bodies appear."""
    ends, size = _about(positions, _AROUND)
    return np.stack(np.meshgrid(*ends.T), axis=-1).reshape(-1, 3), _INSET * size


def _about(positions: NDArray[np.floating], share: float) -> tuple[Array, float]:
    """Ends (2, 3) [m] of a box that is larger than a motion (F, n, 3) by a share of its size, and that size [m]."""
    points = np.asarray(positions, dtype=np.float64).reshape(-1, 3)
    low, high = points.min(axis=0), points.max(axis=0)
    size = float((high - low).max())
    return np.stack([low, high]) + share * size * np.outer([-1.0, 1.0], np.ones(3)), size


def moving_bodies(
    positions: NDArray[np.floating], contacts: Sequence[Contact], times: Array
) -> list[tuple[ShadedSurface, Array]]:
    """The colliders at the first of some times, and their vertices (F, k, 3), or (1, k, 3), [m] at all of them.

    The rectangles of planes are a little larger than the motion (F, n, 3); a camera goes no farther for large bodies.
    """
    if not contacts:
        return []
    corners, inset = corners_about(positions)
    seen = _about(positions, _SEEN)[0]
    moved = [contact.surfaces(corners, times, inset) for contact in contacts if contact.has_surface]
    return [(ShadedSurface(each[0], faces, framed_in=seen, **_BODY), each) for each, faces in moved]


def bodies_at(positions: NDArray[np.floating], contacts: Sequence[Contact], time: float) -> list[ShadedSurface]:
    """The colliders of a motion (F, n, 3) as they are at a time [s]."""
    return [surface for surface, _ in moving_bodies(positions, contacts, np.array([time]))]
