"""Prolongation from a coarse mesh of the same surface to a fine one, by moving least squares.

The weights of a fine vertex reproduce affine fields exactly and, where its coarse neighbours suffice, quadratic ones in
the tangent plane [lancaster1981]. They reach no further than the smooth patch that the vertex lies in: folds stay
sharp. What is left of the rest shape, of third order where it is smooth, stands off along the normals of the coarse
triangles and turns with them.
"""

from __future__ import annotations

from typing import final

import numpy as np
import scipy.sparse as sps
from numpy.typing import NDArray
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from modalshell.core.cost import count_read
from modalshell.core.thread_safety import ReadOnlyArrays, read_only, read_only_view
from modalshell.core.typing import Array, Index
from modalshell.kernels.compiler import njit
from modalshell.mesh import TriangleMesh
from modalshell.mesh.closest import TOGETHER, all_closest, common_parts, lowest, torn_edges
from modalshell.mesh.topology import connected_parts
from modalshell.shell.smoothed_membrane import SHARP

_NEIGHBOURS = 14
"""Number of nearest coarse vertices with a weight; that of the farthest is zero."""
_RINGS, _ROUND = 6, 20
"""Largest number of edges to the nearest vertices, and how many of these are looked at, if no other layer is near."""
_DETOUR = 3.0
"""Way along edges over the straight one from which a vertex is of another layer, as of the next turn of a roll."""
_INDEPENDENT = 1e-6
"""Share of their moment below which quadratic fields count as fixed by the affine ones."""
_AT = 1e-4
"""Distance, as a share of the farthest neighbour's, within which a coarse vertex alone decides."""
_LEAD = 1e-6
"""Longest way of a coarse vertex, in sizes of the surface, over which velocities of the fine one are differences."""


def own_triangles(mesh: TriangleMesh) -> tuple[Index, Array]:
    """One of the triangles of each vertex (n,), and its barycentric shares there (n, 3)."""
    above, corner = np.zeros((2, len(mesh.vertices)), np.int64)
    for place in range(3):
        above[mesh.faces[:, place]], corner[mesh.faces[:, place]] = np.arange(len(mesh.faces)), place
    return above, np.eye(3)[corner]


