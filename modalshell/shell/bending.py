r"""Effective bending stiffness of a mesh of hinges.

A smooth curvature :math:`\kappa` (a symmetric tensor in the tangent plane) folds each hinge by
:math:`\theta = r : \kappa`, where r follows from the hinge's own triangles, unfolded. The mesh then stores
:math:`k_f\,\kappa : C : \kappa` per area with :math:`C = \sum_e (l_0/h_0)\, r_e r_e^T / A`, which takes the place of a
plate's :math:`D \kappa^2 / 2`. Vertices then shift along the normal until they are in balance, which softens meshes
whose vertices differ in valence (union-jack: from 3 to 2.5), so the constants are measured with that relaxation: on
patches of the mesh, or for a flat strip on the strip itself. See theory 3, eq. 4 to 6.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sps
import scipy.sparse.linalg as spla
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.csgraph import dijkstra

from modalshell.core.errors import MaterialError
from modalshell.core.typing import Array, Mask
from modalshell.linalg.elements import assembled
from modalshell.mesh import TriangleMesh
from modalshell.shell.orientation import in_plane_angles, orient

_RINGS = 9
"""Radius of a patch, in edges."""
_PATCHES = 24
"""Patches over which the constants are averaged."""
_MEASURED_DEPTH = 5
"""Rings inside the boundary from which the free rim no longer changes what a patch measures."""

_CLOSES, _ALONG = 0.01, 0.1
"""Mean normal of a surface that closes around an axis, and the most of a normal along that."""


@dataclass(frozen=True)
class BendingConstants:
    """What ``k_f`` is multiplied by in the bending energy per area at unit curvature."""

    wide: float
    """c: no curvature across (a plate held across)."""
    narrow: float
    """b: curvature across and twist free (a narrow strip)."""
    across: float = np.nan
    """As ``wide`` for bending across the direction; NaN where the mesh has no direction or is too coarse to measure."""
    ends: tuple[float, ...] = ()
    """As ``narrow``, measured on a flat strip clamped at either end; empty where no end could be measured."""
    around: float = np.nan
    """As ``narrow`` for bending around a ring, whose other constants are means over directions; NaN of others."""


def hinge_weights(mesh: TriangleMesh) -> Array:
    """``l0 / h0`` of every hinge (H,), with h0 a third of the mean of the two heights over the edge."""
    areas = mesh.face_areas[mesh.hinge_faces].sum(axis=1)
    return np.asarray(3.0 * mesh.edge_lengths[mesh.hinge_edges] ** 2 / areas)


def clamp_line_hinges(mesh: TriangleMesh, clamped: Mask) -> Mask:
    """Hinges (H,) between one triangle that is wholly held and one that is not.

    Such a hinge stands for the free half of its cell only.
    """
    held: Mask = np.asarray(clamped[mesh.faces].all(axis=1))
    faces = mesh.hinge_faces
    return np.not_equal(held[faces[:, 0]], held[faces[:, 1]])


def _hinge_geometry(mesh: TriangleMesh) -> tuple[Array, Array, Array, Array, Array]:
    """Feet of the two opposite vertices along the edge (in edge lengths), their heights [m], and the unit edges."""
    x = mesh.vertices[mesh.hinges]
    edge = x[:, 1] - x[:, 0]
    length = np.linalg.norm(edge, axis=1)
    tangent = edge / length[:, None]
    feet = [np.einsum("hi,hi->h", x[:, k] - x[:, 0], tangent) / length for k in (2, 3)]
    heights = [np.linalg.norm(np.cross(tangent, x[:, k] - x[:, 0]), axis=1) for k in (2, 3)]
    return feet[0], feet[1], heights[0], heights[1], tangent


def hinge_rows(mesh: TriangleMesh) -> tuple[Array, Array, Array]:
    """Fold angle of each hinge at unit curvatures.

    Returns
    -------
    rows : ndarray, shape (H, 3)
        ``theta = rows . (kappa_tt, kappa_nn, kappa_tn)``, t along the edge, n across it to its left in the tangent
        plane, curvatures positive where the normals spread; lengths taken in the unfolded pair of triangles [m].
    tangents, normals : ndarray, shape (H, 3)
        Unit vectors t and the mean surface normals.
    """
    foot_1, foot_2, height_1, height_2, tangents = _hinge_geometry(mesh)
    length = mesh.edge_lengths[mesh.hinge_edges]
    along = length**2 * (foot_1 * (foot_1 - 1.0) / height_1 + foot_2 * (foot_2 - 1.0) / height_2)
    rows = 0.5 * np.stack([along, height_1 + height_2, 2.0 * length * (foot_1 - foot_2)], axis=1)
    normals = _normals_along(mesh).sum(axis=1)
    return rows, tangents, normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)


def _normals_along(mesh: TriangleMesh) -> Array:
    """Normals (H, 2, 3) of the faces of each hinge, turned where a face of a joint runs the other way."""
    normals = mesh.face_normals[mesh.hinge_faces]
    if mesh.joints.edges.size:
        odd = np.isin(mesh.hinge_edges, mesh.joints.edges)
        x0, x1, x2, _ = np.moveaxis(mesh.vertices[mesh.hinges[odd]], 1, 0)
        along = np.sum(np.cross(x1 - x0, x2 - x0) * normals[odd, 0], axis=1)
        normals[odd, 0] *= np.sign(along)[:, None]
    return normals


def hinge_operator(mesh: TriangleMesh) -> sps.csr_array:
    """Fold angles (H,) from small displacements (n,) along the normal, as a sparse (H, n) matrix [rad/m]."""
    foot_1, foot_2, height_1, height_2, _ = _hinge_geometry(mesh)
    values = np.stack(
        [
            (1.0 - foot_1) / height_1 + (1.0 - foot_2) / height_2,
            foot_1 / height_1 + foot_2 / height_2,
            -1.0 / height_1,
            -1.0 / height_2,
        ],
        axis=1,
    )
    rows = np.arange(len(mesh.hinges))[:, None]
    return assembled(values[:, None, :], rows, mesh.hinges, (len(rows), len(mesh.vertices)))


def bending_constants(mesh: TriangleMesh, direction: ArrayLike | None = None) -> BendingConstants:
    """Bending constants for bending along ``direction``, or along the long axis, or on the mean (see Material)."""
    if len(mesh.hinges) == 0:
        raise MaterialError("a mesh without interior edges has no hinges and cannot bend (got 0 hinges); refine it")
    orientation = orient(mesh, direction)
    axis, around = orientation.axis, np.nan
    tensor = _relaxed_tensor(mesh, axis)
    if np.linalg.matrix_rank(tensor) < 3:
        raise MaterialError(
            f"the mesh has {len(mesh.hinges)} hinges, too few to resist bending in every direction; refine it"
        )
    if axis.any():
        wide, narrow = tensor[0, 0], 1.0 / np.linalg.inv(tensor)[0, 0]
    else:
        # Mean over directions: a uniaxial curvature and a spherical one determine an isotropic plate.
        wide = 3.0 / 8.0 * (tensor[0, 0] + tensor[1, 1]) + tensor[0, 1] / 4.0 + tensor[2, 2] / 8.0
        sphere = tensor[0, 0] + tensor[1, 1] + 2.0 * tensor[0, 1]
        poisson = sphere / (2.0 * wide) - 1.0
        narrow = wide * (1.0 - poisson**2)
        if (ring := _ring_axis(mesh)) is not None:
            own, rest = _relaxed_tensor(mesh, ring), np.array([0, 2])
            # Of one row of cells the others may have no stiffness: there is no inverse of all.
            free = np.linalg.pinv(own[np.ix_(rest, rest)], rcond=1e-9, hermitian=True)
            around = float(own[1, 1] - own[1, rest] @ free @ own[rest, 1])
    ends: tuple[float, ...] = ()
    if orientation.flat and orientation.elongated and not orientation.named:
        ends = _cantilever(mesh, axis)
        # On a mesh of a cell or two the clamp leaves nothing to measure, or holds it by no hinge.
        if ends and 0.5 * narrow < np.mean(ends) < 2.0 * narrow:
            narrow = float(np.mean(ends))
        else:
            ends = ()
    across = float(tensor[1, 1]) if axis.any() and deepest_ring(mesh) >= _MEASURED_DEPTH else np.nan
    return BendingConstants(float(wide), float(narrow), across, ends, around)


def _ring_axis(mesh: TriangleMesh) -> Array | None:
    """Unit axis (3,) of a mesh that closes around one, all triangles nearly along it; None of others."""
    normals, shares = mesh.face_normals, mesh.face_areas / mesh.area
    axis = np.asarray(np.linalg.eigh(np.einsum("t,ti,tj->ij", shares, normals, normals))[1][:, 0])
    closes = np.linalg.norm(shares @ normals) < _CLOSES
    return axis if closes and np.abs(normals @ axis).max() < _ALONG else None


def deepest_ring(mesh: TriangleMesh) -> int:
    """Edges from the boundary to the vertex that is farthest from it; the number of vertices of a closed mesh."""
    return int(_rings(_neighbours(mesh), mesh.boundary_vertices).max())


def _neighbours(mesh: TriangleMesh) -> sps.csr_array:
    graph = sps.coo_array((np.ones(len(mesh.edges)), mesh.edges.T), shape=(len(mesh.vertices),) * 2).tocsr()
    return sps.csr_array(graph + graph.T)


def _relaxed_tensor(mesh: TriangleMesh, axis: Array) -> Array:
    """Mean C (3, 3) in (along, across, twist) over patches; per-patch axes are arbitrary where ``axis`` is zero."""
    rows, tangents, normals = hinge_rows(mesh)
    operator = hinge_operator(mesh)
    weights = hinge_weights(mesh)
    graph = _neighbours(mesh)
    depth = _rings(graph, mesh.boundary_vertices)
    deepest = np.flatnonzero(depth >= min(_RINGS, depth.max()))
    centres = deepest[np.linspace(0, deepest.size - 1, min(_PATCHES, deepest.size)).round().astype(int)]
    hinge_faces = mesh.hinge_faces
    total, area = np.zeros((3, 3)), 0.0
    for centre in np.unique(centres):
        ring = _rings(graph, np.array([centre]))
        inside = np.asarray((ring[mesh.faces] <= _RINGS).all(axis=1))
        hinges = np.flatnonzero(inside[hinge_faces].all(axis=1))
        movable = np.flatnonzero((ring <= _RINGS - 2) & (depth >= 2))
        measured = np.asarray((ring[mesh.faces] <= _RINGS // 3).all(axis=1)) & inside
        share = 0.5 * measured[hinge_faces[hinges]].sum(axis=1)
        if not share.any():
            continue
        local = axis if axis.any() else tangents[hinges[0]]
        angles = _turn(rows[hinges], tangents[hinges], normals[hinges], local)
        if movable.size:
            fluctuation = operator[hinges][:, movable].toarray()
            weighted = weights[hinges][:, None] * fluctuation
            # Definite, as the outermost two rings are held, but for parts that hang on one vertex.
            angles = angles - fluctuation @ _least_solution(weighted.T @ fluctuation, weighted.T @ angles)
        total += np.einsum("h,hi,hj->ij", share * weights[hinges], angles, angles)
        area += float(mesh.face_areas[measured].sum())
    if area == 0.0:
        angles = _turn(rows, tangents, normals, axis if axis.any() else tangents[0])
        return np.asarray(np.einsum("h,hi,hj->ij", weights, angles, angles) / mesh.area)
    return total / area


def _least_solution(matrix: Array, right_sides: Array) -> Array:
    """Solution of a symmetric system, the shortest one where it is singular."""
    try:
        return np.asarray(np.linalg.solve(matrix, right_sides))
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.lstsq(matrix, right_sides, rcond=None)[0])


def _rings(graph: sps.csr_array, sources: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number of edges from each vertex to the nearest source; the number of vertices if there is none."""
    if not sources.size:
        return np.full(graph.shape[0], graph.shape[0], dtype=np.int64)
    edges = dijkstra(graph, indices=sources, unweighted=True, min_only=True)
    return np.where(np.isfinite(edges), edges, graph.shape[0]).astype(np.int64)


