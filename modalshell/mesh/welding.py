"""Merging coincident vertices and dropping unused ones, on plain arrays.

trimesh merges vertices that round to one point of a grid: two close ones on both sides of a rounding bound stay apart.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from modalshell.checks import checked_number
from modalshell.errors import MeshError
from modalshell.mesh.topology import FloatArray, IntArray
from modalshell.mesh.validation import COINCIDENT, unused_vertices


def weld_arrays(
    vertices: FloatArray, faces: IntArray, tolerance: float | None = None
) -> tuple[FloatArray, IntArray, int]:
    """Merge vertices closer than `tolerance` into the first of each cluster.

    Parameters
    ----------
    vertices : (n, 3) float
        Positions [m].
    faces : (T, 3) int
        Vertex indices.
    tolerance : float, optional
        Merging distance [m]; 1e-8 of the bounding box's diagonal by default. Clusters merge transitively.

    Returns
    -------
    vertices, faces, dropped
        The merged mesh in the old order, and how many faces were dropped because two of their corners merged.
    """
    if tolerance is None:
        tolerance = COINCIDENT * float(np.linalg.norm(np.ptp(vertices, axis=0)))
    else:
        tolerance = checked_number("tolerance", tolerance, MeshError, at_least=0.0, unit="m")
    # Exact copies first: a k-d tree would list every pair among many copies of one point.
    points, inverse = np.unique(vertices, axis=0, return_inverse=True)
    pairs = cKDTree(points).query_pairs(tolerance, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs), dtype=np.int8), (pairs[:, 0], pairs[:, 1])), shape=(len(points),) * 2)
    _, cluster = connected_components(graph, directed=False)
    label = cluster[inverse.ravel()]
    representative = np.full(int(label.max()) + 1, len(vertices), dtype=np.int64)
    np.minimum.at(representative, label, np.arange(len(vertices)))
    merged = representative[label][faces]
    good = (merged != merged[:, [1, 2, 0]]).all(axis=1)
    if not good.any():
        raise MeshError(
            f"all {len(faces)} faces collapse at a merging tolerance of {tolerance:g} m; give a smaller one"
        )
    kept_vertices, kept_faces = drop_unused(vertices, merged[good])
    return kept_vertices, kept_faces, int((~good).sum())


def drop_unused(vertices: FloatArray, faces: IntArray) -> tuple[FloatArray, IntArray]:
    """Drop vertices that are in no face and renumber; the order of the rest stays."""
    unused = unused_vertices(faces, len(vertices))
    keep = np.ones(len(vertices), dtype=np.bool_)
    keep[unused] = False
    return vertices[keep], (np.cumsum(keep) - 1)[faces]
