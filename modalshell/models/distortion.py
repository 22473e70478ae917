"""Whether a deformed surface is still one that modes can describe, by the same criteria for every modal model."""

from __future__ import annotations

import numpy as np

from modalshell.mesh import TriangleMesh
from modalshell.mesh.topology import area_vectors
from modalshell.typing import Array

_AREA = 2.0
"""Factor on the surface area, either way, from which a thin shell is no longer one."""
_OVER = -0.5
"""Cosine between the normals of neighbours below which a surface that was not folded has folded over."""
_SHARE = 0.05
"""Share of the edges at which it may."""


def distortion(positions: Array, mesh: TriangleMesh) -> str:
    """What has become of the surface at ``positions`` (n, 3), if modes cannot describe it; else an empty text.

    A shell bends with little stretch: its area does not double, and its triangles do not fold over their neighbours.
    """
    normals = area_vectors(positions, mesh.faces)
    lengths = np.linalg.norm(normals, axis=1)
    ratio = 0.5 * float(lengths.sum()) / mesh.area
    if not 1.0 / _AREA < ratio < _AREA:
        return f"the surface area is {ratio:.3g} of that at rest"
    units = normals / np.maximum(lengths, 1e-300)[:, None]
    first, second = mesh.edge_faces[mesh.hinge_edges].T
    over = np.einsum("hi,hi->h", units[first], units[second]) < _OVER
    over &= np.einsum("hi,hi->h", mesh.face_normals[first], mesh.face_normals[second]) > 0.0
    if over.mean() > _SHARE:
        return f"triangles fold over their neighbours at {100.0 * over.mean():.2g} % of the edges"
    return ""
