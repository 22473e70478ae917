"""Sheets that touch without sharing vertices, so that nothing holds them together there."""

from __future__ import annotations

import warnings

import numpy as np
from scipy.spatial import cKDTree

from modalshell.core.errors import ModalShellWarning
from modalshell.core.typing import Array, Index
from modalshell.mesh.triangle_mesh import TriangleMesh

TOUCHING = 1e-6
"""Distance of a vertex from a triangle, as a share of the mesh's diagonal, at which it lies on it."""


def warn_of_unjoined(mesh: TriangleMesh, name: str) -> None:
    """Warn of vertices that lie on triangles of the mesh ``name`` without being their corners."""
    vertices, faces = unjoined(mesh)
    if len(vertices):
        warnings.warn(
            f"{name}: {len(vertices)} vertices lie on triangles without being their corners, first vertex "
            f"{vertices[0]} on face {faces[0]} (counted from 0): sheets are joined where they share "
            "vertices alone, and not there; mesh the parts together, or tie them (ms.Tie)",
            ModalShellWarning,
            stacklevel=3,
        )


def unjoined(mesh: TriangleMesh) -> tuple[Index, Index]:
    """Vertices (k,) that lie on a triangle without being or coinciding with one of its corners, and that triangle (k,).

    Vertices of free edges are looked at, and all vertices on free edges.
    """
    boundary = mesh.boundary_vertices
    if not len(boundary):
        return np.empty(0, np.int64), np.empty(0, np.int64)
    points, faces = mesh.vertices, mesh.faces
    near = TOUCHING * float(np.linalg.norm(np.ptp(points, axis=0)))
    free = np.flatnonzero(mesh.edge_faces[:, 1] < 0)
    pairs = [_candidates(points[boundary], points[faces], near), _candidates(points, points[mesh.edges[free]], near)]
    vertex = np.concatenate([boundary[pairs[0][0]], pairs[1][0]])
    face = np.concatenate([pairs[0][1], mesh.edge_faces[free[pairs[1][1]], 0]])
    corners = points[faces[face]]
    apart = np.linalg.norm(corners - points[vertex, None], axis=2).min(axis=1) > near
    vertex, face, corners = vertex[apart], face[apart], corners[apart]
    if not len(vertex):
        return vertex, face
    on = _distances(corners, points[vertex]) <= near
    kept, first = np.unique(vertex[on], return_index=True)
    return kept, face[on][first]


def _distances(corners: Array, points: Array) -> Array:
    """Distance (k,) of each of some points (k, 3) from its triangle (k, 3, 3)."""
    sides, arms = np.roll(corners, -1, axis=1) - corners, points[:, None] - corners
    shares = (np.sum(arms * sides, axis=2) / np.sum(sides**2, axis=2)).clip(0.0, 1.0)
    from_sides = np.linalg.norm(arms - shares[:, :, None] * sides, axis=2).min(axis=1)
    normals = np.cross(sides[:, 0], sides[:, 1])
    above = (np.cross(sides, arms) @ normals[:, :, None] >= 0.0).all(axis=(1, 2))
    heights = np.abs(np.sum(arms[:, 0] * normals, axis=1)) / np.linalg.norm(normals, axis=1)
    return np.where(above, np.minimum(heights, from_sides), from_sides)


def _candidates(points: Array, elements: Array, near: float) -> tuple[Index, Index]:
    """Pairs of points (k, 3) and of elements (e, c, 3) in whose bounding spheres they lie."""
    centres = elements.mean(axis=1)
    radii = np.linalg.norm(elements - centres[:, None], axis=2).max(axis=1) + near
    tree = cKDTree(points)
    octave = np.floor(np.log2(np.maximum(radii, np.finfo(float).tiny))).astype(int)
    found: list[tuple[Index, Index]] = []
    for level in np.unique(octave):  # one large triangle must not widen the search about all small ones
        own = np.flatnonzero(octave == level)
        close = cKDTree(centres[own], balanced_tree=False, compact_nodes=False).sparse_distance_matrix(
            tree, float(radii[own].max()), output_type="coo_matrix"
        )
        found.append((np.asarray(close.col, dtype=np.int64), own[close.row]))
    return np.concatenate([pair[0] for pair in found]), np.concatenate([pair[1] for pair in found])
