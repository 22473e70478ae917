r"""Pairs of triangles that bend together, and the bending stiffness of each.

One constant moment per triangle leaves plates too soft, by an error in the square of the edge length. In a pair of
triangles that share an edge the moments M, M' of both are known from the moments across five edges, and with their mean
:math:`\bar M` the complementary energy of the pair is taken as

.. math:: (1 - w) (A\, M : C : M + A'\, M' : C : M') / 2 + w (A + A') \bar M : C : \bar M / 2 .

Constant moments keep their energy (theory 5, eq. 2). At w = 2/3 and equal areas it is the energy of a moment that goes
linearly from M to M' over the pair. A plane wave of wave number k on equilateral triangles of edge h, all pairs in one
direction, has the stiffness :math:`D k^4 (1 - (1 - w) \beta k^2 h^2)` in the mean over directions, with :math:`\beta`
= 0.141, 0.206 and 0.298 for Poisson's ratios 0, 0.3 and 0.5 (theory 5, eq. 4 and 5). With w = 1, at which pairs lose
their definite stiffness, frequencies of lumped masses are exact to this order; deflections under loads are where
:math:`(1 - w) \beta = 1/16`, at w from 0.56 to 0.79. The weight here lies between both.

Pairs follow from the shape alone: a symmetry of the mesh is one of the energy, and numbers of vertices do not matter.
Where two edges of a triangle rank the same, it is paired over neither.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from modalshell.core.in_parts import fill_in_parts
from modalshell.core.typing import Array, Index, Mask
from modalshell.mesh import TriangleMesh
from modalshell.shell.elasticity import Elasticity
from modalshell.shell.kernels.split_folds import match_triangles, quadratic_forms
from modalshell.shell.smoothed_membrane import SHARP

MEAN_WEIGHT = 5.0 / 6.0
"""Weight w of a pair's mean moment."""
_SLOTS = ([0, 1, 2], [0, 3, 4])
"""Edges of either triangle of a pair among its five."""
ALIKE = 1.25
"""Largest ratio of the stiffnesses of a pair: moments along an edge and strains across it jump where the sheet does."""
LIKE_POISSON = 0.05
"""Largest difference of its Poisson's ratios."""
_ROUNDING = 1e-9
"""By which both may be larger."""
_SLENDER = 0.05
"""Least height of a pair's triangles, over their longest edge."""


def paired_triangles(
    mesh: TriangleMesh, rigidity: Array, poisson: Array, bends: Mask, inner: Mask
) -> tuple[Index, Index]:
    """Triangles that ``bends`` (T,) by pairs over the edges ``inner`` (E,); the rest stay single.

    Edges that are longest among those of their triangles come first, of like ones those nearest to the middle of their
    component.

    Returns
    -------
    ndarray of int64, shape (P, 2)
        Triangles of every pair, then single ones with -1 after them.
    ndarray of int64, shape (P, 2)
        The corners opposite their common edge; of single triangles the first.
    """
    sides = mesh.edge_lengths[mesh.face_edges]
    stout = bends & (2.0 * mesh.face_areas > _SLENDER * sides.max(axis=1) ** 2)
    both = np.where(inner[:, None], mesh.edge_faces, -1)
    candidates = np.flatnonzero((both >= 0).all(axis=1))
    first, second = both[candidates].T
    flat = np.sum(mesh.face_normals[first] * mesh.face_normals[second], axis=1) >= np.cos(SHARP)
    kept = stout[first] & stout[second] & flat & alike_edges(mesh, rigidity, poisson)[candidates]
    candidates, first, second = candidates[kept], first[kept], second[kept]
    over = np.full(len(mesh.faces), -1)
    if candidates.size:
        # Rounded, so that rounding errors do not tell edges apart that a symmetry of the mesh maps to each other.
        share = mesh.edge_lengths[candidates] ** 2 / np.sum(sides[np.stack([first, second])] ** 2, axis=(0, 2))
        away = _distances_from_middle(mesh, candidates)
        rank = np.column_stack([-np.floor(100.0 * share + 0.3), np.floor(1000.0 * away + 0.3)])
        order = np.lexsort((rank[:, 1], rank[:, 0]))
        begins = np.flatnonzero(np.append(True, (np.diff(rank[order], axis=0) != 0.0).any(axis=1)))
        wanted = np.zeros(over.size, np.int64)
        match_triangles(candidates[order], np.append(begins, order.size), mesh.edge_faces, wanted, over)

    taken = np.zeros(len(mesh.edges), dtype=bool)
    taken[over[over >= 0]] = True
    joined = np.flatnonzero(taken)
    alone = np.flatnonzero(bends & (over < 0))
    faces = np.vstack([mesh.edge_faces[joined], np.column_stack([alone, np.full(alone.size, -1)])])
    corners = np.vstack([(mesh.edge_corners[joined] + 2) % 3, np.zeros((alone.size, 2))])
    return faces.astype(np.int64), corners.astype(np.int64)