@final
class Prolongation(ReadOnlyArrays):
    """Weights that prolong positions of a coarse mesh to a fine one, and restrict loads.

    Parameters
    ----------
    coarse, fine : TriangleMesh
        Two meshes of one surface at rest.
    folds : ndarray of int64, shape (k,), optional
        Edges of ``coarse`` that end smooth patches too: it folds there.

    Attributes
    ----------
    distance : ndarray, shape (n,)
        Of every fine vertex from the coarse mesh [m].
    torn : ndarray of int64, shape (k,)
        Fine edges whose ends are prolonged from far parts of the coarse mesh, as from two turns of a roll.
    """

    def __init__(self, coarse: TriangleMesh, fine: TriangleMesh, folds: Index | None = None) -> None:
        self._shape, self._size = (len(fine.vertices), len(coarse.vertices)), coarse.size
        if fine is coarse:  # vertices at one place are still several
            self.distance, self._heights = np.zeros(len(fine.vertices)), np.empty(0)
            self.torn = np.empty(0, dtype=np.int64)
            self._keep(sps.csr_array(sps.eye_array(len(fine.vertices))), own_triangles(fine)[0], fine)
            return
        points = np.asarray(fine.vertices)
        parts = common_parts(fine, coarse)  # sheets close together keep each to its own
        under, _, self.distance, on = all_closest(coarse, points, parts and parts[::-1])
        self.torn = torn_edges(fine, coarse, under)
        patches = _smooth_patches(coarse, fine, folds)
        pairs = [np.unique(patches[near]) for near in on]
        owners = np.repeat(np.arange(len(points)), [len(found) for found in pairs])
        part = 1.0 / np.bincount(owners)  # of a point on a fold each side decides half
        of = np.concatenate(pairs)
        rows, columns, weights = [], [], []
        for patch in np.unique(of):
            chosen, faces = owners[of == patch], np.flatnonzero(patches == patch)
            above = np.searchsorted(faces, [on[point][patches[on[point]] == patch][0] for point in chosen])
            neighbours, weight = _patch_weights(coarse, coarse.faces[faces], points[chosen], above)
            rows.append(np.repeat(chosen, neighbours.shape[1]))
            columns.append(neighbours.ravel())
            weights.append((weight * part[chosen, None]).ravel())
        entries = np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns))
        matrix = sps.csr_array(entries, shape=self._shape)
        along, self._heights = _stand_off(coarse, under, points - matrix @ coarse.vertices)
        matrix = sps.csr_array(matrix + along)
        matrix.sum_duplicates()
        matrix.data[np.abs(matrix.data) < 1e-14] = 0.0
        matrix.eliminate_zeros()
        if np.abs(self._heights).max(initial=0.0) < 1e-12 * coarse.size:
            self._heights = np.empty(0)
        self._keep(matrix, under, coarse)

    def _keep(self, matrix: sps.csr_array, under: Index, coarse: TriangleMesh) -> None:
        self._starts, self._columns, self._weights = (
            read_only(np.array(part))
            for part in (matrix.indptr.astype(np.int64), matrix.indices.astype(np.int64), matrix.data)
        )
        self._under, self._faces = read_only(np.array(under)), read_only(np.array(coarse.faces, dtype=np.int64))
        read_only(self._heights)
        self._bytes = self._starts.nbytes + self._columns.nbytes + self._weights.nbytes

    @property
    def matrix(self) -> sps.csr_array:
        """The weights (n, k)."""
        return sps.csr_array((self._weights, self._columns, self._starts), shape=self._shape)

    def prolong(self, positions: Array) -> Array:
        """Fine positions (n, 3) [m] from coarse ones (k, 3) [m]."""
        fine = np.empty((self._shape[0], 3))
        count_read(self._bytes)
        positions = read_only_view(positions)
        _prolong(positions, self._starts, self._columns, self._weights, self._faces, self._under, self._heights, fine)
        return fine

    def flow(self, positions: Array, rates: Array) -> Array:
        """Fine velocities (n, 3) [m/s] by coarse positions (k, 3) [m] and their rates (k, 3) [m/s]."""
        largest = float(np.abs(rates).max())
        if not self._heights.size or largest == 0.0:  # linear
            return self.prolong(rates)
        lead = _LEAD * self._size / largest
        return (self.prolong(positions + lead * rates) - self.prolong(positions - lead * rates)) / (2.0 * lead)

    def restrict(self, load: Array) -> Array:
        """Load (n, 3) [N] on the coarse vertices (k, 3): the same force and, on a flat rest shape, torque."""
        coarse = np.zeros((self._shape[1], 3))
        count_read(self._bytes)
        _restrict(load, self._starts, self._columns, self._weights, coarse)
        return coarse


@njit(entry=True, error_model="numpy", fastmath={"contract"}, nogil=True)
def _prolong(positions, starts, columns, weights, faces, under, heights, fine):  # type: ignore[no-untyped-def]
    for i in range(starts.size - 1):
        x, y, z = 0.0, 0.0, 0.0
        for k in range(starts[i], starts[i + 1]):
            v, w = columns[k], weights[k]
            x += w * positions[v, 0]
            y += w * positions[v, 1]
            z += w * positions[v, 2]
        fine[i, 0], fine[i, 1], fine[i, 2] = x, y, z
    if heights.size == 0:
        return
    normals = np.zeros((faces.shape[0], 3))
    for t in range(faces.shape[0]):
        a, b, c = positions[faces[t, 0]], positions[faces[t, 1]], positions[faces[t, 2]]
        x = (b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1])
        y = (b[2] - a[2]) * (c[0] - a[0]) - (b[0] - a[0]) * (c[2] - a[2])
        z = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        length = np.sqrt(x * x + y * y + z * z)
        if length > 0.0:  # else the triangle has collapsed
            normals[t, 0], normals[t, 1], normals[t, 2] = x / length, y / length, z / length
    for i in range(heights.size):
        for axis in range(3):
            fine[i, axis] += heights[i] * normals[under[i], axis]


