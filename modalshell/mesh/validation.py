"""Validation of triangle meshes: each fault is reported with its first offending indices."""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from modalshell.core.checks import as_array
from modalshell.core.errors import REPAIR, MeshError, ModalShellWarning
from modalshell.core.in_parts import fill_in_parts
from modalshell.core.typing import Array, Index, Mask
from modalshell.mesh.sheets import faces_to_flip
from modalshell.mesh.topology import HalfEdges, half_edges

# Twice a triangle's area over its longest edge squared is about its height over its length: 1e-12 lets valid needles of
# aspect 1e6 through and stops collinear corners whose height is rounding alone.
DEGENERATE = 1e-12
LARGEST = 1e100  # [m]
COINCIDENT = 1e-8  # of the bounding box's diagonal
FARTHEST = 1e9  # distance from the origin, in lengths of the mesh


def as_vertices(vertices: ArrayLike) -> Array:
    """Copy `vertices` to a finite (n, 3) float64 array, or raise MeshError."""
    array = as_array("vertices", vertices, "an array (n, 3) of real numbers [m]", MeshError)
    if array.size == 0:
        raise MeshError(f"the mesh has no vertices (got shape {array.shape}); give an (n, 3) array with n >= 3")
    if array.ndim != 2 or array.shape[1] != 3:
        mend = "; add the third coordinate with np.column_stack((points, np.zeros(len(points))))"
        raise MeshError(f"vertices must have shape (n, 3), got {array.shape}{mend if array.shape[1:] == (2,) else ''}")
    result = np.array(array, dtype=np.float64, order="C")
    bad = np.flatnonzero(~np.isfinite(result).all(axis=1))
    if len(bad):
        raise MeshError(
            f"vertex {bad[0]} (counted from 0) is not finite: {result[bad[0]].tolist()}{_more(len(bad), 'vertices')}; "
            f"every coordinate must be finite: correct or remove these vertices, or drop their faces by {REPAIR}"
        )
    far = np.flatnonzero((np.abs(result) > LARGEST).any(axis=1))
    if len(far):
        raise MeshError(
            f"vertex {far[0]} (counted from 0) lies at {result[far[0]].tolist()}{_more(len(far), 'vertices')}; "
            f"coordinates beyond {LARGEST:g} overflow in the energies: scale the mesh to metres"
        )
    size = float(np.ptp(result, axis=0).max())
    if size < 1.0 / LARGEST:
        raise MeshError(
            f"all vertices lie within {size:g} m (got {len(result)}), where areas underflow: scale the mesh to metres"
        )
    away = float(np.abs(result).max())
    if away > FARTHEST * size:
        raise MeshError(
            f"the mesh is {size:.3g} m long and lies {away:.3g} m from the origin, where rounding has taken its shape "
            f"(got {away / size:.1g} of its lengths, at most {FARTHEST:g}): subtract its mean position, "
            f"as {REPAIR} does"
        )
    return result


def as_faces(faces: ArrayLike, vertex_count: int) -> Index:
    """Copy `faces` to a (T, 3) int64 array with indices in [0, vertex_count), or raise MeshError."""
    array = as_array("faces", faces, "an array (T, 3) of vertex indices", MeshError)
    if array.size == 0:
        raise MeshError(
            f"the mesh has vertices and no faces (got shape {array.shape}); give a (T, 3) array of vertex indices"
        )
    if array.ndim != 2 or array.shape[1] != 3:
        mend = f"; split the quads into triangles first, by {REPAIR}" if array.shape[1:] == (4,) else ""
        raise MeshError(f"faces must have shape (T, 3), got {array.shape}{mend}")
    if array.dtype.kind == "f":
        bad = np.flatnonzero(~((array == np.round(array)) & (np.abs(array) < 2**53)).all(axis=1))
        if len(bad):
            raise MeshError(
                f"face {bad[0]} (counted from 0) holds {array[bad[0]].tolist()}{_more(len(bad), 'faces')}; "
                "faces must hold whole numbers, the indices of their vertices"
            )
    bad = np.flatnonzero(((array < 0) | (array >= vertex_count)).any(axis=1))
    if len(bad):
        index = next(int(i) for i in array[bad[0]] if not 0 <= i < vertex_count)
        raise MeshError(
            f"face {bad[0]} names vertex {index}, out of range (both counted from 0): the mesh has {vertex_count} "
            f"vertices, 0 to {vertex_count - 1}{_more(len(bad), 'faces')}; correct the face or remove it, or drop "
            f"such faces by {REPAIR}"
        )
    return np.array(array, dtype=np.int64, order="C")


