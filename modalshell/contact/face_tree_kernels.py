"""Compiled: a tree of boxes of a mesh's triangles, and the pairs of its parts that may come near each other."""

import math

import numpy as np

from modalshell.contact.pair_kernels import nearest, relative
from modalshell.kernels.compiler import njit

_kernel = njit(error_model="numpy", fastmath=False)
_inline = njit(error_model="numpy", fastmath=False, forceinline=True)
_FACED, _CROSSED = np.bool_(True), np.bool_(False)
"""Whether a pair is of a vertex and a triangle, or of two edges: of True and False that are written out where a kernel
is called numba compiles this once for each."""


@_inline
def _apart(first, a, second, b):  # type: ignore[no-untyped-def]
    """Whether box a of some (k, 6), and box b of others, are apart along an axis."""
    return (
        first[a, 0] > second[b, 3] or second[b, 0] > first[a, 3]
        or first[a, 1] > second[b, 4] or second[b, 1] > first[a, 4]
        or first[a, 2] > second[b, 5] or second[b, 2] > first[a, 5]
    )  # fmt: skip


@_kernel
def surround(x, moved, parts, margin, boxes):  # type: ignore[no-untyped-def]
    """Boxes (p, 6), with a margin, around vertices ``parts`` (p, k) on the straight way from x to ``moved``, (n, 3)."""
    for p in range(len(parts)):
        for axis in range(3):
            low, high = np.inf, -np.inf
            for i in range(parts.shape[1]):
                v = parts[p, i]
                low, high = min(low, x[v, axis], moved[v, axis]), max(high, x[v, axis], moved[v, axis])
            boxes[p, axis], boxes[p, 3 + axis] = low - margin, high + margin


@_kernel
def refit(order, begin, end, around, boxes):  # type: ignore[no-untyped-def]
    """Boxes (nodes, 6) of the tree by those ``around`` (f, 6) its triangles."""
    for node in range(begin.size - 1, -1, -1):
        count = end[node] - begin[node]
        if count == 1:
            # By numbers: to write a row at once takes numba seconds to compile, for the message alone.
            for axis in range(6):
                boxes[node, axis] = around[order[begin[node]], axis]
        elif count > 1:
            for axis in range(3):
                boxes[node, axis] = min(boxes[2 * node + 1, axis], boxes[2 * node + 2, axis])
                boxes[node, 3 + axis] = max(boxes[2 * node + 1, 3 + axis], boxes[2 * node + 2, 3 + axis])


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


@_inline
def _pair_vertices(f, g, faces, owner, boxes, ways, room, found, count):  # type: ignore[no-untyped-def]
    """Pair the vertices of triangle f with the triangle g; how many pairs there are then."""
    x, moved, gap = ways
    pair = room[4]
    for i in range(3):
        v = faces[f, i]
        shared = v == faces[g, 0] or v == faces[g, 1] or v == faces[g, 2]
        if shared or owner[v] != f or _apart(boxes[0], v, boxes[2], g):
            continue
        pair[0], pair[1], pair[2], pair[3] = v, faces[g, 0], faces[g, 1], faces[g, 2]
        if _near(x, moved, gap, pair, _FACED, room[:4]):
            if count < len(found):
                for k in range(4):
                    found[count, k] = pair[k]
            count += 1
    return count


@_inline
def _pair_edges(f, g, sides, edges, owner, boxes, ways, room, found, count):  # type: ignore[no-untyped-def]
    """Pair the edges of triangle f with those of g; how many pairs there are then."""
    x, moved, gap = ways
    pair = room[4]
    for i in range(3):
        first = sides[f, i]
        if owner[first] != f or _apart(boxes[1], first, boxes[2], g):
            continue
        pair[0], pair[1] = edges[first, 0], edges[first, 1]
        for j in range(3):
            second = sides[g, j]
            if owner[second] != g or _apart(boxes[1], first, boxes[1], second):
                continue
            pair[2], pair[3] = edges[second, 0], edges[second, 1]
            if pair[0] == pair[2] or pair[0] == pair[3] or pair[1] == pair[2] or pair[1] == pair[3]:
                continue
            if _near(x, moved, gap, pair, _CROSSED, room[:4]):
                if count < len(found):
                    found[count, 0], found[count, 1] = first, second
                count += 1
    return count


@_kernel
def search(  # type: ignore[no-untyped-def]
    faces, edges, sides, owners, tree, around, x, moved, gap, facing, crossing
):
    """Pairs that share no vertex and may come nearer than ``gap`` [m] on the straight way from x to ``moved`` (n, 3).

    ``sides`` (f, 3) name the edges of triangles, and ``around`` has the boxes of vertices, edges and triangles. Of
    every two triangles near each other, the vertices and edges that are theirs by the ``owners`` (n,), (e,), are
    paired. They are written into ``facing`` (p, 4) by their vertices and ``crossing`` (q, 2) by their edges, as far as
    there is room. Returns how many there are of each.
    """
    order, begin, end, boxes = tree
    vertex_face, edge_face = owners
    stack = np.empty((4 * begin.size + 64, 2), np.int64)
    stack[0, 0] = stack[0, 1] = 0
    # Typed counts: what takes them is compiled for plain numbers alone, and not for the first zeros too.
    depth, faced, crossed = 1, np.int64(0), np.int64(0)
    closest = np.empty(4), np.empty((2, 4)), np.empty(3), np.empty((4, 3))
    room, ways = (*closest, np.empty(4, np.int64)), (x, moved, gap)
    while depth > 0:
        depth -= 1
        a, b = stack[depth, 0], stack[depth, 1]
        alone, beside = end[a] - begin[a], end[b] - begin[b]
        if a == b:
            if alone > 1:
                for first, second in ((2 * a + 1, 2 * a + 1), (2 * a + 2, 2 * a + 2), (2 * a + 1, 2 * a + 2)):
                    stack[depth, 0], stack[depth, 1] = first, second
                    depth += 1
            continue
        if _apart(boxes, a, boxes, b):
            continue
        if alone > 1 or beside > 1:
            if alone < beside:
                a, b = b, a
            for child in range(2 * a + 1, 2 * a + 3):
                stack[depth, 0], stack[depth, 1] = child, b
                depth += 1
            continue
        f, g = order[begin[a]], order[begin[b]]
        faced = _pair_vertices(f, g, faces, vertex_face, around, ways, room, facing, faced)
        faced = _pair_vertices(g, f, faces, vertex_face, around, ways, room, facing, faced)
        crossed = _pair_edges(f, g, sides, edges, edge_face, around, ways, room, crossing, crossed)
    return faced, crossed
