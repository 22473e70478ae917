"""Coarse meshes of any shell's surface by remeshing, with vertices where its clamps end."""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from modalshell.core.errors import MeshError, ModalShellWarning, OptionError, SupportError
from modalshell.core.typing import Array, Index
from modalshell.mesh import TriangleMesh, remesh
from modalshell.mesh.closest import TOGETHER, closest_points, common_parts, nearest_on_segments
from modalshell.mesh.welding import drop_unused
from modalshell.models.coarse.prolongation import sharp_edges
from modalshell.models.coarse.taken_over import edges_to_keep
from modalshell.shell import Shell

_FEWEST = 8
"""Least number of triangles of the part that moves."""
_SAMPLES = np.array([0.1, 0.3, 0.5, 0.7, 0.9])
"""Shares of an edge's length at which its place on the boundary is looked for."""
_COINCIDENT = 1e-9
"""Distance, in sizes of the mesh, below which midpoints are those of one edge."""
_THIN, _TURNED = 0.02, 0.5
"""Least area of a triangle over the mean, and cosine of its turn, once vertices are moved onto clamped points."""
_CORNER = 0.2
"""Length of the sum of unit vectors along a clamped line both ways above which it has a corner, 11 degrees, or ends."""
_CUT_OFF, _AT_END = 0.05, 0.2
"""Distances of a clamped corner from a coarse edge and from its ends, in its lengths, from which it is cut off."""
_HEIGHT = 0.1
"""Least height of a held triangle over its edge's length."""

_NARROW = 0.25
"""Share of the surface in walls of one cell across from which a warning is given."""
_SAME = 1e-6
"""Relative distance and difference of areas below which a surface is the same."""


def remeshed_to_supports(shell: Shell, triangles: int) -> TriangleMesh:
    """The surface of ``shell`` in about ``triangles`` triangles, with an edge wherever its clamped region ends.

    The part that moves is remeshed alone, so that the line where the clamps end is a boundary of it. Each coarse edge
    there gets a held triangle on its other side, the hinge between them being the clamp. The clamped region itself
    follows as a further part, which bears the loads that act there; it has no unknowns. Vertices are moved onto clamped
    points and lines, and onto the ends and corners of clamped lines along the boundary. Junctions, creases and the
    bounds of regions keep edges along them. Walls between sharp folds or junctions that get one cell across have no
    shape of their own: a :class:`ModalShellWarning` says how much of the surface they are. OptionError if MeshLab is
    not installed (extra ``remesh``), or ``triangles`` is not fewer than the shell has. MeshError if MeshLab fails on
    this surface. SupportError if a clamp has no place on a mesh so coarse.
    """
    mesh = shell.mesh
    if triangles >= len(mesh.faces):
        raise OptionError(
            f"triangles must be fewer than the {len(mesh.faces)} of the shell for a coarse mesh (got {triangles})"
        )
    held: NDArray[np.bool_] = np.all(shell.clamped[mesh.faces], axis=1)
    points = shell.clamped.copy()
    points[mesh.faces[held]] = False
    rim = mesh.edges[mesh.edge_faces[:, 1] < 0]
    rim = rim[np.all(shell.clamped[rim], axis=1)]
    # The coarse mesh keeps the boundary, but not the vertices along it.
    corners = mesh.vertices[points & _turns(mesh, rim)]
    points[rim] = False
    places = mesh.vertices[points]
    keep = edges_to_keep(shell)
    if not held.any():
        return _held_at(_with_wide_walls(_remeshed(mesh, triangles, mesh.edges[keep])), places, corners)
    if held.all():
        raise SupportError("every triangle of the shell is clamped: nothing is left to remesh")
    moving = _part(mesh, ~held)
    count = max(_FEWEST, round(triangles * moving.area / mesh.area))
    coarse = _held_at(_with_wide_walls(_remeshed(moving, count, _pairs_in(mesh, ~held, keep))), places, corners)
    edges = _edges_along(coarse, moving, _clamp_line(mesh, held))
    if not len(edges):
        raise SupportError(f"the clamped line is lost on a mesh of {triangles} triangles: ask for more")
    fixed = _part(mesh, held)
    vertices, faces = _with_held_triangles(coarse, edges, np.asarray(fixed.vertices))
    fixed = _fewer_held(shell, fixed, round(triangles * fixed.area / mesh.area))
    with warnings.catch_warnings(action="ignore", category=ModalShellWarning):  # of the seam, which is meant
        return TriangleMesh(
            np.concatenate([vertices, fixed.vertices]), np.concatenate([faces, fixed.faces + len(vertices)])
        )


