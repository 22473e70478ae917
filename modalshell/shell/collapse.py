"""Detection of collapsed triangles as the cause of numbers that are not finite."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from modalshell.core.errors import LoadError
from modalshell.core.typing import Array
from modalshell.mesh import TriangleMesh


def refuse_collapse(mesh: TriangleMesh, name: str, values: ArrayLike, x: Array) -> None:
    """LoadError that names the flattest triangle at ``x`` (n, 3), where ``values`` are not all finite."""
    if np.isfinite(values).all():
        return
    corners = x[mesh.faces]
    sides = corners - np.roll(corners, 1, axis=1)
    longest = np.max(np.sum(sides**2, axis=2), axis=1)
    flatness = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) / np.where(longest > 0.0, longest, 1.0)
    worst = int(np.argmin(flatness))
    raise LoadError(
        f"the {name} is not finite at these positions; the flattest triangle is {worst}, vertices "
        f"{mesh.faces[worst].tolist()} (counted from 0), twice its area {flatness[worst]:.1e} of its longest side "
        "squared: move its corners apart"
    )