def alike_edges(mesh: TriangleMesh, stiffness: Array, poisson: Array, directed: Elasticity | None = None) -> Mask:
    """Whether the sheet is about the same in both triangles of each edge (E,), by constants of every triangle (T,).

    Of a sheet that is not the same in all directions the ``directed`` elasticity is compared, too.
    """
    first, second = mesh.edge_faces.T
    less, more = np.sort(stiffness[mesh.edge_faces], axis=1).T
    same = (second >= 0) & (more <= (ALIKE + _ROUNDING) * less)
    same &= np.abs(poisson[first] - poisson[second]) <= LIKE_POISSON + _ROUNDING
    return same if directed is None else same & directed.alike(mesh, ALIKE - 1.0)


def _distances_from_middle(mesh: TriangleMesh, edges: Index) -> Array:
    """Distance of the middles of ``edges`` from the centroid of their component, over its mean edge length (E,)."""
    of_faces, of_edges = mesh.components[mesh.faces[:, 0]], mesh.components[mesh.edges[:, 0]]
    weighted = mesh.face_areas[:, None] * _middles(mesh, mesh.faces)
    area, *moments = (np.bincount(of_faces, weights) for weights in (mesh.face_areas, *weighted.T))
    own = of_edges[edges]
    middles = np.stack(moments, axis=1)[own] / area[own, None]
    mean = np.bincount(of_edges, mesh.edge_lengths)[own] / np.bincount(of_edges)[own]
    return np.asarray(np.linalg.norm(_middles(mesh, mesh.edges[edges]) - middles, axis=1) / mean)


def _middles(mesh: TriangleMesh, corners: Index) -> Array:
    """Means (k, 3) of the vertices ``corners`` (k, c)."""
    total = mesh.vertices[corners[:, 0]]
    for further in corners.T[1:]:
        total += mesh.vertices[further]
    return total / corners.shape[1]


def fold_moments(
    mesh: TriangleMesh,
    faces: Index,
    corners: Index,
    rigidity: Any,
    poisson: Any,
    free: Mask,
    bending: Elasticity | None = None,
) -> Any:
    """Stiffness (P, 5, 5) [N m] by their folds, ``free`` ones (P, 5) condensed out, of pairs and single triangles.

    ``faces`` and ``corners`` (P, 2) are as :func:`paired_triangles` gives them: all pairs before the first single one.
    Folds are those at the common edge, at the two edges of the first triangle after it and at those of the second. Of a
    single triangle the last two have none. Constants are those of every triangle (T,), complex ones too; in place of
    them ``bending`` is the elasticity of a sheet that is not isotropic.
    """
    count = np.count_nonzero(faces[:, 1] >= 0)
    used = (rigidity, poisson) if bending is None else (bending.matrices, bending.directions)
    moments = np.zeros((len(faces), 5, 5), dtype=np.result_type(*used))
    if bending is None:
        alone = _single(mesh, faces[count:, 0], rigidity, poisson)
    else:
        alone = _single_directed(mesh, faces[count:, 0], bending)
    moments[count:, :3, :3] = _condensed(alone, free[count:, :3])
    joined = functools.partial(_joined, (mesh, rigidity, poisson, bending))
    fill_in_parts(moments[:count], joined, faces[:count], corners[:count], free[:count])
    return moments