def places_on(shell: Shell, mesh: TriangleMesh) -> tuple[Index, Array, NDArray[np.bool_]]:
    """Nearest triangles (k,) of ``shell`` to a coarse mesh's vertices, barycentric shares (k, 3), and whether clamped.

    A vertex is clamped where the nearest corner of its triangle is, or one of several as near, as at the middle of an
    edge: the same vertices whichever way the mesh is turned.
    """
    nearest, shares, _ = closest_points(shell.mesh, mesh.vertices, common_parts(shell.mesh, mesh))
    near = shares >= shares.max(axis=1, keepdims=True) - TOGETHER
    return nearest, shares, (near & shell.clamped[shell.mesh.faces[nearest]]).any(axis=1)


def drawn_to_supports(shell: Shell, mesh: TriangleMesh) -> TriangleMesh:
    """A coarse mesh with a second row of vertices where the held region of ``shell`` ends.

    With one held row it would be hinged where the fine shell is clamped. The neighbours of that row are moved to the
    nearest points of held edges. The other vertices follow, the farthest not at all, where that keeps the surface and
    its outline: rows stay evenly apart.
    """
    held = places_on(shell, mesh)[2]
    if not held.any() or held[mesh.faces].all(axis=1).any():
        return mesh
    beside = np.zeros(len(held), dtype=bool)
    beside[mesh.faces[held[mesh.faces].any(axis=1)]] = True
    beside &= ~held
    edges = shell.mesh.edges[shell.clamped[shell.mesh.edges].all(axis=1)]
    if not beside.any() or len(edges) == 0:
        return mesh
    row = mesh.vertices[beside]
    moves = nearest_on_segments(shell.rest_positions[edges], row)[1] - row
    drawn = np.array(mesh.vertices)
    drawn[beside] += moves
    try:
        moved = TriangleMesh(drawn, mesh.faces)
    except MeshError:  # the fine shell has one held row too
        return mesh
    if moved.face_areas.min() <= 0.02 * moved.face_areas.mean():
        return mesh
    rest = ~held & ~beside
    distances, leaders = (np.asarray(found) for found in cKDTree(row).query(mesh.vertices[rest]))
    drawn[rest] += (1.0 - distances / distances.max(initial=0.0))[:, None] * moves[leaders]
    try:
        even = TriangleMesh(drawn, mesh.faces)
    except MeshError:
        return moved
    off = closest_points(shell.mesh, even.vertices)[2].max() / mesh.size
    grown = abs(even.face_areas.sum() / moved.face_areas.sum() - 1.0)
    return even if max(off, grown) < _SAME else moved


def _turns(mesh: TriangleMesh, edges: Index) -> NDArray[np.bool_]:
    """Whether each vertex (n,) is an end or a corner of the lines that some ``edges`` (k, 2) make."""
    ways = mesh.vertices[edges[:, 1]] - mesh.vertices[edges[:, 0]]
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    sums = np.zeros((len(mesh.vertices), 3))
    np.add.at(sums, edges[:, 0], ways)
    np.subtract.at(sums, edges[:, 1], ways)
    return np.asarray(np.linalg.norm(sums, axis=1) > _CORNER)


def _held_at(mesh: TriangleMesh, places: Array, corners: Array) -> TriangleMesh:
    """``mesh`` with vertices at clamped ``places`` (p, 3), and at ``corners`` (k, 3) of its boundary if it has room."""
    try:
        return _drawn_to(_divided_at(mesh, corners), np.concatenate([places, corners]))
    except SupportError:
        return _drawn_to(mesh, places)


