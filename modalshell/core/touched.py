"""What touches in one frame of a motion."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from modalshell.core.typing import Array


class TouchedFrame(NamedTuple):
    """Contacts of one frame.

    Attributes
    ----------
    forces : ndarray, shape (n, 3)
        Force of the colliders on every vertex [N], friction left out.
    touches : ndarray of bool, shape (n,)
        Vertices that are pushed.
    deepest : float
        Depth of the deepest vertex [m], at least 0.
    """

    forces: Array
    touches: NDArray[np.bool_]
    deepest: float
