"""Edges and hinges of a triangle list, by sorting half-edges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from modalshell.core.typing import Array, Index, Mask


@dataclass(frozen=True)
class HalfEdges:
    """Half-edges of a triangle list, in the order face by face: (f0, f1), (f1, f2), (f2, f0)."""

    edges: Index
    """Undirected edges, the smaller vertex first, in lexicographic order; shape (E, 2)."""
    face_edges: Index
    """Index into `edges` of each face's three half-edges; shape (T, 3)."""
    counts: Index
    """Number of faces at each edge; shape (E,)."""
    forward: Mask
    """Whether the face runs along the edge from its smaller to its larger vertex; shape (T, 3)."""


def half_edges(faces: Index, vertex_count: int) -> HalfEdges:
    """Pair the half-edges of `faces` (T, 3), whose indices lie in [0, vertex_count)."""
    start = faces.ravel()
    end = faces[:, [1, 2, 0]].ravel()
    low = np.minimum(start, end)
    key = low * vertex_count + np.maximum(start, end)
    unique, inverse, counts = np.unique(key, return_inverse=True, return_counts=True)
    return HalfEdges(
        edges=np.column_stack(np.divmod(unique, vertex_count)),
        face_edges=np.ascontiguousarray(inverse.reshape(-1, 3).astype(np.int64)),
        counts=counts.astype(np.int64),
        forward=(start == low).reshape(-1, 3),
    )


def numbers_of_edges(edges: Index, pairs: Index) -> Index:
    """Number (...) of the edge between each pair (..., 2) of vertices, among ``edges`` (E, 2) in order; -1 for none."""
    count = 1 + max(int(edges.max()), int(pairs.max(initial=0)))
    keys, wanted = edges @ [count, 1], np.sort(pairs, axis=-1) @ [count, 1]
    found = np.searchsorted(keys, wanted).clip(max=len(keys) - 1)
    return np.where(keys[found] == wanted, found, -1).astype(np.int64)


def connected_parts(pairs: Index, count: int) -> Index:
    """Number of the connected part of each of ``count`` things, shape (count,), of which pairs (P, 2) are joined."""
    graph = coo_array((np.ones(len(pairs), dtype=np.int8), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def faces_of_edges(links: HalfEdges) -> tuple[Index, Index]:
    """Two faces of each edge and its first corner in either, shape (E, 2); edges with one or two consistent faces.

    Column 0 is the face that runs along the edge from the smaller to the larger vertex; on a boundary edge it is the
    only face, and column 1 is -1. The edge runs from that corner to the next in the face's winding.
    """
    half = links.face_edges.ravel()
    side = np.where(links.forward.ravel() | (links.counts[half] == 1), 0, 1)
    of_edges = np.full((len(links.edges), 2), -1, dtype=np.int64)
    of_edges[half, side] = np.arange(len(half))
    return np.where(of_edges < 0, -1, of_edges // 3), np.where(of_edges < 0, -1, of_edges % 3)


def hinges_of_edges(faces: Index, links: HalfEdges, edge_faces: Index) -> tuple[Index, Index]:
    """Hinges (H, 4) and their edges (H,), ascending.

    A hinge is [x0, x1, x2, x3]: the edge x0 -> x1 with x0 < x1, the face (x0, x1, x2) on its left, the face
    (x1, x0, x3) on its right, both in their own winding, so that the fold angle is 0 where the surface is flat.
    """
    hinge_edges = np.flatnonzero(edge_faces[:, 1] >= 0)
    # The corner opposite half-edge k (from corner k to k + 1) is corner k + 2.
    opposite = np.zeros((len(links.edges), 2), dtype=np.int64)
    opposite[links.face_edges.ravel(), np.where(links.forward.ravel(), 0, 1)] = faces[:, [2, 0, 1]].ravel()
    return np.column_stack((links.edges[hinge_edges], opposite[hinge_edges])), hinge_edges


def area_vectors(vertices: Array, faces: NDArray[np.integer]) -> Array:
    """Vectors (T, 3) along the normals of triangles, twice their areas [m^2] long."""
    first, second, third = (vertices[own] for own in faces.T)
    return np.cross(second - first, third - first)
