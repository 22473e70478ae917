"""Whether a deformed surface is still one that modes can describe, by the same criteria for every modal model."""

from __future__ import annotations

import numpy as np

from modalshell.mesh import TriangleMesh
from modalshell.mesh.topology import area_vectors
from modalshell.outcome import Outcome
from modalshell.typing import Array

_AREA = 2.0
"""Factor on the area of the surface or of a triangle, either way, from which a thin shell is no longer one."""
_CRUMPLED = 0.1
"""Share of the surface whose triangles may have changed by that."""
_OVER = -0.5
"""Cosine between the normals of neighbours below which a surface that was not folded has folded over."""
_SHARE = 0.05
"""Share of the edges at which it may."""


def distortion(positions: Array, mesh: TriangleMesh) -> str:
    """What has become of the surface at ``positions`` (n, 3), if modes cannot describe it; else an empty text.

    A shell bends with little stretch: neither its area nor that of a good part of its triangles doubles or halves, and
    its triangles do not fold over their neighbours.
    """
    normals = area_vectors(positions, mesh.faces)
    lengths = np.linalg.norm(normals, axis=1)
    ratio = 0.5 * float(lengths.sum()) / mesh.area
    if not 1.0 / _AREA < ratio < _AREA:
        return f"the surface area is {ratio:.3g} of that at rest"
    changes = np.abs(np.log(np.maximum(0.5 * lengths, 1e-300) / mesh.face_areas))
    crumpled = float(mesh.face_areas[changes > np.log(_AREA)].sum()) / mesh.area
    if crumpled > _CRUMPLED:
        return f"the area doubled or halved on {100.0 * crumpled:.2g} % of the surface"
    units = normals / np.maximum(lengths, 1e-300)[:, None]
    first, second = mesh.edge_faces[mesh.hinge_edges].T
    over = np.einsum("hi,hi->h", units[first], units[second]) < _OVER
    over &= np.einsum("hi,hi->h", mesh.face_normals[first], mesh.face_normals[second]) > 0.0
    if over.mean() > _SHARE:
        return f"triangles fold over their neighbours at {100.0 * over.mean():.2g} % of the edges"
    return ""


def judged(outcome: Outcome, message: str, positions: Array, mesh: TriangleMesh) -> tuple[Outcome, str]:
    """Outcome and message of a static answer, with what :func:`distortion` says of its ``positions`` (n, 3)."""
    said = distortion(positions, mesh)
    if not said:
        return outcome, message
    said = f"beyond what the model can describe: {said}"
    return Outcome.DISTORTED if outcome is Outcome.CONVERGED else outcome, f"{message}; {said}" if message else said
