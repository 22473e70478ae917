"""Single precision keeps about seven digits: far from the origin coordinates lose the shape of a shell."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_LOST = 1e-4
"""Rounding error of a coordinate over the shell's size beyond which the shape is lost."""


def reach_and_size(points: NDArray[np.floating]) -> tuple[float, float]:
    """Largest coordinate of points (n, 3), and the diagonal of their box."""
    if not len(points):
        return 0.0, 0.0
    return float(np.abs(points).max()), float(np.linalg.norm(np.ptp(points, axis=0)))


def lost_in_single_precision(points: NDArray[np.floating], unit: str = "") -> str:
    """How coordinates (n, 3) in ``unit`` are held where single precision loses the shape; "" where it does not."""
    reach, size = reach_and_size(points)
    error = reach * 2.0**-24
    if error <= _LOST * size or size == 0.0:
        return ""
    numbers = f"coordinates of {reach:.3g} # to {error:.1g} #, of a shell of {size:.3g} #"
    return numbers.replace(" #", f" {unit}" if unit else "")