def moments_of_triangles(mesh: TriangleMesh, faces: Index, corners: Index, moments: Array) -> Array:
    """Moments (T, 3) at the edges opposite the corners of every triangle, of those (P, 5) of pairs and single ones.

    A triangle of a pair has the tensor ``(1 - w) M + w M_mean``, whose curvatures fit the folds.
    """
    found = np.zeros((len(mesh.faces), 3))
    paired = faces[:, 1] >= 0
    found[faces[~paired, 0]] = moments[~paired, :3]
    unit, areas = _pair_tensors(mesh, faces[paired], corners[paired])
    tensors = np.einsum("spik,pk->spi", unit, moments[paired])
    mean = np.einsum("sp,spi->pi", areas / areas.sum(axis=0), tensors)
    for side, slots in enumerate(_SLOTS):
        smooth = (1.0 - MEAN_WEIGHT) * tensors[side] + MEAN_WEIGHT * mean
        turned = (corners[paired, side, None] + np.arange(3)) % 3
        found[faces[paired, side, None], turned] = np.linalg.solve(unit[side][:, :, slots], smooth[:, :, None])[:, :, 0]
    return found


def _single(mesh: TriangleMesh, faces: Index, rigidity: Any, poisson: Any) -> Any:
    """K_T (B, 3, 3) of triangles by themselves."""
    x = mesh.vertices[mesh.faces[faces]]
    edge = np.roll(x, -2, axis=1) - np.roll(x, -1, axis=1)
    length = np.linalg.norm(edge, axis=2)
    # In-plane normals make the angles that the edges make.
    cosines = np.einsum("tki,tli->tkl", edge, edge) / (length[:, :, None] * length[:, None, :])
    nu = poisson[faces, None, None]
    weight = (rigidity[faces] / mesh.face_areas[faces])[:, None, None]
    return weight * length[:, :, None] * length[:, None, :] * (nu + (1.0 - nu) * cosines**2)


def _single_directed(mesh: TriangleMesh, faces: Index, bending: Elasticity) -> Any:
    """K_T (B, 3, 3) of triangles by themselves, ``L C L^T / A`` with L of ``l_k (n_k1^2, n_k2^2, 2 n_k1 n_k2)``."""
    rows, along, across = _edge_normals(mesh, faces, np.zeros_like(faces))
    elastic = bending.in_axes(mesh, faces, along, across)
    return rows @ elastic @ np.swapaxes(rows, 1, 2) / mesh.face_areas[faces, None, None]


def _condensed(moments: Any, free: Mask) -> Any:
    """Stiffness (B, 3, 3) with the ``free`` edges' folds (B, 3) condensed out."""
    for k in range(3):
        condensed = moments - moments[:, :, k, None] * moments[:, k, None, :] / moments[:, k, k, None, None]
        condensed[:, k] = condensed[:, :, k] = 0.0
        moments = np.where(free[:, k, None, None], condensed, moments)
    return moments


def _joined(
    constants: tuple[TriangleMesh, Any, Any, Elasticity | None], faces: Index, corners: Index, free: Mask
) -> Any:
    """Stiffness (P, 5, 5) of pairs, of the mesh, rigidity and Poisson's ratio (T,); see :func:`fold_moments`."""
    mesh, rigidity, poisson, bending = constants
    tensors, areas = _pair_tensors(mesh, faces, corners)
    if bending is None:
        compliances = np.stack([_compliance(rigidity[own], poisson[own]) for own in faces.T])
    else:
        axes = (_laid_flat(mesh, faces[:, side], corners[:, side])[2:] for side in (0, 1))
        compliances = np.stack(
            [np.linalg.inv(bending.in_axes(mesh, own, *along)) for own, along in zip(faces.T, axes, strict=True)]
        )
    compliances = np.ascontiguousarray(compliances * areas[:, :, None, None])
    mean = np.einsum("sp,spik->pik", areas / areas.sum(axis=0), tensors)
    of_mean, of_both = np.empty((2, len(faces), 5, 5), dtype=compliances.dtype)
    quadratic_forms(mean[None], np.ascontiguousarray(compliances.sum(axis=0))[None], of_mean)
    quadratic_forms(tensors, compliances, of_both)
    flexibility = MEAN_WEIGHT * of_mean + (1.0 - MEAN_WEIGHT) * of_both
    kept_pairs = ~free[:, :, None] & ~free[:, None, :]
    # A free edge has no moment: the others' flexibility alone is inverted.
    flexibility = np.where(kept_pairs, flexibility, np.eye(5) * np.einsum("pkk->p", flexibility)[:, None, None])
    return np.where(kept_pairs, np.linalg.inv(flexibility), 0.0)


