"""Pairs of a mesh's vertices, edges and triangles that are near each other, looked for again only after a move."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np

from modalshell.contact import face_tree_kernels, pair_kernels, pair_move_kernels
from modalshell.core.thread_safety import writeable
from modalshell.core.typing import Array, Index

_PARALLEL = 1e-3
"""Square of the sine at rest of the angle of two edges below which their barrier is mollified [li2020]."""
_ROOM = 4096
"""Pairs for which there is room at first."""


class Barrier(NamedTuple):
    """The barrier at one place, over its stiffness."""

    energy: float
    """Its energy, over the stiffness [m^3]."""
    gradient: Array
    """The derivatives [m^2]; shape (n, 3)."""
    least: float
    """Least distance [m] of pairs nearer than the gap; infinite without one."""
    active: Index
    """Those pairs; shape (a,)."""
    pairs: Index
    faced: int
    areas: Array
    limits: Array
    """Of all pairs: see :class:`NearPairs`."""


@final
@dataclass(frozen=True)
class Rubbing:
    """Friction of pairs by their forces at one place, smoothed [li2020]."""

    begin: Array
    """That place [m]; shape (n, 3)."""
    pairs: Index
    """Their vertices; shape (a, 4)."""
    weights: Array
    normals: Array
    """Weights of these at the nearest points, and unit normals there; shape (a, 4), (a, 3)."""
    strengths: Array
    """Coulomb's coefficients times the forces [N]; shape (a,)."""

    def energy_gradient(self, x: Array, limit: float) -> tuple[float, Array]:
        """Energy [J] and its gradient (n, 3) [N] at x (n, 3), fully smoothed up to slips of ``limit`` [m]."""
        gradient = np.zeros_like(x)
        energy = pair_move_kernels.slid(
            x, self.begin, self.pairs, self.weights, self.normals, self.strengths, limit, gradient
        )
        return float(energy), gradient

    def add_hessian(self, x: Array, limit: float, slots: Index, strides: Index, data: Array) -> None:
        """Add its second derivatives to a pattern's entries; see :meth:`.Layers.add_hessian`."""
        own = self.pairs, self.weights, self.normals, self.strengths
        pair_move_kernels.add_sliding(x, self.begin, *own, limit, slots, strides, data)


def _tree(centres: Array, count: int) -> tuple[Index, Index, Index]:
    """An order of triangles with ``centres`` (f, 3) in which those of each of ``count`` nodes lie together.

    Node k has the triangles ``order[begin[k] : end[k]]``, and the children ``2 k + 1`` and ``2 k + 2``: the halves
    along its longest side. Returns the order (f,), and begin and end of the nodes.
    """
    order, begin, end = np.arange(len(centres)), np.zeros(count, np.int64), np.zeros(count, np.int64)
    nodes, end[0] = np.zeros(1, np.int64), len(centres)
    while (nodes := nodes[end[nodes] - begin[nodes] > 1]).size:  # all of a level at once
        sizes = end[nodes] - begin[nodes]
        starts, own = np.cumsum(sizes) - sizes, np.repeat(np.arange(nodes.size), sizes)
        places = np.arange(own.size) + (begin[nodes] - starts)[own]
        along = centres[order[places]]
        longest = np.argmax(np.maximum.reduceat(along, starts) - np.minimum.reduceat(along, starts), axis=1)
        sorted_within = np.lexsort((along[np.arange(own.size), longest[own]], own))
        order[places] = order[places][sorted_within]
        middle, children = (begin[nodes] + end[nodes]) // 2, np.stack([2 * nodes + 1, 2 * nodes + 2])
        begin[children], end[children] = [begin[nodes], middle], [middle, end[nodes]]
        nodes = children.ravel()
    return order, begin, end


