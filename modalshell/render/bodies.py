"""Colliders in pictures and films of what touches them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
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
_DEEPEST = 0.02
"""The same where triangles dip into them, at most."""
_LOOKED_AT = 12
"""Frames in which it is seen how deep triangles dip."""


def seen_contacts(
    positions: NDArray[np.floating], faces: NDArray[np.integer], times: Array, contacts: Sequence[Contact]
) -> Iterator[tuple[Contact, Array, float]]:
    """The contacts with a surface of a motion (F, n, 3) at times (F,), each with how much of it is drawn, and where.

    These are corners (8, 3) [m] of a box a little larger than the motion, and a depth [m] below the surface. Triangles
    (T, 3) dip in between their vertices, and would be hidden there.
    """
    ends, size = _about(positions, _AROUND)
    corners = np.stack(np.meshgrid(*ends.T), axis=-1).reshape(-1, 3)
    frames = np.unique(np.linspace(0, len(times) - 1, _LOOKED_AT).round().astype(int))
    for contact in contacts:
        if contact.has_surface:
            middles = ((np.asarray(positions[k], float)[faces].mean(axis=1), float(times[k])) for k in frames)
            dip = max(-float(contact.distance(middle, time).min(initial=0.0)) for middle, time in middles)
            yield contact, corners, min(_INSET * size + dip, _DEEPEST * size)


def _about(positions: NDArray[np.floating], share: float) -> tuple[Array, float]:
    """Ends (2, 3) [m] of a box that is larger than a motion (F, n, 3) by a share of its size, and that size [m]."""
    points = np.asarray(positions, dtype=np.float64).reshape(-1, 3)
    low, high = points.min(axis=0), points.max(axis=0)
    size = float((high - low).max())
    return np.stack([low, high]) + share * size * np.outer([-1.0, 1.0], np.ones(3)), size


def moving_bodies(
    positions: NDArray[np.floating], faces: NDArray[np.integer], times: Array, contacts: Sequence[Contact], drawn: Array
) -> list[tuple[ShadedSurface, Array]]:
    """The colliders at the first of ``drawn`` times, and their vertices (F, k, 3), or (1, k, 3), [m] at all of them.

    The motion is that of :func:`seen_contacts`. Planes are a little larger; a camera goes no farther for large bodies.
    """
    if not contacts:
        return []
    framed = _about(positions, _SEEN)[0]
    seen = seen_contacts(positions, faces, times, contacts)
    moved = [contact.surfaces(corners, drawn, inset) for contact, corners, inset in seen]
    return [(ShadedSurface(each[0], sides, framed_in=framed, **_BODY), each) for each, sides in moved]


def bodies_at(
    positions: NDArray[np.floating], faces: NDArray[np.integer], times: Array, contacts: Sequence[Contact], time: float
) -> list[ShadedSurface]:
    """The colliders of a motion as they are at a time [s]."""
    return [surface for surface, _ in moving_bodies(positions, faces, times, contacts, np.array([time]))]
