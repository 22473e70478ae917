"""Triangles that have collapsed, where energies and their derivatives are not finite."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modalshell.errors import LoadError
from modalshell.typing import Array


def refuse_collapse(name: str, values: ArrayLike, x: Array, faces: NDArray[np.integer]) -> None:
    """LoadError that names the flattest triangle at positions x (n, 3), unless all ``values`` are finite."""
    if np.isfinite(values).all():
        return
    corners = x[faces]
    sides = corners - np.roll(corners, 1, axis=1)
    longest = np.max(np.sum(sides**2, axis=2), axis=1)
    flatness = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) / np.where(longest > 0.0, longest, 1.0)
    worst = int(np.argmin(flatness))
    raise LoadError(
        f"the {name} is not finite at these positions; the flattest triangle is {worst}, vertices "
        f"{faces[worst].tolist()} (counted from 0), twice its area {flatness[worst]:.1e} of its longest "
        "side squared: move its corners apart"
    )
