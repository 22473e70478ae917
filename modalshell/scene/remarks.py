"""Remarks on scenes: triangles too thin to bend as the surface would, and clamps that turn as hinges do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from modalshell.mesh import TriangleMesh
from modalshell.supports import Clamp, Support

_THIN, _MUCH = 0.11, 0.1
"""Height over length of a sliver, and fraction of the area from which slivers matter."""


def sliver_remark(mesh: TriangleMesh) -> str:
    """A remark on triangles that bend too softly where they are many; "" where they are few."""
    sides = np.linalg.norm(np.diff(mesh.vertices[mesh.faces[:, [0, 1, 2, 0]]], axis=1), axis=2)
    thin = 2.0 * mesh.face_areas < _THIN * sides.max(axis=1) ** 2
    fraction = float(mesh.face_areas[thin].sum()) / mesh.area
    if fraction < _MUCH:
        return ""
    return (
        f"{100.0 * fraction:.0f} % of the area is in slivers, triangles some ten times as long as high or more, which "
        "bend too softly (a plate by 5 % where all are 1 : 10, by up to 17 % where 1 : 20): remesh it, or take cells "
        "that are closer to square"
    )


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
