r"""Bending by split folds: a Kirchhoff plate whose curvatures are the fold angles of the mesh.

Each interior edge e has its fold angle :math:`\delta_e = \theta_e - \theta_{0,e}` and one fold share :math:`f_e`
without mass, which parts the fold between its triangles: :math:`\gamma_{T,e} = \delta_e - f_e` belongs to one,
:math:`\gamma_{T',e} = f_e` to the other. A triangle's curvature is then
:math:`\kappa_T = \sum_k (l_k / A_T) \gamma_{T,k} n_k n_k^T`, and its energy
:math:`\gamma_T^T K_T \gamma_T / 2` with

.. math:: (K_T)_{kl} = \frac{D}{A_T} l_k l_l \left[\nu + (1 - \nu) (n_k \cdot n_l)^2\right] .

The energy is least for the shares at which the bending moment across each edge is continuous ([morley1968]; the
mixed element of [herrmann1967] and [johnson1973]). The shares follow linearly from the fold angles, so the bending
energy is :math:`\delta^T H \delta / 2` with one constant matrix H. Which of the triangles is the first is free:
triangles are coloured so that neighbours differ where possible, and folds count in those of one colour, so that
positions are coupled across every other triangle only and factors stay sparse.

Edges: a free edge has no moment, so its fold is condensed out of K_T. At a clamped edge the whole fold belongs to the
one free triangle, against a held triangle or against a ghost vertex: the mirror image of the opposite vertex in the
triangle's rest plane. One held row of vertices therefore clamps. At an edge in a plane of symmetry half of the fold
belongs to the one triangle, against the mirror image of its opposite vertex, which moves with that vertex.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np
import scipy.sparse as sps
from numpy.typing import NDArray

from modalshell.kernels.split_folds import colour_triangles
from modalshell.mesh import TriangleMesh
from modalshell.shell.slopes import HeldSlopes
from modalshell.typing import Array, Index


@final
@dataclass(frozen=True)
class SplitFolds:
    """Connectivity and constant matrices of the bending energy.

    Attributes
    ----------
    ghosts : ndarray, shape (g, 3)
        Positions of the ghost vertices [m]; they follow the n vertices of the mesh in every stencil.
    reflections : ndarray, shape (s, 3, 3)
        Reflections that make the last s ghosts, and the last s hinges, of the vertices across their edges.
    hinges : ndarray of int64, shape (H, 4)
        Hinges that carry energy, in the order of the flexure kernel.
    triangles : ndarray of int64, shape (B, 6)
        Corners of every triangle that can bend, and the vertices across the edges of its hinges; else -1.
    folds : ndarray of int64, shape (B, 3)
        Hinge at the edge opposite each corner, whose fold angle counts in this triangle; -1 where none does.
    places : ndarray of int64, shape (B, 3, 4)
        Positions of each hinge's vertices among the triangle's six.
    shares : ndarray, shape (B, 3)
        Factors of the fold share in gamma.
    share_index : ndarray of int64, shape (B, 3)
        Fold share at each edge; -1 if there is none.
    moments : ndarray, shape (B, 3, 3)
        K_T, free edges condensed [N m].
    share_count : int
        Number of fold shares.
    """

    ghosts: Array
    reflections: Array
    hinges: Index
    triangles: Index
    folds: Index
    places: Index
    shares: Array
    share_index: Index
    moments: Array
    share_count: int

    def matrices(self) -> tuple[sps.csr_array, sps.csr_array, sps.csr_array]:
        """Second derivatives of the bending energy: by fold angles (H, H), by shares and angles (m, H), by shares."""
        count = len(self.triangles)
        rows = np.arange(3 * count)
        blocks = sps.block_diag(list(self.moments), format="csr") if count else sps.csr_array((0, 0))

        def selection(columns: Index, factors: Array, size: int) -> sps.csr_array:
            used = columns.ravel() >= 0
            entries = (factors.ravel()[used], (rows[used], columns.ravel()[used]))
            return sps.csr_array(sps.coo_array(entries, shape=(3 * count, size)))

        by_fold = selection(self.folds, np.ones(self.folds.shape), len(self.hinges))
        by_share = selection(self.share_index, self.shares, self.share_count)
        stressed = blocks @ by_fold
        return (
            sps.csr_array(by_fold.T @ stressed),
            sps.csr_array(by_share.T @ stressed),
            sps.csr_array(by_share.T @ blocks @ by_share),
        )

    def of_hinges(self, mesh: TriangleMesh, values: Array) -> Array:
        """Values (H,) of folds at the hinges of the mesh; zero at those between held triangles."""
        real = self.hinges[:, 3] < len(mesh.vertices)
        keys, wanted = (ends[:, :2] @ np.array([len(mesh.vertices), 1]) for ends in (mesh.hinges, self.hinges[real]))
        order = np.argsort(keys)
        found = np.zeros(len(mesh.hinges))
        found[order[np.searchsorted(keys[order], wanted)]] = values[real]
        return found

    def part(self, chosen: Index, factors: Array, vertices: Index, count: int) -> tuple[SplitFolds, Index, Index]:
        """Chosen triangles times factors, on a numbering of the sorted ``vertices`` out of ``count``.

        Ghosts follow these again. Also the hinges and the shares that the part has.
        """
        folds, share_index, triangles = self.folds[chosen], self.share_index[chosen], self.triangles[chosen]
        hinges, shares = (np.unique(numbers[numbers >= 0]) for numbers in (folds, share_index))

        def local(numbers: Index) -> Index:
            real = np.searchsorted(vertices, numbers)
            return np.ascontiguousarray(np.where(numbers < count, real, numbers - count + vertices.size))

        mirrored = hinges - (len(self.hinges) - len(self.reflections))
        part = replace(
            self,
            reflections=self.reflections[mirrored[mirrored >= 0]],
            hinges=local(self.hinges[hinges]),
            triangles=np.where(triangles >= 0, local(triangles), -1),
            folds=np.where(folds >= 0, np.searchsorted(hinges, folds), -1),
            places=self.places[chosen],
            shares=self.shares[chosen],
            share_index=np.where(share_index >= 0, np.searchsorted(shares, share_index), -1),
            moments=self.moments[chosen] * factors[:, None, None],
            share_count=int(shares.size),
        )
        return part, hinges, shares


def split_folds(
    mesh: TriangleMesh,
    rigidity: Array,
    poisson: Array,
    slopes: HeldSlopes,
    held_vertices: NDArray[np.bool_],
    scale: float,
    *,
    halved: bool = False,
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
        All held vertices; triangles of them do not bend.
    scale : float
        Diagonal entry that the shares' stiffness is scaled to [N/m], near those of the positions.
    halved : bool
        Whether each fold counts by half in both of its triangles, and the shares are what one has more and the other
        less than that. The energy is the same, but every triangle couples all the vertices around it.
    """
    faces = mesh.faces
    held: NDArray[np.bool_] = np.asarray(held_vertices[faces].all(axis=1))
    bending = np.flatnonzero(~held)
    corners = faces[bending]
    # Edge k lies opposite corner k and runs from corner k + 1 to corner k + 2.
    edges = mesh.face_edges[bending][:, [1, 2, 0]]
    sides = mesh.edge_faces[edges]
    left = sides[:, :, 0] == bending[:, None]
    across = np.where(left, sides[:, :, 1], sides[:, :, 0])
    held_edge = slopes.clamped[mesh.edges[edges]].all(axis=2)
    against_held = (across >= 0) & held[across]
    plane = np.full(len(mesh.edges), -1)
    plane[slopes.mirrored] = np.arange(slopes.mirrored.size)
    mirrored = plane[edges] >= 0
    ghost = (held_edge & ~against_held) | mirrored
    free = (across < 0) & ~ghost
    split = ~free & ~ghost & ~against_held
    whole = _takes_fold(held, bending, np.where(split, across, -1), left)

    number = np.full(len(mesh.edges), -1)
    used = np.unique(edges[split | against_held])
    number[used] = np.arange(used.size)
    hinge_of_edge = np.full(len(mesh.edges), -1)
    hinge_of_edge[mesh.hinge_edges] = np.arange(len(mesh.hinges))
    real = mesh.hinges[hinge_of_edge[used]]

    triangle, k = np.hstack([np.nonzero(ghost & ~mirrored), np.nonzero(mirrored)])
    first, second, apex = (corners[triangle, (k + shift) % 3] for shift in (1, 2, 0))
    ghosts = _mirror_images(mesh.vertices, first, second, apex)
    reflections = slopes.reflections()[plane[edges][mirrored]]
    ghost_index = len(mesh.vertices) + np.arange(triangle.size)
    hinges = np.vstack([real, np.column_stack([first, second, apex, ghost_index])]).astype(np.int64)

    folds = np.where((split & (whole | halved)) | against_held, number[edges], -1)
    folds[triangle, k] = used.size + np.arange(triangle.size)
    places, opposite = _places(hinges, folds, left | ghost)
    share_number = np.full(len(mesh.edges), -1)
    shared = np.unique(edges[split])
    share_number[shared] = np.arange(shared.size)
    share_index = np.where(split, share_number[edges], -1)

    moments = fold_moments(mesh, bending, rigidity[bending], poisson[bending], free)
    diagonal = np.zeros(shared.size)
    np.add.at(diagonal, share_index[split], np.einsum("tkk->tk", moments)[split])
    shares = np.zeros(split.shape)
    shares[split] = np.where(left if halved else ~whole, 1.0, -1.0)[split] * np.sqrt(
        scale / diagonal[share_index[split]]
    )
    if halved:
        weight = np.where(split, 0.5, 1.0)
        shares /= weight
        moments = weight[:, :, None] * moments * weight[:, None, :]
    return SplitFolds(
        ghosts=ghosts,
        reflections=reflections,
        hinges=np.ascontiguousarray(hinges),
        triangles=np.ascontiguousarray(np.hstack([corners, opposite])),
        folds=np.ascontiguousarray(folds),
        places=places,
        shares=shares,
        share_index=np.ascontiguousarray(share_index),
        moments=moments,
        share_count=int(shared.size),
    )


