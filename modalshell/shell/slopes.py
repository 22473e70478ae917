"""Edges where supports fix the slope of a surface: clamped edges, and edges in symmetry planes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from modalshell.core.typing import Array, Index, Mask
from modalshell.mesh import TriangleMesh
from modalshell.supports import Support


@final
@dataclass(frozen=True)
class HeldSlopes:
    """Where supports hold the slope of a surface."""

    clamped: Mask
    """Vertices of clamps: edges between two of them are clamped. Shape (n,)."""
    mirrored: Index
    """Edges in planes of symmetry: those with triangles on one side alone, and junctions; shape (s,)."""
    normals: Array
    """Unit normals of their planes; shape (s, 3)."""

    def reflections(self) -> Array:
        """Reflections ``I - 2 N N^T`` (s, 3, 3) about the planes."""
        return np.asarray(np.eye(3) - 2.0 * self.normals[:, :, None] * self.normals[:, None, :])

    @classmethod
    def of(cls, clamped: Mask) -> HeldSlopes:
        """Clamped vertices without planes of symmetry."""
        return cls(clamped, np.empty(0, dtype=np.int64), np.empty((0, 3)))


def held_slopes(supports: Sequence[Support], mesh: TriangleMesh) -> HeldSlopes:
    """Slopes that ``supports`` hold; of edges that are clamped and mirrored the clamp counts."""
    clamped = np.zeros(len(mesh.vertices), dtype=bool)
    plane = np.zeros((len(mesh.edges), 3))
    for support in supports:
        if support.clamps:
            clamped |= support.vertices(mesh)
        normal = support.mirror()
        if normal is None:
            continue
        inside = support.vertices(mesh)
        # A triangle in the plane itself is its own mirror image, and folds about none of its edges.
        outside: Mask = np.append(~inside[mesh.faces].all(axis=1), False)  # the last: no triangle
        middles = mesh.vertices[mesh.faces].mean(axis=1) - mesh.vertices[np.argmax(inside)]
        sides = outside * np.append(middles @ normal, 0.0)
        rim = outside[mesh.edge_faces].any(axis=1) & (sides[mesh.edge_faces].prod(axis=1) >= 0.0)
        joints, starts, wings = mesh.joints
        if joints.size:
            rim[joints] = np.logical_or.reduceat(outside[wings // 3], starts[:-1])
        plane[rim & inside[mesh.edges].all(axis=1)] = normal
    plane[clamped[mesh.edges].all(axis=1)] = 0.0
    mirrored = np.flatnonzero(plane.any(axis=1))
    return HeldSlopes(clamped, mirrored, plane[mirrored])
