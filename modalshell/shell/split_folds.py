r"""Bending by split folds: a Kirchhoff plate whose curvatures are the fold angles of the mesh.

Each interior edge e has its fold angle :math:`\delta_e = \theta_e - \theta_{0,e}` and one fold share :math:`f_e`
without mass, which parts the fold between its triangles: :math:`\gamma_{T,e} = \delta_e - f_e` belongs to one,
:math:`\gamma_{T',e} = f_e` to the other. A triangle's curvature is then
:math:`\kappa_T = \sum_k (l_k / A_T) \gamma_{T,k} n_k n_k^T`, and its energy
:math:`\gamma_T^T K_T \gamma_T / 2` with

.. math:: (K_T)_{kl} = \frac{D}{A_T} l_k l_l \left[\nu + (1 - \nu) (n_k \cdot n_l)^2\right] .

The energy is least for the shares at which the bending moment across each edge is continuous ([morley1968]; the
mixed element of [herrmann1967] and [johnson1973]). The shares follow linearly from the fold angles, so the bending
energy is :math:`\delta^T H \delta / 2` with one constant matrix H (theory 4, eq. 3 to 10).

Most triangles bend in pairs, which know how moments vary (:mod:`modalshell.shell.triangle_pairs`): the fold inside a
pair counts in it whole, without a share, and the moment inside it is that across its five edges. Which of two pairs is
the first at an edge between them is free: pairs are coloured so that neighbours differ where possible, and a fold
counts in the pair of one colour. Pairs of the other colour then couple none of their neighbours' vertices, and factors
stay sparse.

Edges: a free edge has no moment, so its fold is condensed out of K_T. At a clamped edge the whole fold belongs to the
one free triangle, against a held triangle or against a ghost vertex: the mirror image of the opposite vertex in the
triangle's rest plane. One held row of vertices therefore clamps. At an edge in a plane of symmetry half of the fold
belongs to the one triangle, against the mirror image of its opposite vertex, which moves with that vertex.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum
from typing import NamedTuple, final

import numpy as np
import scipy.sparse as sps

from modalshell.core.typing import Array, Index, Mask
from modalshell.linalg.elements import assembled
from modalshell.mesh import TriangleMesh
from modalshell.shell.elasticity import Elasticity
from modalshell.shell.kernels.split_folds import colour_triangles
from modalshell.shell.pattern import incidence
from modalshell.shell.slopes import HeldSlopes
from modalshell.shell.triangle_pairs import ALIKE, fold_moments, paired_triangles
from modalshell.shell.wings import Wings, wings_of

_ALONG = np.array([[1, 2, 0, 3], [2, 0, 1, 4], [0, 1, 2, 5], [1, 3, 2, 6], [3, 2, 1, 7]])
"""Vertices of the hinge at each edge among a pair's eight, where the pair's own triangle is left of the edge."""


class EdgeKind(IntEnum):
    """What is across an edge of a triangle that bends, and so how much of its fold counts in the pair."""

    ABSENT = 0  # an edge of the second triangle, where one bends alone
    INNER = 1  # the other triangle of the pair: the whole fold
    SPLIT = 2  # another pair: its part of the fold
    HELD = 3  # a held triangle: the whole fold
    CLAMPED = 4  # a clamp: the whole fold against a ghost vertex
    MIRRORED = 5  # a plane of symmetry: half of the fold against the mirror image
    FREE = 6  # nothing: none


@final
@dataclass(frozen=True)
class SplitFolds:
    """Connectivity and constant matrices of the bending energy."""

    ghosts: Array
    """Positions of the ghost vertices [m]; they follow the n vertices of the mesh in every stencil. Shape (g, 3)."""
    reflections: Array
    """Reflections that make the last s ghosts, and the last s hinges, of the vertices across their edges; shape
    (s, 3, 3)."""
    hinges: Index
    """Hinges that carry energy, in the order of the flexure kernel; shape (H, 4)."""
    faces: Index
    """Triangles of every pair; -1 after one that bends alone. Shape (B, 2)."""
    corners: Index
    """Their corners opposite the common edge; of single triangles the first. Shape (B, 2)."""
    stencils: Index
    """Corners of the first triangle, the vertex across the common edge, and those across the edges of the other hinges;
    else -1. Shape (B, 8)."""
    folds: Index
    """Hinge at each edge, whose fold angle counts in this pair; -1 where none does. Shape (B, 5)."""
    places: Index
    """Positions of each hinge's vertices among the pair's eight; shape (B, 5, 4)."""
    shares: Array
    """Factors of the fold share in gamma; shape (B, 5)."""
    share_index: Index
    """Fold share at each edge; -1 if there is none. Shape (B, 5)."""
    moments: Array
    """Stiffness by gamma, free edges condensed [N m]; shape (B, 5, 5)."""
    share_count: int
    """Number of fold shares."""
    sources: sps.csr_array
    """Angles of the mesh's hinges that make those of these hinges; none for ghosts. Shape (H of the mesh, H)."""

    def matrices(self) -> tuple[sps.csr_array, sps.csr_array, sps.csr_array]:
        """Second derivatives of the bending energy: by fold angles (H, H), by shares and angles (m, H), by shares."""
        folds, shares, factors = len(self.hinges), self.share_count, self.shares
        return (
            assembled(self.moments, self.folds, self.folds, (folds, folds)),
            assembled(self.moments, self.share_index, self.folds, (shares, folds), factors),
            assembled(self.moments, self.share_index, self.share_index, (shares, shares), factors, factors),
        )

    def parts_of_folds(self, angles: Array, shares: Array) -> Array:
        """Gamma (B, 5) of fold angles (H,) and fold shares (m,): the part of each fold that every pair has."""
        return np.append(angles, 0.0)[self.folds] + self.shares * np.append(shares, 0.0)[self.share_index]

    def of_hinges(self, values: Array) -> Array:
        """Values (H,) of folds at the hinges of the mesh; zero at those between held triangles."""
        return np.asarray(self.sources @ values)

    def coupled_vertices(self, count: int) -> sps.csr_array:
        """Vertices below ``count`` that each share is coupled to, a pattern (m, count)."""
        coupled = incidence(self.share_index, self.share_count).T.tocsr() @ incidence(self.stencils, count)
        coupled.sort_indices()
        return sps.csr_array(coupled)

    def part(self, chosen: Index, factors: Array, vertices: Index, count: int) -> tuple[SplitFolds, Index, Index]:
        """Chosen pairs times factors, on a numbering of the sorted ``vertices`` out of ``count``.

        Ghosts follow these again. Also the hinges and the shares that the part has.
        """
        folds, share_index, stencils = self.folds[chosen], self.share_index[chosen], self.stencils[chosen]
        hinges, shares = (np.unique(numbers[numbers >= 0]) for numbers in (folds, share_index))

        def local(numbers: Index) -> Index:
            real = np.searchsorted(vertices, numbers)
            return np.ascontiguousarray(np.where(numbers < count, real, numbers - count + vertices.size))

        mirrored = hinges - (len(self.hinges) - len(self.reflections))
        part = replace(
            self,
            reflections=self.reflections[mirrored[mirrored >= 0]],
            hinges=local(self.hinges[hinges]),
            faces=self.faces[chosen],
            corners=self.corners[chosen],
            stencils=np.where(stencils >= 0, local(stencils), -1),
            folds=np.where(folds >= 0, np.searchsorted(hinges, folds), -1),
            places=self.places[chosen],
            shares=self.shares[chosen],
            share_index=np.where(share_index >= 0, np.searchsorted(shares, share_index), -1),
            moments=self.moments[chosen] * factors[:, None, None],
            share_count=int(shares.size),
        )
        return part, hinges, shares


