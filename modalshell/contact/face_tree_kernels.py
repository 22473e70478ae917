"""Compiled: a tree of boxes of a mesh's triangles, and the pairs of its parts that may come near each other."""

import math

import numpy as np

from modalshell.contact.pair_kernels import nearest, relative
from modalshell.kernels.compiler import njit

_kernel = njit(error_model="numpy", fastmath=False)


@_kernel
def split(centres, order, begin, end):  # type: ignore[no-untyped-def]
    """Order triangles so that each node's lie together: its children hold the halves along its longest side.

    Node k has the triangles ``order[begin[k] : end[k]]``, and the children ``2 k + 1`` and ``2 k + 2``.
    """
    order[:] = np.arange(order.size)
    begin[:], end[:] = 0, 0
    end[0] = order.size
    for node in range(begin.size // 2):
        first, last = begin[node], end[node]
        if last - first < 2:
            continue
        own = order[first:last].copy()
        axis, longest = 0, -1.0
        for a in range(3):
            along = centres[own, a]
            if along.max() - along.min() > longest:
                axis, longest = a, along.max() - along.min()
        order[first:last] = own[np.argsort(centres[own, axis], kind="mergesort")]
        middle = (first + last) // 2
        begin[2 * node + 1], end[2 * node + 1] = first, middle
        begin[2 * node + 2], end[2 * node + 2] = middle, last


@_kernel
def _apart(first, second):  # type: ignore[no-untyped-def]
    """Whether two boxes (6,) are apart along an axis."""
    return (
        first[0] > second[3] or second[0] > first[3]
        or first[1] > second[4] or second[1] > first[4]
        or first[2] > second[5] or second[2] > first[5]
    )  # fmt: skip


@_kernel
def _surround(x, moved, vertices, margin, box):  # type: ignore[no-untyped-def]
    """Write the box (6,), with a margin, around some vertices on the straight way from x to ``moved``, both (n, 3)."""
    for axis in range(3):
        low, high = np.inf, -np.inf
        for v in vertices:
            low, high = min(low, x[v, axis], moved[v, axis]), max(high, x[v, axis], moved[v, axis])
        box[axis], box[3 + axis] = low - margin, high + margin


@_kernel
def refit(faces, order, begin, end, x, moved, margin, boxes):  # type: ignore[no-untyped-def]
    """Boxes (nodes, 6), with a margin, around triangles on the straight way from x to ``moved``, both (n, 3)."""
    for node in range(begin.size - 1, -1, -1):
        count = end[node] - begin[node]
        if count == 0:
            continue
        if count > 1:
            for axis in range(3):
                boxes[node, axis] = min(boxes[2 * node + 1, axis], boxes[2 * node + 2, axis])
                boxes[node, 3 + axis] = max(boxes[2 * node + 1, 3 + axis], boxes[2 * node + 2, 3 + axis])
            continue
        _surround(x, moved, faces[order[begin[node]]], margin, boxes[node])


@_kernel
def _near(x, moved, gap, pair, faced, room):  # type: ignore[no-untyped-def]
    """Whether a pair may come nearer than a gap on the straight way: it loses distance no faster than it moves."""
    weights, directions, way, move = room
    before = math.sqrt(nearest(x, pair, faced, weights, directions, way)[1])
    if before < gap:
        return True
    lost = relative(x, moved, pair, faced, move)
    if before - lost >= gap:
        return False
    after = math.sqrt(nearest(moved, pair, faced, weights, directions, way)[1])
    return before + after - lost < 2.0 * gap


@_kernel
def _pair_vertices(f, g, far, faces, owner, ways, room, found, count):  # type: ignore[no-untyped-def]
    """Pair the vertices of triangle f with the triangle g, which has the box ``far``; how many pairs there are then."""
    x, moved, gap = ways
    pair, box = room[4], room[5]
    pair[1:] = faces[g]
    for v in faces[f]:
        pair[0] = v
        if owner[v] != f or v == pair[1] or v == pair[2] or v == pair[3]:
            continue
        _surround(x, moved, pair[:1], 0.5 * gap, box)
        if not _apart(box, far) and _near(x, moved, gap, pair, True, room[:4]):
            if count < len(found):
                found[count] = pair
            count += 1
    return count


@_kernel
def _pair_edges(f, g, far, sides, edges, owner, ways, room, found, count):  # type: ignore[no-untyped-def]
    """Pair the edges of triangle f with those of g, which has the box ``far``; how many pairs there are then."""
    x, moved, gap = ways
    pair, box, other = room[4], room[5], room[6]
    for first in sides[f]:
        if owner[first] != f:
            continue
        _surround(x, moved, edges[first], 0.5 * gap, box)
        if _apart(box, far):
            continue
        pair[0], pair[1] = edges[first]
        for second in sides[g]:
            pair[2], pair[3] = edges[second]
            meet = pair[0] == pair[2] or pair[0] == pair[3] or pair[1] == pair[2] or pair[1] == pair[3]
            if meet or owner[second] != g:
                continue
            _surround(x, moved, pair[2:], 0.5 * gap, other)
            if not _apart(box, other) and _near(x, moved, gap, pair, False, room[:4]):
                if count < len(found):
                    found[count, 0], found[count, 1] = first, second
                count += 1
    return count


@_kernel
def search(  # type: ignore[no-untyped-def]
    faces, edges, sides, owners, tree, x, moved, gap, facing, crossing
):
    """Pairs that share no vertex and may come nearer than ``gap`` [m] on the straight way from x to ``moved`` (n, 3).

    Of every two triangles near each other, ``sides`` (f, 3) naming their edges, the vertices and edges that are theirs
    by the ``owners`` (n,), (e,), are paired. They are written into ``facing`` (p, 4) by their vertices and ``crossing``
    (q, 2) by their edges, as far as there is room. Returns how many there are of each.
    """
    order, begin, end, boxes = tree
    vertex_face, edge_face = owners
    stack = np.empty((4 * begin.size + 64, 2), np.int64)
    stack[0] = 0
    depth, faced, crossed = 1, 0, 0
    closest = np.empty(4), np.empty((2, 4)), np.empty(3), np.empty((4, 3))
    room, ways = (*closest, np.empty(4, np.int64), np.empty(6), np.empty(6)), (x, moved, gap)
    while depth > 0:
        depth -= 1
        a, b = stack[depth]
        alone, beside = end[a] - begin[a], end[b] - begin[b]
        if a == b:
            if alone > 1:
                for first, second in ((2 * a + 1, 2 * a + 1), (2 * a + 2, 2 * a + 2), (2 * a + 1, 2 * a + 2)):
                    stack[depth, 0], stack[depth, 1] = first, second
                    depth += 1
            continue
        if _apart(boxes[a], boxes[b]):
            continue
        if alone > 1 or beside > 1:
            if alone < beside:
                a, b = b, a
            for child in range(2 * a + 1, 2 * a + 3):
                stack[depth, 0], stack[depth, 1] = child, b
                depth += 1
            continue
        f, g = order[begin[a]], order[begin[b]]
        faced = _pair_vertices(f, g, boxes[b], faces, vertex_face, ways, room, facing, faced)
        faced = _pair_vertices(g, f, boxes[a], faces, vertex_face, ways, room, facing, faced)
        crossed = _pair_edges(f, g, boxes[b], sides, edges, edge_face, ways, room, crossing, crossed)
    return faced, crossed
