"""Sharing of vertex reactions among the supports that hold the vertices."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from modalshell.core.typing import Array
from modalshell.mesh import TriangleMesh
from modalshell.supports.base import Support


def shared_reactions(supports: Sequence[Support], mesh: TriangleMesh, reactions: Array) -> list[Array]:
    """The share (n, 3) of each support in ``reactions`` (n, 3) [N] on a mesh.

    Each takes the force along its own directions; supports that hold a vertex along the same one share it evenly.
    """
    shares = [np.zeros_like(reactions) for _ in supports]
    if not supports:
        return shares
    chosen = np.stack([support.vertices(mesh) for support in supports], axis=1)
    for held in np.unique(chosen, axis=0):
        vertices, active = np.flatnonzero((chosen == held).all(axis=1)), np.flatnonzero(held)
        directions = [supports[int(k)].directions() for k in active]
        # The least forces along all directions whose sum is the reaction.
        forces = reactions[vertices] @ np.linalg.pinv(np.vstack([np.empty((0, 3)), *directions]))
        ends = np.cumsum([len(own) for own in directions])
        for k, own, end in zip(active, directions, ends, strict=True):
            shares[k][vertices] = forces[:, end - len(own) : end] @ own
    return shares