def _divided_at(mesh: TriangleMesh, corners: Array) -> TriangleMesh:
    """``mesh`` with edges of its boundary divided, one of a triangle, where they cut off ``corners`` (k, 3)."""
    outer = np.flatnonzero(mesh.edge_faces[:, 1] < 0)
    if not len(corners) or not outer.size:
        return mesh
    ends = mesh.vertices[mesh.edges[outer]]
    chosen, places = nearest_on_segments(ends, corners)
    lengths, off = mesh.edge_lengths[outer[chosen]], np.linalg.norm(corners - places, axis=1)
    near = np.linalg.norm(ends[chosen] - corners[:, None], axis=2).min(axis=1)
    cut = np.flatnonzero((off > _CUT_OFF * lengths) & (near > _AT_END * lengths))
    cut = cut[np.argsort(-off[cut], kind="stable")]
    faces = mesh.edge_faces[outer[chosen[cut]], 0]
    once = np.unique(faces, return_index=True)[1]
    if not once.size:
        return mesh
    cut, faces = cut[once], faces[once]
    first = mesh.edge_corners[outer[chosen[cut]], 0]
    a, b, c = (mesh.faces[faces, (first + k) % 3] for k in range(3))
    new = len(mesh.vertices) + np.arange(cut.size)
    rest = np.delete(mesh.faces, faces, axis=0)
    halves = np.column_stack([a, new, c]), np.column_stack([new, b, c])
    return TriangleMesh(np.concatenate([mesh.vertices, places[cut]]), np.concatenate([rest, *halves]))


def _drawn_to(mesh: TriangleMesh, places: Array) -> TriangleMesh:
    """``mesh`` with its vertices nearest to ``places`` (p, 3), clamped points and lines, moved onto them."""
    if not len(places):
        return mesh
    nearest = np.unique(cKDTree(mesh.vertices).query(places)[1])
    vertices = np.array(mesh.vertices)
    vertices[nearest] = places[cKDTree(places).query(vertices[nearest])[1]]
    try:
        moved = TriangleMesh(vertices, mesh.faces)
    except MeshError:
        moved = None
    if (
        moved is None
        or moved.face_areas.min() < _THIN * moved.face_areas.mean()
        or bool((np.sum(moved.face_normals * mesh.face_normals, axis=1) < _TURNED).any())
    ):
        raise SupportError(
            "the clamped points and lines of the shell have no place on a mesh so coarse: ask for another number of "
            "triangles, or give a mesh with vertices there"
        )
    return moved


def _fewer_held(shell: Shell, fixed: TriangleMesh, triangles: int) -> TriangleMesh:
    """The clamped region ``fixed`` in about ``triangles``, if all their corners lie on clamped vertices then."""
    if len(fixed.faces) <= max(_FEWEST, triangles):
        return fixed
    with warnings.catch_warnings(action="ignore", category=ModalShellWarning):  # of the triangles' number
        try:
            found = remesh(fixed, max(_FEWEST, triangles))
        except MeshError:
            return fixed
    fewer = len(found.faces) < len(fixed.faces)
    return found if fewer and bool(places_on(shell, found)[2].all()) else fixed


def _part(mesh: TriangleMesh, chosen: NDArray[np.bool_]) -> TriangleMesh:
    """The chosen (T,) triangles of a mesh."""
    with warnings.catch_warnings(action="ignore", category=ModalShellWarning):
        return TriangleMesh(*drop_unused(mesh.vertices, mesh.faces[chosen]))


def _remeshed(mesh: TriangleMesh, triangles: int, keep: Index) -> TriangleMesh:
    """``mesh`` with edges along pairs ``keep`` (k, 2) of its vertices."""
    return remesh(mesh, triangles, keep=keep) if len(keep) else remesh(mesh, triangles)


