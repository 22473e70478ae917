"""Held vertices of a shell."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modalshell.core.errors import OptionError, SupportError
from modalshell.mesh import TriangleMesh
from modalshell.mesh.selection import selected, vertex_mask


def held_vertices(clamped: ArrayLike | str | None, count: int, mesh: TriangleMesh | None = None) -> NDArray[np.bool_]:
    """Mask (count,) of held vertices from a mask, from indices, from an expression on ``mesh``, or from None.

    Raises
    ------
    SupportError
        For a mask of another length, indices that are no integers or out of range, or a mask that holds every vertex.
    """
    if clamped is None:
        return np.zeros(count, dtype=bool)
    try:
        named = selected("clamped", clamped, mesh) if isinstance(clamped, str) and mesh is not None else clamped
    except OptionError as error:
        raise SupportError(str(error)) from error
    mask = vertex_mask("clamped", named, count, SupportError)
    if mask.all():
        raise SupportError(f"clamped holds all {count} vertices, so nothing can move: leave some free")
    return mask
