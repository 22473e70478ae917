"""Type aliases that the whole package shares."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""Array of double-precision numbers."""

Index = NDArray[np.int64]
"""Array of whole numbers: vertices, faces, edges."""

Mask = NDArray[np.bool_]
"""Array of true and false, such as which vertices are held."""

Vector = tuple[float, float, float]
"""Three numbers: a direction, a force, an acceleration."""

Progress = Callable[[int, int], None]
"""Called with what is done so far and the total."""


def unheard(done: int, total: int) -> None:
    """Progress that nobody follows."""