@njit(entry=True, error_model="numpy", fastmath={"contract"}, nogil=True)
def _restrict(load, starts, columns, weights, coarse):  # type: ignore[no-untyped-def]
    for i in range(starts.size - 1):
        for k in range(starts[i], starts[i + 1]):
            for axis in range(3):
                coarse[columns[k], axis] += weights[k] * load[i, axis]


def sharp_edges(mesh: TriangleMesh) -> tuple[Index, NDArray[np.bool_]]:
    """Edges (e,) of two triangles or more, and which of them are sharp (e,), as all junctions are."""
    inner = np.flatnonzero((mesh.edge_faces >= 0).all(axis=1))
    pairs = mesh.edge_faces[inner]
    cosines = np.sum(mesh.face_normals[pairs[:, 0]] * mesh.face_normals[pairs[:, 1]], axis=1)
    return inner, (cosines < np.cos(SHARP)) | np.isin(inner, mesh.joints.edges)


def _smooth_patches(coarse: TriangleMesh, fine: TriangleMesh, folds: Index | None) -> Index:
    """Number (T,) of the smooth patch of every coarse triangle; a coarse mesh of a smooth surface is one patch."""
    inner, sharp = sharp_edges(coarse)
    if not sharp_edges(fine)[1].any():
        sharp[:] = False
    if folds is not None:
        sharp |= np.isin(inner, folds)
    return connected_parts(coarse.edge_faces[inner[~sharp]], len(coarse.faces))


def _patch_weights(coarse: TriangleMesh, faces: Index, points: Array, own: Index) -> tuple[Index, Array]:
    """Coarse vertices (p, k) of a patch around points next to its triangles ``own`` (p,), and their weights (p, k)."""
    members, corners = np.unique(faces, return_inverse=True)
    normals = np.zeros((len(members), 3))
    sides = coarse.vertices[faces[:, 1:]] - coarse.vertices[faces[:, :1]]
    np.add.at(normals, corners.reshape(-1, 3), np.cross(sides[:, 0], sides[:, 1])[:, None])
    vertices = coarse.vertices[members]
    count = min(_NEIGHBOURS, len(members))
    distances, near = cKDTree(vertices).query(points, k=count)
    near, distances = (np.reshape(found, (len(points), -1)) for found in (near, distances))
    if count == _NEIGHBOURS:
        near, distances = _along_surface(vertices, corners.reshape(-1, 3), points, own, (near, distances))
    nearest = lowest(near, distances <= distances[:, :1] + TOGETHER * coarse.size)
    normal = normals[near[np.arange(len(points)), nearest]]
    normal = normal / np.linalg.norm(normal, axis=1)[:, None]
    other = np.eye(3)[np.abs(normal).argmin(axis=1)]
    first = np.cross(normal, other)
    first /= np.linalg.norm(first, axis=1)[:, None]
    second = np.cross(normal, first)
    reach = distances[:, -1:] if count == _NEIGHBOURS else 1.5 * distances[:, -1:]
    arms = (vertices[near] - points[:, None]) / reach[:, :, None]
    s, t = np.einsum("pkx,px->pk", arms, first), np.einsum("pkx,px->pk", arms, second)
    ratio = distances / reach
    importance = (1.0 - ratio) ** 2 / (ratio**2 + _AT**2)
    importance = np.where(np.einsum("pkx,px->pk", normals[near], normal) > 0.0, importance, 0.0)
    affine = np.stack([np.ones_like(s), s, t], axis=2)
    quadratic = np.stack([s * s, np.sqrt(2.0) * s * t, t * t], axis=2)  # of one length in whichever axes
    return members[near], _least_squares(importance, affine, quadratic)


