"""Consistent winding of the triangles of each component.

trimesh.repair.fix_winding needs networkx, walks face by face, and does not report one-sided surfaces.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components

from modalshell.mesh.topology import BoolArray, HalfEdges, IntArray, connected_parts


def faces_to_flip(links: HalfEdges) -> BoolArray:
    """Faces (T,) bool to flip so that neighbours run along their common edge in opposite directions.

    Of the two answers per sheet the one with fewer flips is taken, or on a tie the one that keeps its first face. A
    one-sided sheet, such as a Moebius strip, has no answer: it stays as it is unless flips leave fewer such edges.
    Edges of three faces and more do not count.
    """
    half, forward = links.face_edges.ravel(), links.forward.ravel()
    order = np.argsort(half, kind="stable")
    pairs = order[links.counts[half[order]] == 2].reshape(-1, 2)
    opposed = forward[pairs[:, 0]] == forward[pairs[:, 1]]
    if not opposed.any():
        return np.zeros(len(links.face_edges), dtype=np.bool_)
    flip, torn = flips_and_tears(pairs, opposed, len(links.face_edges))
    if torn.any():
        sheet = connected_parts(pairs // 3, len(links.face_edges))
        before, after = (np.bincount(sheet[pairs[which, 0] // 3], minlength=len(flip)) for which in (opposed, torn))
        flip &= (after < before)[sheet]
    return flip


def flips_and_tears(pairs: IntArray, opposed: BoolArray, count: int) -> tuple[BoolArray, BoolArray]:
    """Which of ``count`` faces to flip so that paired ones are wound alike, and pairs (P,) that no flips satisfy.

    ``pairs`` (P, 2) are joined half-edges, numbered face by face, and ``opposed`` (P,) says which of them run the same
    way, so that one of both faces must be flipped. Of the two answers for each part the one with fewer flips is taken,
    or on a tie the one that keeps the part's first face.
    """
    left, right = np.sort(pairs // 3, axis=1).T
    graph = coo_array((opposed + 1, (left, right)), shape=(count, count)).tocsr()
    _, part = connected_components(graph, directed=False)
    _, roots = np.unique(part, return_index=True)
    flip = np.zeros(count, dtype=np.bool_)
    for root in roots[np.unique(part[left[opposed]])]:
        order, parents = breadth_first_order(graph, root, directed=False)
        order = order[1:]
        above = parents[order]
        turned = np.asarray(graph[np.minimum(order, above), np.maximum(order, above)]).ravel() == 2
        for face, parent, turn in zip(order.tolist(), above.tolist(), turned.tolist(), strict=True):
            flip[face] = flip[parent] != turn
    torn = (flip[left] ^ flip[right]) != opposed
    flipped = np.bincount(part, weights=flip) / np.bincount(part)
    return flip ^ (flipped > 0.5)[part], torn
