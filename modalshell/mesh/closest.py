"""Places on a mesh nearest to points, and edges that lie along curves of another mesh."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sps
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from modalshell.core.typing import Array, Index, Mask
from modalshell.mesh.triangle_mesh import TriangleMesh

_NEAR = 12
"""Triangles, by their centres, among which the one nearest a point is looked for."""
TOGETHER = 1e-9
"""Difference of distances, in sizes of the mesh, below which a point lies on several triangles."""
_ALONG = 0.1
"""Distance from a curve, as a share of its length, within which an edge lies along it."""
_TORN = 1.5
"""Detour of ways along edges of the coarse mesh, beyond the edge of the fine one."""
_AT_ONCE = 3_000_000
"""Coordinates of points and segments compared at a time."""


def common_parts(fine: TriangleMesh, coarse: TriangleMesh) -> tuple[Index, Index] | None:
    """Labels of the vertices of two meshes of one surface, the same on the same part of it; None where it is in one.

    A connected part of the coarse mesh, whose vertices lie on the surface, is that of the fine one next to most of
    them. None, too, where some part has none, as of sheets that lie upon each other.
    """
    above, below = fine.components, coarse.components
    count = int(above.max()) + 1
    if count == 1:
        return None
    votes = np.zeros((int(below.max()) + 1, count))
    np.add.at(votes, (below, above[fine.faces[closest_points(fine, coarse.vertices)[0], 0]]), 1.0)
    most = votes.argmax(axis=1)
    return (above, most[below]) if len(np.unique(most)) == count else None


def closest_points(
    mesh: TriangleMesh, points: Array, among: tuple[Index, Index] | None = None
) -> tuple[Index, Array, Array]:
    """Triangle nearest each point (k,), barycentric shares there (k, 3), none negative, and the distance (k,) [m].

    ``among`` are labels of the mesh's vertices (n,) and of the points (k,): triangles are those of a point's own label.
    """
    return all_closest(mesh, points, among)[:3]


def all_closest(
    mesh: TriangleMesh, points: Array, among: tuple[Index, Index] | None = None
) -> tuple[Index, Array, Array, list[Index]]:
    """What :func:`closest_points` gives, and all triangles on which the nearest point lies."""
    if among is None:
        return _closest_of(mesh, np.arange(len(mesh.faces)), points)
    of_faces, of_points = among[0][mesh.faces[:, 0]], among[1]
    nearest, shares = np.zeros(len(points), dtype=np.int64), np.zeros((len(points), 3))
    distance, on = np.zeros(len(points)), [np.empty(0, dtype=np.int64)] * len(points)
    for label in np.unique(of_points):
        rows = np.flatnonzero(of_points == label)
        found = _closest_of(mesh, np.flatnonzero(of_faces == label), points[rows])
        nearest[rows], shares[rows], distance[rows] = found[:3]
        for row, triangles in zip(rows, found[3], strict=True):
            on[row] = triangles
    return nearest, shares, distance, on


def _closest_of(mesh: TriangleMesh, chosen: Index, points: Array) -> tuple[Index, Array, Array, list[Index]]:
    """What :func:`all_closest` gives, of the ``chosen`` triangles (t,) of a mesh."""
    corners = mesh.vertices[mesh.faces[chosen]]
    sheets = int(np.diff(mesh.joints.starts).max(initial=2))
    count = min(_NEAR * sheets // 2, len(corners))
    near = cKDTree(corners.mean(axis=1)).query(points, k=count)[1].reshape(len(points), -1)
    shares = _barycentric(corners[near], points[:, None])
    offsets = np.einsum("pkc,pkcx->pkx", shares, corners[near]) - points[:, None]
    distance = np.linalg.norm(offsets, axis=2)
    least = distance.min(axis=1)
    together = distance <= least[:, None] + TOGETHER * mesh.size
    best = lowest(near, together)  # of triangles as near, whichever way the mesh is turned
    rows = np.arange(len(points))
    on = [chosen[found[part]] for found, part in zip(near, together, strict=True)]
    return chosen[near[rows, best]], shares[rows, best], least, on


def torn_edges(fine: TriangleMesh, coarse: TriangleMesh, under: Index) -> Index:
    """Edges (k,) of a mesh whose ends are next to triangles ``under`` (n,) of far parts of a coarse mesh.

    They are those of layers so close that the chords of the coarse mesh reach from one to the next: the triangles have
    no corner in common, and the way along edges between them is longer than that edge and a side of theirs. Parts of a
    coarse mesh that no edge joins are none: meshes to supports may be cut along them.
    """
    ends = under[fine.edges]
    corners = coarse.faces[ends]
    one = np.ptp(coarse.components[corners[:, :, 0]], axis=1) == 0
    apart = np.flatnonzero(one & ~(corners[:, 0, :, None] == corners[:, 1, None, :]).any(axis=(1, 2)))
    if not apart.size:
        return apart
    edges = coarse.edges
    shape = (len(coarse.vertices),) * 2
    graph = sps.csr_array((coarse.edge_lengths, (edges[:, 0], edges[:, 1])), shape=shape)
    places = coarse.vertices[corners[apart]]
    sides = np.linalg.norm(places - np.roll(places, 1, axis=2), axis=3).max(axis=(1, 2))
    most = _TORN * fine.edge_lengths[apart] + sides
    torn = np.zeros(len(apart), dtype=bool)
    for triangle in np.unique(ends[apart, 0]):
        rows = np.flatnonzero(ends[apart, 0] == triangle)
        ways = dijkstra(graph, directed=False, indices=coarse.faces[triangle], min_only=True, limit=most[rows].max())
        torn[rows] = ways[corners[apart[rows], 1]].min(axis=1) > most[rows]
    return apart[torn]


def lowest(numbers: Index, chosen: Mask) -> Index:
    """Place (p,) of the lowest of the chosen numbers (p, k)."""
    return np.where(chosen, numbers, np.iinfo(np.int64).max).argmin(axis=1)


def _barycentric(corners: Array, points: Array) -> Array:
    """Shares (..., 3) of the point of each triangle (..., 3, 3) that is (nearly) nearest to its point (..., 3)."""
    first, second = corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :]
    arm = points - corners[..., 0, :]
    aa, bb, ab = (np.sum(u * v, axis=-1) for u, v in ((first, first), (second, second), (first, second)))
    ra, rb = np.sum(arm * first, axis=-1), np.sum(arm * second, axis=-1)
    determinant = aa * bb - ab**2
    shares = np.stack([(bb * ra - ab * rb) / determinant, (aa * rb - ab * ra) / determinant], axis=-1)
    whole = np.concatenate([1.0 - shares.sum(axis=-1, keepdims=True), shares], axis=-1).clip(0.0, None)
    return whole / whole.sum(axis=-1, keepdims=True)


def nearest_on_segments(ends: Array, points: Array) -> tuple[Index, Array]:
    """Segment (k,) of those between ``ends`` (e, 2, 3) nearest to each of ``points`` (k, 3), and the point (k, 3)."""
    chosen, places = np.zeros(len(points), dtype=np.int64), np.empty(points.shape)
    arms, starts = ends[:, 1] - ends[:, 0], ends[:, 0]
    for rows in np.array_split(np.arange(len(points)), 1 + points.size * len(ends) // _AT_ONCE):
        near = points[rows, None]
        shares = np.einsum("kex,ex->ke", near - starts, arms) / np.sum(arms**2, axis=1)
        found = starts + shares.clip(0.0, 1.0)[:, :, None] * arms
        chosen[rows] = np.linalg.norm(found - near, axis=2).argmin(axis=1)
        places[rows] = found[np.arange(len(rows)), chosen[rows]]
    return chosen, places


def edges_along(mesh: TriangleMesh, ends: Array) -> tuple[Index, Index]:
    """Edges (k,) of a mesh that lie along curves of segments between ``ends`` (e, 2, 3), and the segment of each.

    Both ends of such an edge, its middle and its quarters are on the curves, by a share of its length.
    """
    lengths = mesh.edge_lengths
    middles = mesh.vertices[mesh.edges].mean(axis=1)
    reach = float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).max())
    apart = cKDTree(ends.mean(axis=1)).query(middles)[0]
    near = np.flatnonzero(apart <= 0.5 * reach + _ALONG * lengths)
    first, last = mesh.vertices[mesh.edges[near]].swapaxes(0, 1)
    off, segments = np.zeros(len(near)), np.zeros(len(near), dtype=np.int64)
    for share in (0.0, 0.25, 0.75, 1.0, 0.5):
        points = (1.0 - share) * first + share * last
        segments, places = nearest_on_segments(ends, points)
        off = np.maximum(off, np.linalg.norm(places - points, axis=1))
    on = off <= _ALONG * lengths[near]
    return near[on], segments[on]