class _Pairs(NamedTuple):
    """Pairs of triangles and their edges: the common one and the two after it of either triangle.

    Faces and corners (B, 2) are those of :class:`SplitFolds`. Each edge (B, 5) of the mesh has its :class:`EdgeKind`,
    the pair's own triangle on its ``left`` or not, and across split ones there is the pair ``neighbours``, else -1.
    ``hinges`` are numbers of those of ``wings``, -1 for none. At joints the pair is ``forward`` or not, and has no one
    neighbour.
    """

    faces: Index
    corners: Index
    edges: Index
    kinds: Index
    left: Mask
    neighbours: Index
    hinges: Index
    joined: Mask
    forward: Mask
    wings: Wings


def split_folds(
    mesh: TriangleMesh,
    rigidity: Array,
    poisson: Array,
    slopes: HeldSlopes,
    held_vertices: Mask,
    scale: float,
    *,
    halved: bool = False,
    bending: Elasticity | None = None,
) -> SplitFolds:
    """Split folds of a mesh.

    Parameters
    ----------
    mesh : TriangleMesh
        Rest shape.
    rigidity, poisson : ndarray, shape (T,)
        Bending stiffness D [N m] and Poisson's ratio of every triangle.
    slopes : HeldSlopes
        Clamped and mirrored edges.
    held_vertices : ndarray of bool, shape (n,)
        All held vertices; triangles of them do not bend, but for those at corners of edges that are free to turn.
    scale : float
        Diagonal entry that the shares' stiffness is scaled to [N/m], near those of the positions.
    halved : bool
        Whether each fold counts by half in both of its pairs, and the shares are what one has more and the other less
        than that. The energy is the same, but every pair couples all the vertices around it.
    bending : Elasticity, optional
        That of a sheet that is not isotropic; its means over directions are ``rigidity`` and ``poisson``.
    """
    alike = np.ones(len(mesh.edges), dtype=bool) if bending is None else bending.alike(mesh, ALIKE - 1.0)
    pairs = _bending_pairs(mesh, rigidity, poisson, slopes, held_vertices, alike)
    split, takes_fold = pairs.kinds == EdgeKind.SPLIT, _takes_fold(pairs)
    folded = np.isin(pairs.kinds, (EdgeKind.INNER, EdgeKind.SPLIT, EdgeKind.HELD)) & (pairs.hinges >= 0)
    inner, folds = _numbered(pairs.hinges, folded)
    halves = split & ~pairs.joined if halved else np.zeros_like(split)
    folds[split & ~takes_fold & ~halves] = -1
    row, k = np.hstack([np.nonzero(pairs.kinds == kind) for kind in (EdgeKind.CLAMPED, EdgeKind.MIRRORED)])
    folds[row, k] = inner.size + np.arange(row.size)
    stencils = _corners(mesh, pairs)
    start, end, apex = stencils[row[:, None], _ALONG[k, :3]].T
    ghost_index = len(mesh.vertices) + np.arange(row.size)
    hinges = np.vstack([pairs.wings.hinges[inner], np.column_stack([start, end, apex, ghost_index])])

    # A triangle on the right runs against its edge, and is the second of the hinge's triangles.
    left = pairs.left.copy()
    left[row, k] = True
    places = np.where(left[:, :, None], _ALONG, _ALONG[:, [1, 0, 3, 2]])
    at = np.nonzero(folds >= 0)
    stencils[at[0], _ALONG[at[1], 3]] = hinges[folds[at], np.where(left[at], 3, 2)]

    moments = fold_moments(mesh, pairs.faces, pairs.corners, rigidity, poisson, pairs.kinds == EdgeKind.FREE, bending)
    shared, share_index = _numbered(pairs.edges, split)
    gains = np.where(pairs.joined, pairs.forward, pairs.left if halved else ~takes_fold)
    shares = _share_factors(share_index, gains, moments, scale)
    if halved:
        weight = np.where(halves, 0.5, 1.0)
        shares /= weight
        moments = weight[:, :, None] * moments * weight[:, None, :]
    mirrored = pairs.edges[pairs.kinds == EdgeKind.MIRRORED]
    return SplitFolds(
        ghosts=mirror_images(mesh.vertices, start, end, apex),
        reflections=slopes.reflections()[np.searchsorted(slopes.mirrored, mirrored)],
        hinges=np.ascontiguousarray(hinges),
        faces=pairs.faces,
        corners=pairs.corners,
        stencils=np.ascontiguousarray(stencils),
        folds=folds,
        places=np.ascontiguousarray(places),
        shares=shares,
        share_index=share_index,
        moments=moments,
        share_count=int(shared.size),
        sources=_sources(mesh, pairs.wings, inner, len(hinges)),
    )


