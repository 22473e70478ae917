"""Derivatives of functions by differences of fourth order."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from modalshell.core.typing import Array

_FOURTH_ORDER = ((-2, 1.0 / 12.0), (-1, -2.0 / 3.0), (1, 2.0 / 3.0), (2, -1.0 / 12.0))


def slope(function: Callable[[Array], ArrayLike], at: Array, way: Array, step: float) -> Array:
    """Derivative of a function at ``at`` along ``way``, by its values up to two steps away."""
    return np.asarray(sum(w / step * np.asarray(function(at + k * step * way)) for k, w in _FOURTH_ORDER))
