"""Resolution of a mesh: edges within a half wave of a shape."""

from __future__ import annotations

import numpy as np

from modalshell.core.typing import Array
from modalshell.mesh.triangle_mesh import TriangleMesh

FEWEST_EDGES = 4.0
"""Edges a half wave below which frequencies and buckling loads are more than some 3 % off."""


def edges_per_half_wave(mesh: TriangleMesh, shape: Array) -> float:
    """Edges within a half wave of a shape (3n,), in the mean, counted across the waves; infinite for a translation.

    The length of a wave is that of a sine with the same ratio of gradient to size.
    """
    values = shape.reshape(-1, 3)
    corners, at_corners = mesh.vertices[mesh.faces], values[mesh.faces]
    opposite = corners[:, [2, 0, 1]] - corners[:, [1, 2, 0]]
    aside = np.cross(mesh.face_normals[:, None], opposite) / (2.0 * mesh.face_areas)[:, None, None]
    slopes = np.linalg.norm(np.einsum("tix,tic->tcx", aside, at_corners), axis=2)
    steepness = float(mesh.face_areas @ (slopes**2).sum(axis=1))
    size = float(mesh.shared_among_corners(mesh.face_areas) @ (values**2).sum(axis=1))
    # A triangle's extent along the gradient is its range of values over the slope.
    extent = float(mesh.face_areas @ (slopes * np.ptp(at_corners, axis=1)).sum(axis=1))
    return float(np.pi * np.sqrt(size * steepness) / extent) if extent > 0.0 else np.inf


def unresolved_remark(mesh: TriangleMesh, shapes: Array, what: str, off: str, first: int = 1) -> str:
    """A remark on shapes (3n, k) with few edges a half wave, numbered from ``first``; "" if there are none.

    ``what`` they are, in the singular, and what is ``off``.
    """
    edges = [edges_per_half_wave(mesh, shape) for shape in shapes.T]
    few = [str(first + k) for k, count in enumerate(edges) if count < FEWEST_EDGES]
    if not few:
        return ""
    named = f"{what} {few[0]} has" if len(few) == 1 else f"{what}s {', '.join(few)} have"
    return (
        f"{named} fewer than {FEWEST_EDGES:g} edges a half wave (least: {min(edges):.2g}), so that {off} are more than "
        "some 3 % off: take a finer mesh"
    )