def check_faces(vertices: Array, faces: Index) -> None:
    """Reject faces that repeat a vertex, have no area or are duplicates."""
    repeats = (faces == faces[:, [1, 2, 0]]).any(axis=1)
    bad = np.flatnonzero(repeats | degenerate(vertices, faces))
    if len(bad):
        fault = "repeats a vertex" if repeats[bad[0]] else "has zero area: its corners lie on one line"
        raise MeshError(
            f"face {bad[0]}, vertices {_row(faces[bad[0]])} (counted from 0), is degenerate: it {fault}"
            f"{_more(len(bad), 'faces')}; repair such faces by {REPAIR}, or "
            "remove them"
        )
    corners = np.sort(faces, axis=1)
    order = np.lexsort(corners.T)
    same = np.flatnonzero((corners[order[1:]] == corners[order[:-1]]).all(axis=1))
    if len(same):
        copies = order[same + 1]  # lexsort is stable, so within a pair the later face comes second
        where = int(np.argmin(copies))
        raise MeshError(
            f"face {copies[where]} is a duplicate of face {order[same[where]]}, vertices {_row(faces[copies[where]])} "
            f"(counted from 0){_more(len(same), 'faces')}; keep one of each, as {REPAIR} does"
        )


def paired_edges(faces: Index, vertex_count: int) -> tuple[Index, HalfEdges]:
    """Faces wound consistently wherever two meet at an edge, and their half-edges."""
    links = half_edges(faces, vertex_count)
    flip = faces_to_flip(links)
    if flip.any():
        faces = np.where(flip[:, None], faces[:, [0, 2, 1]], faces)
        links = half_edges(faces, vertex_count)
        warnings.warn(
            f"flipped {int(flip.sum())} of {len(faces)} faces (first: face {int(np.argmax(flip))}, counted from 0) to "
            "make the winding consistent; wind the faces the same way round to silence this",
            ModalShellWarning,
            stacklevel=3,
        )
    return faces, links


def unused_vertices(faces: Index, vertex_count: int) -> Index:
    """Return the indices of the vertices in no face, ascending."""
    return np.flatnonzero(np.bincount(faces.ravel(), minlength=vertex_count) == 0).astype(np.int64)


def check_used(faces: Index, vertex_count: int) -> None:
    """Reject vertices in no face: they would have no mass."""
    unused = unused_vertices(faces, vertex_count)
    if len(unused):
        raise MeshError(
            f"vertex {unused[0]} (counted from 0) belongs to no face{_more(len(unused), 'vertices')} and would have no "
            f"mass; drop such vertices by {REPAIR}"
        )


def warn_of_seams(vertices: Array, boundary: Index) -> None:
    """Warn of coincident but distinct boundary vertices, along which the shell would fall apart."""
    if len(boundary) < 2:
        return
    points = vertices[boundary]
    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    distance, nearest = cKDTree(points).query(points, k=2, distance_upper_bound=max(COINCIDENT * diagonal, 1e-300))
    twins = np.flatnonzero(np.isfinite(np.asarray(distance)[:, 1]))
    if len(twins):
        i = int(twins[0])
        partner = next(int(j) for j in np.asarray(nearest)[i] if j != i)
        warnings.warn(
            f"{len(twins)} boundary vertices coincide with another one, first vertices {boundary[i]} and "
            f"{boundary[partner]} (counted from 0): the shell is cut open along that seam; "
            "join it with mesh = mesh.weld() (--join, or join = 1e-6 in [mesh]), or leave it if the cut is meant",
            ModalShellWarning,
            stacklevel=3,
        )


def degenerate(vertices: Array, faces: Index, limit: float = DEGENERATE) -> Mask:
    """Which faces (T,) have a height of at most ``limit`` times their length; without it, those without area."""
    flat = np.empty(len(faces), dtype=np.bool_)
    fill_in_parts(flat, lambda own: _degenerate(vertices[own], limit), faces)
    return flat


def _degenerate(corners: Array, limit: float) -> Mask:
    sides = corners[:, [1, 2, 0]] - corners
    # Each triangle is brought to unit size first, so that no product under- or overflows.
    size = np.abs(sides).max(axis=(1, 2))
    sides = sides / np.where(size > 0, size, 1.0)[:, None, None]
    longest = np.einsum("tki,tki->tk", sides, sides).max(axis=1)
    twice_area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    return np.asarray(twice_area <= limit * longest, dtype=np.bool_)


def _more(count: int, noun: str) -> str:
    return f" (the first of {count} such {noun})" if count > 1 else ""


def _row(indices: Index) -> str:
    return f"({', '.join(str(i) for i in indices.tolist())})"
