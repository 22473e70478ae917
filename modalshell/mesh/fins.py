"""Fins: strips that stand on edges of a mesh while it is remeshed, so that these edges have three faces and stay.

MeshLab keeps boundaries, folds and edges of three and more faces; of others it knows nothing.
"""

from __future__ import annotations

import warnings
from itertools import pairwise

import numpy as np

from modalshell.core.errors import ModalShellWarning
from modalshell.mesh.closest import closest_points
from modalshell.mesh.topology import FloatArray, IntArray, connected_parts
from modalshell.mesh.triangle_mesh import TriangleMesh
from modalshell.mesh.welding import drop_unused


def with_fins(mesh: TriangleMesh, edges: IntArray, height: float) -> tuple[FloatArray, IntArray]:
    """Vertices and faces of ``mesh`` with a fin of ``height`` [m] along the normals on each of ``edges`` (k,)."""
    ends = mesh.edges[edges]
    feet, corners = np.unique(ends, return_inverse=True)
    normals = np.zeros((len(mesh.vertices), 3))
    for side in (0, 1):
        np.add.at(normals, ends, mesh.face_normals[mesh.edge_faces[edges, side]][:, None])
    up = normals[feet]
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    lengths = mesh.edge_lengths[edges]
    rows = int(np.clip(np.ceil(height / lengths.mean()), 1, 8))
    levels = [np.asarray(mesh.vertices)]
    levels += [mesh.vertices[feet] + height * row / rows * up for row in range(1, rows + 1)]
    numbers = [feet] + [len(mesh.vertices) + len(feet) * row + np.arange(len(feet)) for row in range(rows)]
    start, end = corners.reshape(-1, 2).T
    faces = [np.asarray(mesh.faces)]
    for low, high in pairwise(numbers):
        faces += [np.column_stack([low[start], low[end], high[end]])]
        faces += [np.column_stack([low[start], high[end], high[start]])]
    return np.vstack(levels), np.vstack(faces)


def without_fins(made: TriangleMesh, mesh: TriangleMesh, finned: tuple[FloatArray, IntArray]) -> TriangleMesh:
    """The remeshed ``made`` without its sheets that lie on fins: those of ``finned`` beyond the faces of ``mesh``."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModalShellWarning)  # of the winding of fins
        whole = TriangleMesh(*finned)
    inner = made.edge_faces[:, 1] >= 0
    inner[made.joints.edges] = False
    patches = connected_parts(made.edge_faces[inner], len(made.faces))
    centroids = made.vertices[made.faces].mean(axis=1)
    on_fin = closest_points(whole, centroids)[0] >= len(mesh.faces)
    shares = np.bincount(patches, made.face_areas * on_fin) / np.bincount(patches, made.face_areas)
    return TriangleMesh(*drop_unused(made.vertices, made.faces[shares[patches] < 0.5]))
