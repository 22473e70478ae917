"""Consistent winding of the triangles of each component.

trimesh.repair.fix_winding needs networkx, walks face by face, and does not report one-sided surfaces.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components

from modalshell.errors import REPAIR, MeshError
from modalshell.mesh.topology import BoolArray, HalfEdges, IntArray


def faces_to_flip(links: HalfEdges) -> BoolArray:
    """Faces (T,) bool to flip so that neighbours run along their common edge in opposite directions.

    Of the two answers per connected component the one with fewer flips is taken, or on a tie the one that keeps the
    component's first face. Needs edges with at most two faces.

    Raises
    ------
    MeshError
        When no consistent winding exists, as on a Moebius strip.
    """
    count = len(links.face_edges)
    left, right, agree = _neighbours(links)
    if agree.all():
        return np.zeros(count, dtype=np.bool_)
    # Double cover: node t is face t kept, node t + count is face t flipped. Faces that agree link kept to kept, others
    # kept to flipped. A face whose two nodes land in one component sits on a one-sided surface.
    other = np.where(agree, right, right + count)
    mirrored = np.where(agree, right + count, right)
    rows = np.concatenate((left, left + count))
    columns = np.concatenate((other, mirrored))
    graph = coo_array((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(2 * count, 2 * count)).tocsr()
    _, sheet = connected_components(graph, directed=False)
    kept, flipped = sheet[:count], sheet[count:]
    if (kept == flipped).any():
        raise _one_sided(links, left, right, agree, int(np.argmax(kept == flipped)))
    # A sheet's cost is how many flipped faces it holds; the cheaper of a component's two sheets is chosen.
    cost = np.bincount(flipped, minlength=int(sheet.max()) + 1)
    first = np.full(len(cost), count)
    np.minimum.at(first, kept, np.arange(count))
    flip = cost[kept] > cost[flipped]
    tie = (cost[kept] == cost[flipped]) & (first[kept] > first[flipped])
    return np.asarray(flip | tie, dtype=np.bool_)


def _neighbours(links: HalfEdges) -> tuple[IntArray, IntArray, BoolArray]:
    """Face pairs over the edges with two faces, and whether the two windings agree."""
    half = links.face_edges.ravel()
    order = np.argsort(half, kind="stable")
    order = order[links.counts[half[order]] == 2]
    first, second = order[0::2], order[1::2]
    forward = links.forward.ravel()
    return first // 3, second // 3, forward[first] != forward[second]


def _one_sided(links: HalfEdges, left: IntArray, right: IntArray, agree: BoolArray, start: int) -> MeshError:
    """Build the error that names the first edge where a walk over the faces from `start` contradicts itself."""
    count = len(links.face_edges)
    parity_of = {}
    for a, b, same in zip(left.tolist(), right.tolist(), agree.tolist(), strict=True):
        parity_of[a, b] = parity_of[b, a] = not same
    graph = coo_array((np.ones(len(left), dtype=np.int8), (left, right)), shape=(count, count)).tocsr()
    order, parents = breadth_first_order(graph, start, directed=False)
    side = np.full(count, -1)
    side[start] = 0
    for face in order[1:]:
        side[face] = side[parents[face]] ^ int(parity_of[int(face), int(parents[face])])
    clash = (side[left] >= 0) & ((side[left] ^ side[right]) != ~agree)
    text = ""
    if clash.any():
        a, b = int(left[np.argmax(clash)]), int(right[np.argmax(clash)])
        shared = np.intersect1d(links.face_edges[a], links.face_edges[b])[0]
        low, high = links.edges[shared].tolist()
        text = f"; the first contradiction is at edge ({low}, {high}) between faces {a} and {b} (counted from 0)"
    return MeshError(
        f"no consistent winding exists: the surface is one-sided, like a Moebius strip{text}; a shell needs two sides: "
        f"cut it open along a row of edges by {REPAIR}"
    )