def _takes_fold(held: NDArray[np.bool_], bending: Index, across: Index, left: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Whether each fold angle counts in this triangle (B, 3), and not in the one ``across``, whose is the share."""
    number = np.full(held.size, -1)
    number[bending] = np.arange(bending.size)
    neighbours = np.where(across >= 0, number[across], -1)
    colours = np.full(bending.size, -1)
    colour_triangles(neighbours, colours)
    own, other = colours[:, None], colours[neighbours]
    return np.where(own == other, left, own > other)


def _mirror_images(points: Array, first: Index, second: Index, apex: Index) -> Array:
    """Mirror images of the vertices ``apex`` over the lines from ``first`` to ``second``, in the triangles' planes."""
    edge, arm = points[second] - points[first], points[apex] - points[first]
    foot = (np.sum(arm * edge, axis=1) / np.sum(edge**2, axis=1))[:, None] * edge
    return np.asarray(points[first] + 2.0 * foot - arm)


def _places(hinges: Index, folds: Index, left: NDArray[np.bool_]) -> tuple[Index, Index]:
    """Places of each fold's hinge vertices among the triangle's six, and the vertex across each edge (or -1)."""
    places = np.zeros((*folds.shape, 4), dtype=np.int64)
    across = np.full(folds.shape, -1)
    for k in range(3):
        # A triangle left of the edge runs along it, from corner k + 1 to corner k + 2; one on the right against it.
        along = np.array([(k + 1) % 3, (k + 2) % 3, k, 3 + k])
        against = along[[1, 0, 3, 2]]
        places[:, k] = np.where(left[:, k, None], along, against)
        present = folds[:, k] >= 0
        hinge = hinges[folds[present, k]]
        across[present, k] = np.where(left[present, k], hinge[:, 3], hinge[:, 2])
    return places, across


def fold_moments(mesh: TriangleMesh, bending: Index, rigidity: Any, poisson: Any, free: NDArray[np.bool_]) -> Any:
    """K_T (B, 3, 3) with the free edges' folds condensed out; complex where the constants are."""
    x = mesh.vertices[mesh.faces[bending]]
    edge = np.roll(x, -2, axis=1) - np.roll(x, -1, axis=1)
    length = np.linalg.norm(edge, axis=2)
    # In-plane normals make the angles that the edges make.
    cosines = np.einsum("tki,tli->tkl", edge, edge) / (length[:, :, None] * length[:, None, :])
    nu = poisson[:, None, None]
    weight = (rigidity / mesh.face_areas[bending])[:, None, None]
    moments = weight * length[:, :, None] * length[:, None, :] * (nu + (1.0 - nu) * cosines**2)
    for k in range(3):
        condensed = moments - moments[:, :, k, None] * moments[:, k, None, :] / moments[:, k, k, None, None]
        condensed[:, k] = condensed[:, :, k] = 0.0
        moments = np.where(free[:, k, None, None], condensed, moments)
    return np.ascontiguousarray(moments)
