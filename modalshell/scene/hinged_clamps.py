"""Clamps of one row of vertices on materials of hinges, which leave the sheet free to turn about that row."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from modalshell.mesh import TriangleMesh
from modalshell.supports import Clamp, Support


def hinged_clamp_remark(mesh: TriangleMesh, supports: Sequence[Support]) -> str:
    """What is said of clamps that turn as hinges: hinges resist folding between triangles, and there is none beyond.

    They are edges of one triangle whose ends are clamped, but belong to no triangle that supports hold as a whole. ""
    without any.
    """
    clamped, held, firm = np.zeros((3, len(mesh.vertices)), dtype=bool)
    for support in supports:
        if isinstance(support, Clamp):
            clamped |= support.vertices(mesh)
        if not support.ties and len(support.directions()) == 3:
            held |= support.vertices(mesh)
    firm[mesh.faces[held[mesh.faces].all(axis=1)]] = True
    rim = mesh.edges[mesh.edge_faces[:, 1] < 0]
    count = int((clamped & ~firm)[rim].all(axis=1).sum())
    if not count:
        return ""
    edges = "1 edge" if count == 1 else f"{count} edges"
    return (
        f"the clamp holds one row of vertices at {edges} of the rim: a material of hinges leaves the sheet free to "
        "turn there, as a door does; clamp a second row, or take shell theory (young, poisson, thickness, density)"
    )