def _sources(mesh: TriangleMesh, wings: Wings, inner: Index, count: int) -> sps.csr_array:
    """Angles of the mesh's hinges that make those of ``count`` hinges, the first of which are ``inner``."""
    own = inner < len(mesh.hinges)
    rows, columns, values = [inner[own]], [np.flatnonzero(own)], [np.ones(int(own.sum()))]
    for side in (0, 1):
        further = inner[~own] - len(mesh.hinges)
        kept = wings.rest[further, side] >= 0
        rows.append(wings.rest[further, side][kept])
        columns.append(np.flatnonzero(~own)[kept])
        values.append(wings.rest_signs[further, side][kept])
    places = np.concatenate(rows), np.concatenate(columns)
    return sps.csr_array(sps.coo_array((np.concatenate(values), places), shape=(len(mesh.hinges), count)))


def _bending_pairs(
    mesh: TriangleMesh,
    rigidity: Array,
    poisson: Array,
    slopes: HeldSlopes,
    held_vertices: Mask,
    alike: Mask,
) -> _Pairs:
    """Pairs of the triangles that bend, over ``alike`` edges (E,) alone, and what their edges are."""
    clamped: Mask = np.asarray(slopes.clamped[mesh.edges].all(axis=1))
    loose = (mesh.edge_faces[:, 1] < 0) & ~clamped
    held: Mask = held_vertices[mesh.faces].all(axis=1) & ~_at_pinned_corners(mesh, loose, held_vertices)
    # Of the last side, which stands for none, nothing bends.
    meeting = np.append(~held, False)[mesh.edge_faces].all(axis=1) & ~clamped
    meeting[mesh.joints.edges] = meeting[slopes.mirrored] = False
    wings = wings_of(mesh, held, slopes)
    faces, corners = paired_triangles(mesh, rigidity, poisson, ~held, meeting & alike)
    own = faces[:, [0, 0, 0, 1, 1]]
    turned = (corners[:, [0, 0, 0, 1, 1]] + np.array([1, 2, 3, 2, 3])) % 3
    edges = np.where(own >= 0, mesh.face_edges[own, turned], -1)
    sides = mesh.edge_faces[edges]
    left = sides[:, :, 0] == own
    across = np.where(left, sides[:, :, 1], sides[:, :, 0])
    mirrored = np.zeros(len(mesh.edges), dtype=bool)
    mirrored[slopes.mirrored] = True
    joined = wings.joined[own, turned] & (own >= 0)
    flat = wings.flat[own, turned] & (own >= 0)
    left &= ~joined
    cases = {
        EdgeKind.ABSENT: own < 0,
        EdgeKind.INNER: (faces[:, 1:] >= 0) & (np.arange(5) == 0),
        EdgeKind.MIRRORED: mirrored[edges] & ~flat,
        EdgeKind.HELD: np.where(joined, wings.held[own, turned], (across >= 0) & held[across]),
        EdgeKind.CLAMPED: clamped[edges],
        EdgeKind.FREE: (across < 0) | flat,  # in a plane of symmetry a triangle stays flat, and without moment
    }
    kinds = np.select([*cases.values()], [*cases], EdgeKind.SPLIT)
    pair = np.empty(len(mesh.faces) + 1, dtype=np.int64)  # the last, which stands for no triangle, is not read
    pair[faces] = np.arange(len(faces))[:, None]
    neighbours = np.where((kinds == EdgeKind.SPLIT) & ~joined, pair[across], -1)
    hinges = np.where(own >= 0, wings.of_corners[own, turned], -1)
    forward = wings.forward[own, turned]
    return _Pairs(faces, corners, edges, kinds, left, neighbours, hinges, joined, forward, wings)


