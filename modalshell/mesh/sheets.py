"""Consistent winding of triangles, and splitting of a triangle soup into manifold, two-sided sheets.

To split, faces are joined over edges by pairs of half-edges; faces round a vertex that no chain of pairs joins get
vertices of their own. This splits edges with three or more faces, and vertices at which two fans of faces meet, in one
step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components

from modalshell.core.typing import Array, Index, Mask
from modalshell.mesh.topology import HalfEdges, connected_parts, half_edges


def faces_to_flip(links: HalfEdges) -> Mask:
    """Faces (T,) bool to flip so that neighbours run along their common edge in opposite directions.

    Of the two answers per sheet the one with fewer flips is taken, or on a tie the one that keeps its first face. A
    one-sided sheet, such as a Moebius strip, has no answer: it stays as it is unless flips leave fewer such edges.
    Edges of three faces and more do not count.
    """
    # trimesh.repair.fix_winding needs networkx, walks face by face, and does not report one-sided surfaces.
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


def flips_and_tears(pairs: Index, opposed: Mask, count: int) -> tuple[Mask, Mask]:
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


class Sheets(NamedTuple):
    """Triangles cut apart."""

    vertices: Array
    """The vertices as they were, followed by new ones; shape (n, 3)."""
    faces: Index
    """The triangles, wound alike; shape (T, 3)."""
    split_edges: int
    """Edges that had three or more faces."""
    split_vertices: int
    """Vertices that were added."""
    cut_edges: int
    """Edges along which a one-sided surface was cut open."""
    flipped: int
    """Triangles that were flipped."""


def touching_apart(vertices: Array, faces: Index) -> Sheets:
    """Split vertices at which sheets touch without a common edge, and wind the faces of every sheet alike.

    Edges of three and more faces stay, and so do one-sided surfaces.
    """
    links = half_edges(faces, len(vertices))
    half = links.face_edges.ravel()
    order = np.argsort(half, kind="stable")
    same = half[order[1:]] == half[order[:-1]]
    apart, faces = _fans_apart(vertices, faces, np.column_stack([order[:-1][same], order[1:][same]]))
    flip = faces_to_flip(half_edges(faces, len(apart)))
    faces = np.where(flip[:, None], faces[:, [0, 2, 1]], faces)
    return Sheets(apart, faces, 0, len(apart) - len(vertices), 0, int(flip.sum()))


def cut_into_sheets(vertices: Array, faces: Index) -> Sheets:
    """Split what is no surface, cut one-sided surfaces open, and wind the faces alike.

    The faces must have distinct corners, and no two the same three. Where more than two faces meet at an edge, those
    are joined that are wound alike and lie flattest. A surface that still passes twice over one pair of vertices gets
    a vertex at the middle of the edge for each further pass. No triangle is moved or left out.
    """
    count = len(vertices)
    split_edges = int((half_edges(faces, count).counts > 2).sum())
    while True:
        pairs, crowded = _paired_half_edges(vertices, faces)
        vertices, faces = _fans_apart(vertices, faces, pairs)
        if not crowded:
            break
        vertices, faces, bisected = _bisect_repeated_edges(vertices, faces)
        if not bisected:
            break
    pairs, _ = _paired_half_edges(vertices, faces)
    corners = faces.ravel()[pairs]
    flip, torn = flips_and_tears(pairs, corners[:, 0] == corners[:, 1], len(faces))
    if torn.any():
        vertices, faces = _fans_apart(vertices, faces, pairs[~torn])
    faces = np.where(flip[:, None], faces[:, [0, 2, 1]], faces)
    return Sheets(vertices, faces, split_edges, len(vertices) - count, int(torn.sum()), int(flip.sum()))


def _paired_half_edges(vertices: Array, faces: Index) -> tuple[Index, bool]:
    """Pairs (P, 2) of half-edges, numbered as in ``faces.ravel()``, and whether some edge has more than two."""
    links = half_edges(faces, len(vertices))
    half = links.face_edges.ravel()
    order = np.argsort(half, kind="stable")
    counts = links.counts[half[order]]
    pairs = [order[counts == 2].reshape(-1, 2)]
    crowd = order[counts > 2]
    for group in np.split(crowd, np.flatnonzero(np.diff(half[crowd])) + 1) if crowd.size else ():
        pairs.append(_flattest_pairs(vertices, faces, links, group))
    return np.concatenate(pairs), bool(crowd.size)


def _flattest_pairs(vertices: Array, faces: Index, links: HalfEdges, group: Index) -> Index:
    """Pairs among the half-edges ``group`` of one edge: those wound alike first, the flattest of them first."""
    start, end = vertices[links.edges[links.face_edges.ravel()[group[0]]]]
    tangent = (end - start) / np.linalg.norm(end - start)
    aside = vertices[faces[group // 3, (group + 2) % 3]] - start
    aside -= np.outer(aside @ tangent, tangent)
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    forward = links.forward.ravel()[group]
    first, second = np.triu_indices(len(group), 1)
    rank = np.lexsort((np.einsum("pi,pi->p", aside[first], aside[second]).round(6), forward[first] == forward[second]))
    free = np.ones(len(group), dtype=np.bool_)
    pairs = []
    for a, b in zip(first[rank], second[rank], strict=True):
        if free[a] and free[b]:
            free[[a, b]] = False
            pairs.append((group[a], group[b]))
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def _fans_apart(vertices: Array, faces: Index, pairs: Index) -> tuple[Array, Index]:
    """Give each fan of faces around a vertex, joined by ``pairs``, its own vertex; the first keeps the number."""
    corners = faces.ravel()
    following = np.arange(len(corners)) + np.tile([1, 1, -2], len(faces))
    a, b = pairs.T
    same = corners[a] == corners[b]
    left = np.concatenate((a, following[a]))
    right = np.concatenate((np.where(same, b, following[b]), np.where(same, following[b], b)))
    fan = connected_parts(np.column_stack((left, right)), len(corners))
    _, first = np.unique(fan, return_index=True)
    owner = corners[first]
    order = np.lexsort((first, owner))
    further = np.zeros(len(first), dtype=np.bool_)
    further[order[1:]] = owner[order[1:]] == owner[order[:-1]]
    number = owner.copy()
    added = np.flatnonzero(further)
    number[added] = len(vertices) + np.arange(len(added))
    return np.vstack((vertices, vertices[owner[added]])), number[fan].reshape(-1, 3)


def _bisect_repeated_edges(vertices: Array, faces: Index) -> tuple[Array, Index, bool]:
    """Give all but the first pair of faces at an edge with more than two a vertex of their own in its middle.

    Each call cuts a face at most once: repeat until no cut is left.
    """
    links = half_edges(faces, len(vertices))
    half = links.face_edges.ravel()
    touched = np.zeros(len(faces), dtype=np.bool_)
    points: list[Array] = []
    halves: list[tuple[int, int, int]] = []
    for edge in np.flatnonzero(links.counts > 2):
        group = np.flatnonzero(half == edge)
        pairs = _flattest_pairs(vertices, faces, links, group)
        single = np.setdiff1d(group, pairs)
        for members in [*pairs[1:], *single[:, None]]:
            if touched[members // 3].any():
                continue
            touched[members // 3] = True
            middle = len(vertices) + len(points)
            points.append(vertices[links.edges[edge]].mean(axis=0))
            for member in members:
                start, end, opposite = faces[member // 3][(member + np.arange(3)) % 3]
                halves += [(start, middle, opposite), (middle, end, opposite)]
    if not points:
        return vertices, faces, False
    kept = np.concatenate((faces[~touched], np.array(halves, dtype=np.int64)))
    return np.vstack((vertices, points)), kept, True
