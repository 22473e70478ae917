"""What touches in one frame of a motion."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from modalshell.core.typing import Array

STRUCK = "something strikes a collider"
PUSHED_OUT = "vertices are being pushed out"
UNSETTLED = "what touches does not settle"
"""Why frames of a motion with contacts are not judged by error bars."""

TOUCHED = "contact_forces", "in_contact", "deepest", "self_contact"
"""Names of its parts in trajectories and in records of runs."""


class TouchedFrame(NamedTuple):
    """Contacts of one frame."""

    forces: Array
    """Force of the colliders on every vertex [N], friction left out; shape (n, 3)."""
    touches: NDArray[np.bool_]
    """Vertices that are pushed; shape (n,)."""
    deepest: float
    """Depth of the deepest vertex [m], at least 0."""
    self_contact: float = np.nan
    """Smallest distance [m] of parts in self-contact, at most its gap; NaN without self-contact."""