def _with_wide_walls(mesh: TriangleMesh) -> TriangleMesh:
    """``mesh``; a warning where walls that begin at a sharp fold or junction have one cell across."""
    inner, sharp = sharp_edges(mesh)
    at_fold, at_end = np.zeros((2, len(mesh.vertices)), dtype=bool)
    at_fold[mesh.edges[inner[sharp]]] = True
    at_end[mesh.edges[np.delete(np.arange(len(mesh.edges)), inner)]] = True
    narrow = (at_fold | at_end)[mesh.faces].all(axis=1) & at_fold[mesh.faces].any(axis=1)
    share = float(mesh.face_areas[narrow].sum() / mesh.area)
    if share > _NARROW:
        warnings.warn(
            f"{100.0 * share:.0f} % of the coarse surface, of {len(mesh.faces)} triangles, lies in walls of one cell "
            "across, which hardly bend between their edges: ask for more triangles, or give a mesh of two cells across",
            ModalShellWarning,
            stacklevel=4,
        )
    return mesh


def _pairs_in(mesh: TriangleMesh, chosen: NDArray[np.bool_], edges: Index) -> Index:
    """Pairs (k, 2) of vertices, as numbered in :func:`_part`, of those of ``edges`` that its triangles have."""
    inside = np.bincount(mesh.faces[chosen].ravel(), minlength=len(mesh.vertices)) > 0
    kept = np.intersect1d(edges, mesh.face_edges[chosen])
    return np.asarray((np.cumsum(inside) - 1)[mesh.edges[kept]])


def _clamp_line(mesh: TriangleMesh, held: NDArray[np.bool_]) -> Array:
    """Ends (k, 2, 3) [m] of the edges between held (T,) and other triangles."""
    count = len(mesh.edges)
    some = np.bincount(mesh.face_edges[held].ravel(), minlength=count) > 0
    other = np.bincount(mesh.face_edges[~held].ravel(), minlength=count) > 0
    return np.asarray(mesh.vertices[mesh.edges[some & other]])


def _edges_along(coarse: TriangleMesh, fine: TriangleMesh, line: Array) -> Index:
    """Indices of the boundary edges of ``coarse`` that lie on the ``line`` (k, 2, 3), a part of ``fine``'s boundary."""
    rim = fine.vertices[fine.edges[fine.edge_faces[:, 1] < 0]]
    apart = cKDTree(line.mean(axis=1)).query(rim.mean(axis=1))[0]
    others = rim[apart > _COINCIDENT * fine.size]
    outer = np.flatnonzero(coarse.edge_faces[:, 1] < 0)
    points = _along(coarse.vertices[coarse.edges[outer]])
    near = cKDTree(_along(line).reshape(-1, 3)).query(points)[0]
    if not len(others):
        return outer
    far = cKDTree(_along(others).reshape(-1, 3)).query(points)[0]
    return np.asarray(outer[np.count_nonzero(near < far, axis=1) * 2 > points.shape[1]])


def _along(ends: Array) -> Array:
    """Points (k, s, 3) along segments (k, 2, 3)."""
    shares = _SAMPLES[:, None]
    return np.asarray((1.0 - shares) * ends[:, None, 0] + shares * ends[:, None, 1])


def _with_held_triangles(coarse: TriangleMesh, edges: Index, places: Array) -> tuple[Array, Index]:
    """Vertices and faces of ``coarse`` with a triangle beyond each of its boundary ``edges``.

    Its further corner is one of ``places`` (p, 3), that nearest to the mirror image of the corner on this side.
    """
    inner = coarse.faces[coarse.edge_faces[edges, 0]]
    rows = np.arange(len(edges))
    first, second, opposite = (inner[rows, (coarse.edge_corners[edges, 0] + k) % 3] for k in range(3))
    a, b, c = (coarse.vertices[corner] for corner in (first, second, opposite))
    along = b - a
    length = np.linalg.norm(along, axis=1)
    apexes = np.empty_like(a)
    for k, wanted in enumerate(a + b - c):
        arms = places - a[k]
        heights = np.linalg.norm(np.cross(arms, along[k]), axis=1) / length[k]
        distance = np.linalg.norm(places - wanted, axis=1)
        distance[heights < _HEIGHT * length[k]] = np.inf
        if not np.isfinite(distance).any():
            raise SupportError("the clamped region is too narrow for a mesh so coarse: ask for more triangles")
        apexes[k] = places[distance.argmin()]
    beyond = np.column_stack([second, first, len(coarse.vertices) + rows])
    return np.concatenate([coarse.vertices, apexes]), np.concatenate([coarse.faces, beyond])
