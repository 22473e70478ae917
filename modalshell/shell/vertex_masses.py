"""Vertex masses that integrate smooth motions to second order, up to free edges and sharp folds."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np

from modalshell.core.in_parts import fill_in_parts
from modalshell.core.typing import Array, Index, Mask
from modalshell.linalg.elements import assembled
from modalshell.mesh import TriangleMesh
from modalshell.mesh.topology import connected_parts
from modalshell.shell.material import Material
from modalshell.shell.sheet import Sheet
from modalshell.shell.smoothed_membrane import SHARP
from modalshell.supports import Support

_LEAST = 0.25
"""Least mass of a vertex, over a third of that of its triangles."""


def masses_of(mesh: TriangleMesh, material: Material | Sheet, held: Mask, supports: Sequence[Support]) -> Array:
    """Masses (n,) [kg] of a shell's vertices: thirds of the triangles' on hinges, else :func:`vertex_masses`."""
    density = material.area_density(mesh)
    if isinstance(material, Material):
        return mesh.shared_among_corners(density * mesh.face_areas)
    return vertex_masses(mesh, density, held, supports)


def vertex_masses(mesh: TriangleMesh, density: Array, held: Mask, supports: Sequence[Support] = ()) -> Array:
    """Masses (n,) [kg] of the vertices, for a mass per area (T,) [kg/m^2].

    A third of each triangle's mass at each corner integrates linear functions. Its errors for curved ones cancel
    between neighbours, but not along edges: the rotary inertia of a strip of n cells is too large by 2 / n^2, and
    torsional frequencies too low by 1 / n^2. Here the integral is that of the middles of the sides, ``A / 3 sum f``,
    where ``f = (f_a + f_b) / 2 + (grad f_a - grad f_b) . (x_b - x_a) / 8`` by cubic Hermite interpolation, as the
    trapezoidal rule's end correction. Gradients at a corner are the mean over the triangles that meet there without a
    sharp fold. Those of a kinetic energy are zero where the vertices (n,) are held, and have no part across the planes
    of symmetry among the supports. The sum of the masses is exact, and no vertex has less than a quarter of its thirds
    (theory 7, eq. 3 to 6).
    """
    thirds = mesh.shared_among_corners(density * mesh.face_areas)
    corners = _joined_corners(mesh)
    count, areas = int(corners.max()) + 1, mesh.face_areas

    def gathered(values: Array) -> Array:
        """Sums (count, ...) over the groups of values (T, 3, ...) at corners."""
        return np.stack(
            [np.bincount(corners.ravel(), one.ravel(), count) for one in np.moveaxis(values, -1, 0)], axis=1
        )

    values = np.empty((*corners.shape, 3))
    fill_in_parts(values, functools.partial(_reach, mesh), mesh.faces, density * areas / 24.0)
    reach = gathered(values)
    normals = gathered(areas[:, None, None] * _alike(mesh, corners))
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    vertex = np.empty(count, dtype=np.int64)
    vertex[corners] = mesh.faces
    reach[held[vertex]] = 0.0
    for support in supports:
        if (plane := support.mirror()) is not None:
            even = support.vertices(mesh)[vertex] & (2.0 * np.arcsin(np.minimum(np.abs(normals @ plane), 1.0)) <= SHARP)
            reach[even] -= (reach[even] @ plane)[:, None] * plane
    reach /= np.bincount(corners.ravel(), np.repeat(areas, 3), count)[:, None]
    moved = values
    fill_in_parts(moved, functools.partial(_moved, mesh, reach), mesh.faces, mesh.face_normals, corners)
    # Sums of a group at a vertex are at least those of its negative parts: few vertices can come to lack mass.
    least, kept = np.ones(count), (1.0 - _LEAST) * thirds
    negative = np.bincount(mesh.faces.ravel(), _summed(np.minimum(moved, 0.0)).ravel(), thirds.size)
    triangle, place = np.nonzero((negative < -kept)[mesh.faces])
    at = corners[triangle], mesh.faces[triangle, place, None]
    moves = assembled(moved[triangle, :, place][:, :, None], *at, (count, thirds.size))
    taken = moves.data < 0.0
    givers = moves.indices[taken]
    given = -np.bincount(givers, moves.data[taken], thirds.size)
    share = np.divide(kept, given, out=np.ones(thirds.size), where=given > 0.0)
    np.minimum.at(least, np.repeat(np.arange(count), np.diff(moves.indptr))[taken], share[givers])
    moved *= least[corners][:, :, None]
    return np.asarray(thirds + np.bincount(mesh.faces.ravel(), _summed(moved).ravel(), thirds.size))


def _summed(moved: Array) -> Array:
    """Sums over the groups (T, 3) at the corners of a triangle, of values (T, 3, 3) of group and vertex."""
    return np.asarray(moved[:, 0] + moved[:, 1] + moved[:, 2])  # `sum` is slow over three


def _sides(mesh: TriangleMesh, faces: Index) -> Array:
    """Vectors (T, 3, 3) [m] from each corner to the next."""
    points = mesh.vertices[faces]
    return np.asarray(np.roll(points, -1, axis=1) - points)


def _reach(mesh: TriangleMesh, faces: Index, weight: Array) -> Array:
    """Sums (T, 3, 3) of the vectors [m] from each corner to both others, times a weight (T,)."""
    sides = _sides(mesh, faces)
    return np.asarray(weight[:, None, None] * (sides - np.roll(sides, 1, axis=1)))


def _moved(mesh: TriangleMesh, reach: Array, faces: Index, normals: Array, corners: Index) -> Array:
    """What the group of each corner, of ``reach`` (count, 3), gives to the triangle's vertices; shape (T, 3, 3).

    It goes by the gradients of their hat functions: that of a corner's height over the opposite side.
    """
    gradients = np.cross(normals[:, None], np.roll(_sides(mesh, faces), -1, axis=1)) / 2.0
    return np.asarray(np.einsum("tcx,tvx->tcv", reach[corners], gradients))


def _alike(mesh: TriangleMesh, corners: Index) -> Array:
    """Normals (T, 3, 3) of the triangles at their ``corners`` (T, 3), over seams those of the group's first one."""
    normals = np.repeat(mesh.face_normals[:, None], 3, axis=1)
    if mesh.seams.size:
        _, first = np.unique(corners, return_index=True)
        turned = np.sum(normals * mesh.face_normals[first[corners] // 3], axis=2) < 0.0
        normals[turned] *= -1.0
    return normals


def _joined_corners(mesh: TriangleMesh) -> Index:
    """Group (T, 3) of each corner: those at a vertex whose triangles meet without a sharp fold or a junction."""
    edges = mesh.hinge_edges[~np.isin(mesh.hinge_edges, mesh.junctions)]
    seam = np.isin(edges, mesh.seams)
    left, right = mesh.edge_faces[edges].T
    first, second = mesh.edge_corners[edges].T
    cosines = np.sum(mesh.face_normals[left] * mesh.face_normals[right], axis=1)
    smooth = np.where(seam, -cosines, cosines) >= np.cos(SHARP)
    # Both triangles run along their edge in opposite senses, but at seams.
    starts = np.concatenate([3 * left + first, 3 * left + (first + 1) % 3])
    ends = np.concatenate([3 * right + (second + ~seam) % 3, 3 * right + (second + seam) % 3])
    joined = np.concatenate([smooth, smooth])
    return connected_parts(np.column_stack([starts[joined], ends[joined]]), 3 * len(mesh.faces)).reshape(-1, 3)