def _corners(mesh: TriangleMesh, pairs: _Pairs) -> Index:
    """Stencils (B, 8) of the corners of each pair, without the vertices across its edges."""
    faces, corners = pairs.faces, pairs.corners
    paired = faces[:, 1] >= 0
    stencils = np.full((len(faces), 8), -1)
    stencils[:, :3] = mesh.faces[faces[:, 0, None], (corners[:, 0, None] + np.arange(3)) % 3]
    stencils[paired, 3] = mesh.faces[faces[paired, 1], corners[paired, 1]]
    return stencils


def _numbered(edges: Index, chosen: Mask) -> tuple[Index, Index]:
    """The edges among the ``chosen`` (B, 5), and which of them each is (B, 5); -1 of others."""
    numbers, own = np.full(edges.shape, -1), edges[chosen]
    there = np.zeros(1 + own.max(initial=-1), dtype=bool)
    there[own] = True
    numbers[chosen] = (np.cumsum(there) - 1)[own]
    return np.flatnonzero(there), numbers


def _at_pinned_corners(mesh: TriangleMesh, edges: Mask, held: Mask) -> Mask:
    """Triangles (T,) with two of the boundary ``edges`` (E,), whose vertices are ``held`` and run on as a held edge.

    These are flat, but there is twist: their moments are those of their neighbours. Held by itself a triangle clamps.
    """
    runs = mesh.edges[edges & held[mesh.edges].all(axis=1)]
    within = np.bincount(runs.ravel(), minlength=len(held)) >= 2
    return np.asarray((edges[mesh.face_edges].sum(axis=1) == 2) & within[mesh.faces].all(axis=1))


def _takes_fold(pairs: _Pairs) -> Mask:
    """Whether each fold angle counts in this pair (B, 5), and not in its neighbour, whose is the share."""
    colours = np.full(len(pairs.faces), -1)
    colour_triangles(pairs.neighbours, colours)
    own, other = colours[:, None], colours[pairs.neighbours]
    return np.where(pairs.joined, pairs.hinges >= 0, np.where(own == other, pairs.left, own > other))


def _share_factors(share_index: Index, gains: Mask, moments: Array, scale: float) -> Array:
    """Factors (B, 5) of the shares in gamma, positive where a pair ``gains`` by them, that scale their stiffness."""
    split = share_index >= 0
    diagonal = np.bincount(share_index[split], np.einsum("tkk->tk", moments)[split])
    factors = np.zeros(split.shape)
    factors[split] = np.where(gains, 1.0, -1.0)[split] * np.sqrt(scale / diagonal[share_index[split]])
    return factors


def mirror_images(points: Array, first: Index, second: Index, apex: Index) -> Array:
    """Mirror images of the vertices ``apex`` over the lines from ``first`` to ``second``, in the triangles' planes."""
    edge, arm = points[second] - points[first], points[apex] - points[first]
    foot = (np.sum(arm * edge, axis=1) / np.sum(edge**2, axis=1))[:, None] * edge
    return np.asarray(points[first] + 2.0 * foot - arm)