def _pair_tensors(mesh: TriangleMesh, faces: Index, corners: Index) -> tuple[Array, Array]:
    """Moment tensors (2, P, 3, 5) in both triangles of pairs, of unit moments at the five edges, and areas (2, P)."""
    unit = np.zeros((2, len(faces), 3, 5))
    for side, slots in enumerate(_SLOTS):
        unit[side][:, :, slots] = moment_tensors(mesh, faces[:, side], corners[:, side])
    return unit, mesh.face_areas[faces].T


def moment_tensors(mesh: TriangleMesh, faces: Index, corners: Index) -> Array:
    """Moment tensors (P, 3, 3), components 11, 22 and 12, of unit moments at the edges opposite each corner.

    Axis 1 is along the edge opposite the corner ``corners`` (P,), the first of the three; seen from the triangle across
    that edge it is the same axis, turned by 180 degrees.
    """
    s, t, _, _ = _laid_flat(mesh, faces, corners)
    # A moment at one edge is the product of the two others: it has no part across these.
    weight = -np.hypot(s, t) / (s[:, :1] * t[:, 1:2]) ** 2
    s1, s2, t1, t2 = (np.roll(a, -k, axis=1) for a in (s, t) for k in (1, 2))
    return np.asarray(weight[:, None] * np.stack([s1 * s2, t1 * t2, 0.5 * (s1 * t2 + s2 * t1)], axis=1))


def _laid_flat(mesh: TriangleMesh, faces: Index, corners: Index) -> tuple[Array, Array, Array, Array]:
    """Components (P, 3) of the edges along axes 1 and 2, and these axes (P, 3)."""
    turned = (corners[:, None] + np.arange(3)) % 3
    x = np.take_along_axis(mesh.vertices[mesh.faces[faces]], turned[:, :, None], axis=1)
    edges = np.roll(x, -2, axis=1) - np.roll(x, -1, axis=1)
    along = edges[:, 0] / np.linalg.norm(edges[:, 0], axis=1)[:, None]
    across = np.cross(mesh.face_normals[faces], along)
    return np.einsum("tki,ti->tk", edges, along), np.einsum("tki,ti->tk", edges, across), along, across


def _edge_normals(mesh: TriangleMesh, faces: Index, corners: Index) -> tuple[Array, Array, Array]:
    """Rows (P, 3, 3) of ``l_k (n_k1^2, n_k2^2, 2 n_k1 n_k2)`` of the edges, and axes 1 and 2 (P, 3)."""
    s, t, along, across = _laid_flat(mesh, faces, corners)
    # An edge with components (s, t) has the normal (t, -s): its square is (t^2, s^2, -2 s t) over the length squared.
    return np.stack([t * t, s * s, -2.0 * s * t], axis=2) / np.hypot(s, t)[:, :, None], along, across


def _compliance(rigidity: Any, poisson: Any) -> Any:
    """Inverse of plane bending (P, 3, 3): the energy of a moment M of components 11, 22, 12 is ``M.C M / 2``."""
    one = np.ones_like(poisson)
    zero = np.zeros_like(poisson)
    rows = [[one, -poisson, zero], [-poisson, one, zero], [zero, zero, 2.0 * (1.0 + poisson)]]
    return np.moveaxis(np.array(rows), -1, 0) / (rigidity * (1.0 - poisson**2))[:, None, None]