def _cantilever(mesh: TriangleMesh, axis: Array) -> tuple[float, ...]:
    """Narrow constant of a flat strip, measured on the strip itself: its drop under its own weight, clamped at an end.

    A beam of bending stiffness EI drops by ``q L^4 / (8 EI)``; with ``EI = 2 b k_f width`` this gives b, with the free
    sides and the clamp, near which the strip cannot curve across. One value for each end that can be clamped.
    """
    operator = hinge_operator(mesh)
    vertex_area = mesh.shared_among_corners(mesh.face_areas)
    constants = []
    for direction in (axis, -axis):
        along = mesh.vertices @ direction
        along = along - along.min()
        length = along.max()
        first = along[mesh.faces].min(axis=1) < 1e-6 * length
        clamp = along[mesh.faces][first].max()
        held = along <= clamp * (1.0 + 1e-9)
        free = np.flatnonzero(~held)
        if free.size == 0 or np.setdiff1d(mesh.components, mesh.components[held]).size:  # loose parts drop for ever
            continue
        weights = hinge_weights(mesh) * np.where(clamp_line_hinges(mesh, held), 2.0, 1.0)
        stiffness = sps.csc_array(2.0 * operator.T @ sps.diags_array(weights) @ operator)
        # Where the clamp holds the strip by no hinge the drop is no number.
        with warnings.catch_warnings(action="ignore", category=spla.MatrixRankWarning):
            drop = spla.spsolve(stiffness[free][:, free], vertex_area[free])
        tip = drop[along[free] > (1.0 - 1e-6) * length].mean()
        constants.append(float((length - clamp) ** 4 / (16.0 * tip)))
    return tuple(constants)


def _turn(rows: Array, tangents: Array, normals: Array, axis: Array) -> Array:
    """Rows for curvatures (along, across, twist) of ``axis`` laid into each hinge's tangent plane."""
    cosine, sine = in_plane_angles(tangents, normals, axis)
    # t = cosine d + sine c, n = -sine d + cosine c with c the cross axis.
    tt, nn, tn = rows.T
    return np.stack(
        [
            cosine**2 * tt + sine**2 * nn - cosine * sine * tn,
            sine**2 * tt + cosine**2 * nn + cosine * sine * tn,
            2.0 * cosine * sine * (tt - nn) + (cosine**2 - sine**2) * tn,
        ],
        axis=1,
    )