@final
class NearPairs:
    """The pairs of some triangles, their edges and vertices, that may come nearer than a gap about a straight way.

    ``faces`` (f, 3) are the triangles, ``gap`` is in [m]. Areas and lengths are those at positions ``rest`` (n, 3)
    [m]; positions may be off the way by a ``margin`` [m]. ``faced`` is how many pairs are of a vertex and a triangle.

    Attributes
    ----------
    edges : ndarray of int, shape (e, 2)
        Edges of the triangles.
    pairs : ndarray of int, shape (p, 4)
        Vertices of the pairs, the first ``faced`` of a vertex and a triangle, the others of two edges.
    areas : ndarray, shape (p,)
        Area [m^2] that each stands for: a quarter of that of the vertex, or of the edges.
    limits : ndarray, shape (p,)
        Square [m^4] of the cross product of two edges below which they are nearly parallel.
    """

    def __init__(self, faces: Index, rest: Array, gap: float, margin: float) -> None:
        self._faces, self._reach, self._margin = np.ascontiguousarray(faces), gap + 2.0 * margin, margin
        sides = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        self.edges, first, number = np.unique(sides, axis=0, return_index=True, return_inverse=True)
        self._sides = number.reshape(-1, 3)
        vertex_face = np.full(len(rest), -1)
        vertex_face[faces[::-1].ravel()] = np.repeat(np.arange(len(faces))[::-1], 3)
        self._owners = vertex_face, first // 3
        corners = rest[faces]
        thirds = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 6.0
        self._vertex_areas = np.bincount(faces.ravel(), np.repeat(thirds, 3), len(rest))
        self._edge_areas = np.bincount(self._sides.ravel(), np.repeat(thirds, 3))
        self._squares = np.sum(np.diff(rest[self.edges], axis=1)[:, 0] ** 2, axis=1)
        count = 1 << int(np.ceil(np.log2(max(len(faces), 2))) + 1)
        self._tree = _tree(corners.mean(axis=1), count)
        self._boxes, self._room = np.empty((count, 6)), (_ROOM, _ROOM)
        self._parts = np.arange(len(rest))[:, None], self.edges, self._faces
        self._way: tuple[Array, Array] | None = None
        self.pairs, self.faced = np.empty((0, 4), np.int64), 0
        self.areas = self.limits = np.empty(0)

    def about(self, x: Array, moved: Array | None = None) -> None:
        """See that the pairs are all those on the straight way from x to ``moved``, both (n, 3); or at x."""
        moved = x if moved is None else moved
        if self._covers(x) and (moved is x or self._covers(moved)):
            return
        begin = x.copy()  # of one kind, whether x is read-only or not: kernels are compiled for that
        self._way = begin, moved - x
        # Pairs do not change as all vertices move on by the same.
        other = begin if moved is x else moved - (moved - x).mean(axis=0)
        around = tuple(np.empty((len(parts), 6)) for parts in self._parts)
        for parts, boxes in zip(self._parts, around, strict=True):
            face_tree_kernels.surround(begin, other, parts, 0.5 * self._reach, boxes)
        face_tree_kernels.refit(*self._tree, around[2], self._boxes)
        triangles = self._faces, self.edges, self._sides
        while True:
            facing, crossing = np.empty((self._room[0], 4), np.int64), np.empty((self._room[1], 2), np.int64)
            tree = *self._tree, self._boxes
            found = face_tree_kernels.search(
                *triangles, self._owners, tree, around, begin, other, self._reach, facing, crossing
            )
            if found[0] <= self._room[0] and found[1] <= self._room[1]:
                break
            self._room = 3 * found[0] // 2 + _ROOM, 3 * found[1] // 2 + _ROOM
        self.faced = found[0]
        facing, crossing = facing[: found[0]], crossing[: found[1]]
        self.pairs = np.concatenate([facing, self.edges[crossing].reshape(-1, 4)])
        among = self._edge_areas[crossing].sum(axis=1)
        self.areas = 0.25 * np.concatenate([self._vertex_areas[facing[:, 0]], among])
        self.limits = np.concatenate([np.zeros(found[0]), _PARALLEL * self._squares[crossing].prod(axis=1)])

    def barrier(self, x: Array, gap: float) -> Barrier:
        """The barrier of the pairs nearer than a ``gap`` [m], at most that of the search, at x (n, 3)."""
        gradient = np.zeros_like(x)
        if not np.isfinite(x).all():
            return Barrier(np.nan, gradient, np.inf, np.empty(0, np.int64), *self._all)
        x = writeable(x)  # of one kind, as above
        self.about(x)
        active = np.empty(len(self.pairs), np.int64)
        energy, found, least = pair_kernels.energy_gradient(x, *self._all, gap, gradient, active)
        return Barrier(float(energy), gradient, float(np.sqrt(least)), active[:found].copy(), *self._all)

    def rubbing(self, x: Array, gap: float, barrier: Barrier, factor: float) -> Rubbing:
        """Friction of the pairs of a barrier at x (n, 3), by a ``factor`` on its forces over the stiffness."""
        count = barrier.active.size
        weights, normals, forces = np.empty((count, 4)), np.empty((count, 3)), np.empty(count)
        pairs, faced, areas, limits = barrier[4:]
        pair_kernels.rubbing(x, pairs, barrier.active, faced, areas, limits, gap, weights, normals, forces)
        kept = forces > 0.0
        return Rubbing(x.copy(), pairs[barrier.active[kept]], weights[kept], normals[kept], factor * forces[kept])

    @property
    def _all(self) -> tuple[Index, int, Array, Array]:
        return self.pairs, self.faced, self.areas, self.limits

    def _covers(self, x: Array) -> bool:
        """Whether x (n, 3) is near the way whose pairs are known; so is then all between two such places."""
        if self._way is None:
            return False
        begin, way = self._way
        off = x - begin
        off -= min(max(float(np.vdot(off, way)) / (float(np.vdot(way, way)) or 1.0), 0.0), 1.0) * way
        return bool(np.sum(off**2, axis=1).max() <= self._margin**2)
