"""Merging of coincident vertices, and removal of unused ones, on plain arrays.

trimesh merges vertices that round to one point of a grid: two close ones on both sides of a rounding bound stay apart.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from modalshell.core.checks import checked_number
from modalshell.core.errors import MeshError
from modalshell.core.typing import Array, Index
from modalshell.mesh.topology import connected_parts
from modalshell.mesh.validation import COINCIDENT, DEGENERATE, degenerate

_ROUNDS = 50
"""Number of passes that repair flat faces: each repairs all except neighbours of repaired ones."""


def weld_arrays(vertices: Array, faces: Index, tolerance: float | None = None) -> tuple[Array, Index, int]:
    """Merge vertices (n, 3) closer than ``tolerance`` [m] into the first of each cluster; clusters merge transitively.

    The tolerance is 1e-8 of the bounding box's diagonal by default.

    Returns
    -------
    vertices, faces, dropped
        The merged mesh in the old order, and the number of faces dropped because two corners merged.
    """
    if tolerance is None:
        tolerance = COINCIDENT * float(np.linalg.norm(np.ptp(vertices, axis=0)))
    else:
        tolerance = checked_number("tolerance", tolerance, MeshError, at_least=0.0, unit="m")
    # Exact copies first: a k-d tree would list every pair among many copies of one point.
    first, inverse = _distinct(vertices)
    pairs = cKDTree(vertices[first]).query_pairs(tolerance, output_type="ndarray")
    label = connected_parts(pairs, len(first))
    representative = np.full(int(label.max()) + 1, len(vertices), dtype=np.int64)
    np.minimum.at(representative, label, first)
    merged = representative[label][inverse][faces]
    good = (merged != merged[:, [1, 2, 0]]).all(axis=1)
    if not good.any():
        raise MeshError(
            f"all {len(faces)} faces collapse at a merging tolerance of {tolerance:g} m; give a smaller one"
        )
    kept_vertices, kept_faces = drop_unused(vertices, merged[good])
    return kept_vertices, kept_faces, int((~good).sum())


def _distinct(vertices: Array) -> tuple[Index, Index]:
    """The first of each group of equal vertices, and the group of every vertex (n,)."""
    # Sorting one number for each is far faster than sorting rows.
    _, first, inverse = np.unique(_keys(vertices), return_index=True, return_inverse=True)
    if not np.array_equal(vertices[first][inverse], vertices):  # two points have one number
        _, first, inverse = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    return first, inverse.ravel()


def _keys(vertices: Array) -> NDArray[np.uint64]:
    """A number for each vertex (n,), the same for equal ones."""
    keys = np.zeros(len(vertices), dtype=np.uint64)
    for bits in (vertices + 0.0).view(np.uint64).T:  # of -0 those of 0
        keys = (keys ^ bits) * np.uint64(0x9E3779B97F4A7C15)
        keys ^= keys >> np.uint64(32)
    return keys


def without_flat_faces(vertices: Array, faces: Index, limit: float = DEGENERATE) -> Index:
    """Faces (T, 3) without those that have no area, or no height above ``limit``, although their corners differ.

    A corner of such a face lies on its longest edge. The neighbour over that edge is split there, so that no crack
    opens; without a neighbour the face is dropped. Others, such as those where three faces meet, stay.
    """
    for _ in range(_ROUNDS):
        gone = np.zeros(len(faces), dtype=np.bool_)
        halves: list[Index] = []
        for face in np.flatnonzero(degenerate(vertices, faces, limit)):
            corners = faces[face]
            opposite = np.linalg.norm(vertices[np.roll(corners, -1)] - vertices[np.roll(corners, -2)], axis=1)
            middle, start, end = np.roll(corners, -int(opposite.argmax()))
            holders = np.flatnonzero((faces == start).any(axis=1) & (faces == end).any(axis=1))
            if len(holders) > 2 or gone[holders].any():
                continue
            gone[holders] = True
            for neighbour in faces[holders[holders != face]]:
                if middle not in neighbour:
                    halves += [np.where(neighbour == corner, middle, neighbour) for corner in (start, end)]
        if not gone.any():
            break
        faces = np.concatenate((faces[~gone], np.array(halves, dtype=np.int64).reshape(-1, 3)))
    return faces


def without_needles(vertices: Array, faces: Index, limit: float) -> Index:
    """Faces (T, 3) without those of a height of at most ``limit`` times their length.

    The ends of their short edges become one vertex; where there is no short edge, the neighbour over the longest is
    split as :func:`without_flat_faces` does.
    """
    for _ in range(_ROUNDS):
        thin = faces[degenerate(vertices, faces, limit)]
        if not len(thin):
            break
        lengths = np.linalg.norm(vertices[thin[:, [1, 2, 0]]] - vertices[thin], axis=2)
        side = lengths.argmin(axis=1)
        row = np.arange(len(thin))
        short = lengths[row, side] <= 3.0 * limit * lengths.max(axis=1)
        ends = np.stack((thin[row, side], thin[row, (side + 1) % 3]))[:, short]
        if ends.size:
            cluster = connected_parts(ends.T, len(vertices))
            _, first = np.unique(cluster, return_index=True)
            faces = first[cluster][faces]
            faces = faces[(faces != faces[:, [1, 2, 0]]).all(axis=1)]
        else:
            faces = without_flat_faces(vertices, faces, limit)
    return faces


def drop_unused(vertices: Array, faces: Index) -> tuple[Array, Index]:
    """Drop vertices that are in no face and renumber; the order of the rest stays."""
    keep = np.bincount(faces.ravel(), minlength=len(vertices)) > 0
    return vertices[keep], (np.cumsum(keep) - 1)[faces]