def _along_surface(
    vertices: Array, corners: Index, points: Array, own: Index, found: tuple[Index, Array]
) -> tuple[Index, Array]:
    """Nearest vertices (p, k) and their distances (p, k), without those ``found`` that other layers of the patch have.

    ``own`` (p,) are the points' triangles, of those with the ``corners`` (t, 3).
    """
    pairs = np.unique(np.sort(corners[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    lengths = np.linalg.norm(vertices[pairs[:, 0]] - vertices[pairs[:, 1]], axis=1)
    graph = sps.csr_array((lengths, (pairs[:, 0], pairs[:, 1])), shape=(len(vertices),) * 2)
    rings = sps.csr_array(sps.eye_array(len(vertices)) + (graph + graph.T).astype(bool), dtype=bool)
    reached = rings
    for _ in range(_RINGS - 1):
        reached = reached @ rings
    around = np.asarray(cKDTree(vertices).query(vertices, k=min(_ROUND, len(vertices)))[1])
    starts = np.arange(0, around.size + 1, around.shape[1])
    asked = sps.csr_array((np.ones(around.size, bool), around.ravel(), starts), shape=rings.shape)
    if reached.multiply(asked).nnz == around.size:
        return found
    near, distances = found[0].copy(), found[1].copy()
    for triangle in np.unique(own):
        rows = np.flatnonzero(own == triangle)
        ways = dijkstra(graph, directed=False, indices=corners[triangle], min_only=True)
        edge = np.linalg.norm(np.ptp(vertices[corners[triangle]], axis=0))
        other = ways[near[rows]] > _DETOUR * distances[rows] + edge
        rows = rows[other.any(axis=1)]
        if not rows.size:
            continue
        straight = np.linalg.norm(vertices - points[rows, None], axis=2)
        straight[ways > _DETOUR * straight + edge] = np.inf
        order = np.argsort(straight, axis=1, kind="stable")[:, :_NEIGHBOURS]
        kept = np.take_along_axis(straight, order, axis=1)
        farthest = np.where(np.isfinite(kept), kept, 0.0).max(axis=1, keepdims=True)
        near[rows], distances[rows] = order, np.minimum(kept, farthest)  # the weight of the farthest is zero
    return near, distances


def _least_squares(importance: Array, affine: Array, quadratic: Array) -> Array:
    """Least weights (p, k) that reproduce the affine fields (p, k, 3) at the origin, and the quadratic if they can."""
    # By singular values of the weighted fields: products of them would lose half the digits next to a coarse vertex.
    root = np.sqrt(importance)[:, :, None]
    affine, quadratic = root * affine, root * quadratic
    own, sizes, turns = np.linalg.svd(affine, full_matrices=False)
    unit = np.einsum(
        "pki,pi->pk", own, _inverse(sizes, 1e-5 * sizes[:, :1]) * turns[:, :, 0]
    )  # the affine fields alone
    rest = quadratic - own @ (np.swapaxes(own, 1, 2) @ quadratic)
    own, sizes, turns = np.linalg.svd(rest, full_matrices=False)
    least = np.sqrt(_INDEPENDENT * np.square(quadratic).sum(axis=(1, 2))[:, None])
    wanted = -np.einsum("pij,pkj,pk->pi", turns, quadratic, unit)  # quadratic fields are zero at the origin
    return np.asarray(root[:, :, 0] * (unit + np.einsum("pki,pi->pk", own, _inverse(sizes, least) * wanted)))


def _inverse(values: Array, least: Array) -> Array:
    """Inverse of values that are above the least (p, 1), zero of the others."""
    kept = values > least
    return np.where(kept, 1.0 / np.where(kept, values, 1.0), 0.0)


def _stand_off(coarse: TriangleMesh, under: Index, offsets: Array) -> tuple[sps.csr_array, Array]:
    """Offsets (n, 3) in the frames of the triangles ``under``: weights of their corners, and heights (n,) [m]."""
    corners = coarse.faces[under]
    sides = coarse.vertices[corners[:, 1:]] - coarse.vertices[corners[:, :1]]
    normals = coarse.face_normals[under]
    frames = np.concatenate([sides, normals[:, None]], axis=1)
    parts = np.linalg.solve(np.swapaxes(frames, 1, 2), offsets[:, :, None])[:, :, 0]
    weights = np.stack([-parts[:, 0] - parts[:, 1], parts[:, 0], parts[:, 1]], axis=1)
    rows = np.repeat(np.arange(len(under)), 3)
    shape = len(under), len(coarse.vertices)
    return sps.csr_array((weights.ravel(), (rows, corners.ravel())), shape=shape), np.ascontiguousarray(parts[:, 2])
