"""Joints: edges at which no two triangles continue each other.

Three triangles or more meet at a junction. At a seam two do, both of which run along it the same way: a one-sided
surface, such as a Moebius strip, has one somewhere, wherever its winding is turned.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from modalshell.core.errors import SPLIT, MeshError
from modalshell.core.typing import Array, Index
from modalshell.mesh.topology import HalfEdges

_COINCIDENT = 1e-6
"""Angle [rad] between two wings of a junction below which they are one and the same sheet."""


class Joints(NamedTuple):
    """Edges with any number of triangles, which are their wings."""

    edges: Index
    """The edges, ascending; shape (J,)."""
    starts: Index
    """First of each edge's wings in the list of them all; shape (J + 1,)."""
    wings: Index
    """Half-edges ``3 * face + corner`` of the wings, edge by edge: the triangle runs along the edge from this corner to
    the next. The first wing of each edge is that to which its hinges refer: one of the two that lie flattest. Shape
    (W,)."""

    @property
    def hinge_wings(self) -> tuple[Index, Index]:
        """Half-edges (K,) of each hinge: the first wing of its edge, and one of the others."""
        first = np.zeros(len(self.wings), dtype=np.bool_)
        first[self.starts[:-1]] = True
        counts = np.diff(self.starts) - 1
        return np.repeat(self.wings[self.starts[:-1]], counts), self.wings[~first]

    @property
    def hinge_edges(self) -> Index:
        """Edge of each hinge (K,)."""
        return np.repeat(self.edges, np.diff(self.starts) - 1)


def joints_of(vertices: Array, faces: Index, links: HalfEdges) -> Joints:
    """Joints of a triangle list; MeshError where two wings of a junction coincide."""
    half = links.face_edges.ravel()
    forward = np.bincount(half[links.forward.ravel()], minlength=len(links.edges))
    odd = (links.counts > 2) | ((links.counts == 2) & (forward != 1))
    edges = np.flatnonzero(odd)
    members = np.flatnonzero(odd[half]) if edges.size else edges
    wings = members[np.argsort(half[members], kind="stable")]
    counts = links.counts[edges]
    starts = np.concatenate([[0], np.cumsum(counts)])
    for count in np.unique(counts):
        rows = starts[:-1][counts == count][:, None] + np.arange(count)
        wings[rows] = _flattest_first(vertices, faces, wings[rows])
    return Joints(edges, starts, wings)


def hinges_of_joints(faces: Index, joints: Joints) -> Index:
    """Hinges [x0, x1, x2, x3] (K, 4) between the first wing and each of the others.

    The face (x1, x0, x3) is that other wing in its own winding; x2 is the first wing's vertex, whose face may run
    either way.
    """
    first, other = joints.hinge_wings
    corners = faces.ravel()
    return np.column_stack(
        [corners[_turned(other, 1)], corners[other], *(corners[_turned(h, 2)] for h in (first, other))]
    )


def _turned(half: Index, steps: int) -> Index:
    """Half-edges of the same faces, ``steps`` corners on."""
    return 3 * (half // 3) + (half + steps) % 3


def _flattest_first(vertices: Array, faces: Index, wings: Index) -> Index:
    """Wings (J, k) of edges in order, but the two that lie flattest first; MeshError where two coincide."""
    corners = faces.ravel()
    start, end, apex = (vertices[corners[_turned(wings, steps)]] for steps in range(3))
    tangent = (end - start) / np.linalg.norm(end - start, axis=2, keepdims=True)
    aside = apex - start
    aside = aside - np.sum(aside * tangent, axis=2, keepdims=True) * tangent
    aside = aside / np.linalg.norm(aside, axis=2, keepdims=True)
    count = wings.shape[1]
    first, second = np.triu_indices(count, 1)
    if count > 2:
        same = np.linalg.norm(aside[:, first] - aside[:, second], axis=2) < _COINCIDENT
        if same.any():
            _refuse_coincident(faces, wings, same, first, second)
    flattest = np.argmin(np.sum(aside[:, first] * aside[:, second], axis=2).round(6), axis=1)
    rank = np.broadcast_to(np.arange(count), wings.shape).copy()
    rows = np.arange(len(wings))
    rank[rows, first[flattest]], rank[rows, second[flattest]] = -2, -1
    return np.take_along_axis(wings, np.argsort(rank, axis=1), axis=1)


def _refuse_coincident(faces: Index, wings: Index, same: np.ndarray, first: Index, second: Index) -> None:
    edge, pair = np.argwhere(same)[0]
    half = wings[edge, [first[pair], second[pair]]]
    ends = sorted(faces.ravel()[[half[0], _turned(half[:1], 1)[0]]].tolist())
    raise MeshError(
        f"faces {half[0] // 3} and {half[1] // 3} (counted from 0) lie on each other at edge ({ends[0]}, {ends[1]}), "
        f"where {wings.shape[1]} faces meet: the sheets of a junction leave it in different directions; remove one of "
        f"these faces, or cut the sheets apart there, after which they no longer hold each other, by {SPLIT} of repair"
    )
