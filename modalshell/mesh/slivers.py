"""Triangles too thin to bend as the surface would."""

from __future__ import annotations

import numpy as np

from modalshell.mesh.triangle_mesh import TriangleMesh

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
