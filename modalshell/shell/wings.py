r"""Wings of joints in the split-fold energy: one fold share for an edge with any number of triangles.

The share f of a joint is the turn of the joint about its edge. With :math:`\delta_w` the angle from the first wing to
wing w about the edge, less that at rest, each wing folds by

.. math:: \gamma_w = s_w (\delta_w - f), \qquad \delta_1 = 0,

:math:`s_w = 1` if the triangle runs along the edge as the hinge does and -1 if against it. That the energy is least for
f is the moment balance of a rigid joint that is free to turn, :math:`\sum_w s_w m_w = 0`. Two triangles are the case
k = 2; a seam of a one-sided strip is one with both signs alike (theory 15, eq. 1).

A hinge of the mesh runs along its edge as its second wing requires, so that :math:`s_w \delta_w` is its fold angle as
it is. Where a wing is held the joint cannot turn: every other wing folds against that one.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple, final

import numpy as np

from modalshell.core.typing import Array, Index, Mask
from modalshell.mesh import TriangleMesh
from modalshell.shell.slopes import HeldSlopes


@final
class Wings(NamedTuple):
    """Hinges of a shell at every edge, and what the joints' wings are."""

    hinges: Index
    """Hinges of the mesh, and further ones between a held wing and the others; shape (H + x, 4)."""
    rest: Index
    """Hinges of the mesh whose angles less each other are those of the further ones; -1 for none. Shape (x, 2)."""
    rest_signs: Array
    """Their signs; shape (x, 2)."""
    of_corners: Index
    """Hinge that belongs to the edge from each corner to the next; -1 at the boundary and of the first wing of a joint.
    Shape (T, 3)."""
    joined: Mask
    """Whether that edge is a joint; shape (T, 3)."""
    held: Mask
    """Whether a wing of that joint is held; shape (T, 3)."""
    forward: Mask
    """Whether the triangle runs along that joint from its smaller to its larger vertex; shape (T, 3)."""
    flat: Mask
    """Whether the triangle lies in the plane of symmetry that holds that edge; shape (T, 3)."""


def wings_of(mesh: TriangleMesh, held: Mask, slopes: HeldSlopes) -> Wings:
    """Wings of a mesh with ``held`` triangles (T,)."""
    number = np.full(len(mesh.edges), -1)
    number[mesh.hinge_edges] = np.arange(len(mesh.hinges))
    of_corners = number[mesh.face_edges]
    none = np.zeros(of_corners.shape, dtype=bool)
    flat = _in_plane(mesh, slopes)
    edges, starts, wings = mesh.joints
    if not edges.size:
        nothing = np.empty((0, 2))
        return Wings(mesh.hinges, nothing.astype(np.int64), nothing, of_corners, none, none, none, flat)
    of_corners, joined, stuck, forward = (array.ravel() for array in (of_corners, *(none.copy() for _ in range(3))))
    first, other = mesh.joints.hinge_wings
    of_corners[first] = -1
    of_corners[other] = np.flatnonzero(np.isin(mesh.hinge_edges, edges))
    corners = mesh.faces.ravel()
    start, end, apex = (corners[3 * (wings // 3) + (wings + steps) % 3] for steps in range(3))
    joined[wings] = True
    forward[wings] = start < end
    further, rest, signs = [], [], []
    for a, b in pairwise(starts.tolist()):
        own = wings[a:b]
        fixed = np.flatnonzero(held[own // 3])
        if not fixed.size:
            continue
        stuck[own] = True
        if fixed[0] == 0:
            continue
        h = a + fixed[0]
        for w in np.flatnonzero(~held[own // 3]) + a:
            further.append([end[w], start[w], apex[h], apex[w]])
            rest.append([of_corners[wings[w]], of_corners[wings[h]]])
            signs.append([1.0, -1.0 if forward[wings[w]] == forward[wings[h]] else 1.0])
            of_corners[wings[w]] = len(mesh.hinges) + len(further) - 1
    hinges = np.vstack([mesh.hinges, np.array(further, dtype=np.int64).reshape(-1, 4)])
    shaped: list[Any] = [array.reshape(-1, 3) for array in (of_corners, joined, stuck, forward, flat)]
    return Wings(hinges, np.array(rest, dtype=np.int64).reshape(-1, 2), np.array(signs).reshape(-1, 2), *shaped)


def _in_plane(mesh: TriangleMesh, slopes: HeldSlopes) -> Mask:
    """Which triangles lie in the planes of symmetry that hold their edges (T, 3), from each corner to the next."""
    flat = np.zeros(mesh.faces.shape, dtype=bool)
    plane = np.full(len(mesh.edges), -1)
    plane[slopes.mirrored] = np.arange(slopes.mirrored.size)
    face, corner = np.nonzero(plane[mesh.face_edges] >= 0)
    edge = mesh.face_edges[face, corner]
    start, apex = (mesh.vertices[mesh.faces[face, (corner + steps) % 3]] for steps in (0, 2))
    away = np.abs(np.sum((apex - start) * slopes.normals[plane[edge]], axis=1))
    flat[face, corner] = away <= 1e-6 * mesh.edge_lengths[edge]
    return flat
