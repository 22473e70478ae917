"""Lloyd relaxation: point sets with near-equilateral Delaunay triangles and no lattice direction."""

from __future__ import annotations

import numpy as np
from scipy.spatial import Delaunay, Voronoi

from modalshell.core.typing import Array, Index

_ITERATIONS = 20


def relax_in_rectangle(interior: Array, fixed: Array, length: float, width: float) -> Array:
    """Move `interior` points (p, 2) [m] to the centroids of their Voronoi cells within the rectangle.

    Interior points are mirrored across the four sides, which clips every cell exactly at the sides; `fixed` points
    (b, 2) on the boundary take part and stay.
    """
    points = interior.copy()
    if len(points) == 0:
        return points
    reach = 4.0 * np.sqrt(length * width / len(points))  # farther mirror images touch no cell
    for _ in range(_ITERATIONS):
        images = [fixed]
        for axis, side in ((0, 0.0), (0, length), (1, 0.0), (1, width)):
            near = points[np.abs(points[:, axis] - side) < reach].copy()
            near[:, axis] = 2.0 * side - near[:, axis]
            images.append(near)
        points = _cell_centroids(points, np.vstack(images))
    return points


def _cell_centroids(points: Array, others: Array) -> Array:
    diagram = Voronoi(np.vstack((points, others)))
    ridges = np.asarray(diagram.ridge_vertices)
    finite = (ridges >= 0).all(axis=1)
    ends = diagram.vertices[ridges[finite]]
    area = np.zeros(len(points))
    moment = np.zeros_like(points)
    for side in (0, 1):
        # A cell is convex around its point, so it is the union of the triangles from the point to each ridge.
        owner = diagram.ridge_points[finite, side]
        mine = owner < len(points)
        cell = owner[mine]
        a, b, p = ends[mine, 0], ends[mine, 1], points[cell]
        part = 0.5 * np.abs((a - p)[:, 0] * (b - p)[:, 1] - (a - p)[:, 1] * (b - p)[:, 0])
        area += np.bincount(cell, part, len(points))
        for axis in (0, 1):
            moment[:, axis] += np.bincount(cell, part * (a + b + p)[:, axis] / 3.0, len(points))
    return moment / area[:, None]


def delaunay_faces(points: Array, sliver: float) -> Index:
    """Delaunay triangles (T, 3) of points (n, 2), counter-clockwise, without those of area [m^2] up to `sliver`."""
    faces = Delaunay(points).simplices.astype(np.int64)
    area = signed_areas(points, faces)
    faces = np.where((area < 0)[:, None], faces[:, [0, 2, 1]], faces)[np.abs(area) > sliver]
    return faces[np.lexsort(np.sort(faces, axis=1).T[::-1])]


def signed_areas(points: Array, faces: Index) -> Array:
    """Signed areas [m^2] of plane triangles, shape (T,), positive when counter-clockwise."""
    a, b, c = points[faces[:, 0]], points[faces[:, 1]], points[faces[:, 2]]
    u, v = b - a, c - a
    return 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
