"""Modal coordinates at which checks have found a small error: an ellipsoid about rest, which grows by them.

The error of a modal rung is a function of its coordinates, about as large at -q as at q, and grows with them. What the
modes lack of the load is looked at apart.
"""

from __future__ import annotations

import numpy as np

from modalshell.core.typing import Array

SURE = 0.1
"""Bar over the error allowed up to which coordinates are trusted as checked."""
SELDOM = 8
"""Intervals of checks after which trusted coordinates are checked all the same."""
_WIDER = 1.2
"""Factor by which trusted coordinates may grow."""
_NOISE = 0.1
"""Share of the largest displacement that any coordinates may have."""
_TINY = 1e-200
"""Square of coordinates [kg m^2] from which they are trusted: inverses of less overflow."""


def trusts(trusted: Array, q: Array, largest: float) -> bool:
    """Whether coordinates (m,) lie in the ellipsoid q . A^-1 q <= 1 of a matrix (m, m), a little wider all round.

    ``largest`` is the largest displacement so far in the norm of the mass [kg^(1/2) m].
    """
    if not trusted.any():
        return False
    wide = trusted + (_NOISE * largest) ** 2 * np.eye(q.size)
    return bool(q @ np.linalg.solve(wide, q) <= 1.0)


def trust(trusted: Array, q: Array) -> None:
    """Grow the ellipsoid of a matrix (m, m), in place, until 1.2 times the coordinates (m,) are on it or inside."""
    point = _WIDER * q
    if not point @ point > _TINY:
        return
    values, axes = np.linalg.eigh(trusted)
    wide = axes @ (np.maximum(values, 1e-12 * max(values[-1], point @ point)) * axes).T
    beyond = point @ np.linalg.solve(wide, point)
    if beyond > 1.0:
        trusted += (1.0 - 1.0 / beyond) * np.outer(point, point)
