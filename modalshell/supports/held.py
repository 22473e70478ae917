"""Held vertices of a shell."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modalshell.checks import shown
from modalshell.errors import SupportError


def held_vertices(clamped: ArrayLike | None, count: int) -> NDArray[np.bool_]:
    """Mask (count,) of held vertices from a mask, from indices, or from None.

    Raises
    ------
    SupportError
        For a mask of another length, indices that are no integers or out of range, or a mask that holds every vertex.
    """
    if clamped is None:
        return np.zeros(count, dtype=bool)
    try:
        given = np.asarray(clamped)
    except ValueError as error:
        raise SupportError(f"clamped must be bool ({count},) or vertex indices (got {shown(clamped)})") from error
    if given.dtype == bool:
        if given.shape != (count,):
            raise SupportError(f"clamped must be a mask ({count},) or vertex indices (got shape {given.shape})")
        mask = given.copy()
    else:
        if given.size and not np.issubdtype(given.dtype, np.integer):
            raise SupportError(f"clamped must be bool (n,) or vertex indices (got dtype {given.dtype})")
        if given.shape == (count,) and count > 2 and np.isin(given, (0, 1)).all():
            raise SupportError("clamped looks like a mask of 0 and 1: pass it as bool, or pass vertex indices")
        if given.ndim > 1:
            raise SupportError(f"clamped must be a mask ({count},) or a list of vertex indices (got {given.shape})")
        indices = given.astype(np.int64).ravel()
        outside = indices[(indices < 0) | (indices >= count)]
        if outside.size:
            raise SupportError(f"clamped names vertex {outside[0]}, but the mesh has vertices 0 to {count - 1}")
        mask = np.zeros(count, dtype=bool)
        mask[indices] = True
    if mask.all():
        raise SupportError(f"clamped holds all {count} vertices, so nothing can move: leave some free")
    return mask
