"""Triangle mesh of a shell: vertices, faces and derived topology."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modalshell.core.checks import checked_vectors
from modalshell.core.drawn import Drawn
from modalshell.core.errors import MeshError
from modalshell.core.thread_safety import ReadOnlyArrays, read_only
from modalshell.core.typing import Array, Index
from modalshell.mesh import validation
from modalshell.mesh.joints import Joints, hinges_of_joints, joints_of
from modalshell.mesh.topology import area_vectors, connected_parts, faces_of_edges, hinges_of_edges
from modalshell.mesh.welding import drop_unused, weld_arrays, without_flat_faces

_APART = 1e-3
"""Distance of vertices, as a share of the largest one, below which they show no direction."""
_EQUAL, _SEEN = 1e-3, 0.55
"""Difference of second moments, as a share of the largest, that counts as none; share of a unit vector in a space of
axes from which it shows one of them: of three at right angles one has at least 0.577."""


class TriangleMesh(ReadOnlyArrays, Drawn):
    """An immutable, validated triangle mesh: sheets of consistent winding, with or without boundary.

    Any number of triangles may meet at an edge: sheets are joined rigidly at such :attr:`junctions`. Winding is
    consistent between them, not over them, and a one-sided sheet has :attr:`seams`.

    Parameters
    ----------
    vertices : (n, 3) float
        Vertex positions at rest [m]. Copied.
    faces : (T, 3) int
        Vertex indices of each triangle. Copied; flipped where the winding is inconsistent, with a warning.

    Raises
    ------
    MeshError
        When the arrays are no valid shell mesh; names the fault and the first offending indices, counted from 0.
    """

    def __init__(self, vertices: ArrayLike, faces: ArrayLike) -> None:
        points = validation.as_vertices(vertices)
        triangles = validation.as_faces(faces, len(points))
        validation.check_faces(points, triangles)
        triangles, self._links = validation.paired_edges(triangles, len(points))
        validation.check_used(triangles, len(points))
        self._vertices = read_only(points)
        self._faces = read_only(triangles)
        self._joints = Joints(*map(read_only, joints_of(points, triangles, self._links)))
        self._edge_faces, self._edge_corners = map(read_only, self._first_faces())
        validation.warn_of_seams(self._vertices, self.boundary_vertices)

    def _first_faces(self) -> tuple[Index, Index]:
        edge_faces, corners = faces_of_edges(self._links)
        edges, starts, wings = self._joints
        for side in (0, 1):
            half = wings[starts[:-1] + side]
            edge_faces[edges, side], corners[edges, side] = half // 3, half % 3
        return edge_faces, corners

    @classmethod
    def from_soup(cls, vertices: ArrayLike, faces: ArrayLike) -> TriangleMesh:
        """Build a mesh from a triangle soup: merge coincident vertices, drop or repair faces without area."""
        points = validation.as_vertices(vertices)
        merged, kept, _ = weld_arrays(points, validation.as_faces(faces, len(points)))
        return cls(*drop_unused(merged, without_flat_faces(merged, kept)))

    @property
    def vertices(self) -> Array:
        """Vertex positions at rest [m], shape (n, 3), read-only."""
        return self._vertices

    @property
    def faces(self) -> Index:
        """Vertex indices of the triangles, shape (T, 3), read-only."""
        return self._faces

    @cached_property
    def edges(self) -> Index:
        """Edges, shape (E, 2), the smaller index first, in lexicographic order."""
        return read_only(self._links.edges)

    @cached_property
    def face_edges(self) -> Index:
        """Index into `edges` of each face's (f0, f1), (f1, f2), (f2, f0), shape (T, 3)."""
        return read_only(self._links.face_edges)

    @property
    def edge_faces(self) -> Index:
        """Faces of each edge, shape (E, 2).

        Column 0 runs along the edge from its smaller to its larger vertex; a boundary edge has its one face there
        and -1 in column 1. Of a junction these are two of its faces, and of a seam both, whichever way they run.
        """
        return self._edge_faces

    @property
    def joints(self) -> Joints:
        """Junctions and seams together, with all their faces."""
        return self._joints

    @cached_property
    def junctions(self) -> Index:
        """Edges with three faces or more, ascending, shape (J,)."""
        return read_only(np.flatnonzero(self._links.counts > 2))

    @cached_property
    def seams(self) -> Index:
        """Edges of one-sided sheets with two faces that run along them the same way, ascending."""
        return read_only(np.setdiff1d(self._joints.edges, self.junctions))

    @property
    def edge_corners(self) -> Index:
        """Corner of each of `edge_faces` where the edge begins in the face's winding, shape (E, 2); -1 for no face."""
        return self._edge_corners

    @cached_property
    def _hinge_data(self) -> tuple[Index, Index]:
        hinges, edges = hinges_of_edges(self.faces, self._links, self.edge_faces)
        if self._joints.edges.size:
            odd = np.isin(edges, self._joints.edges)
            hinges = np.vstack([hinges[~odd], hinges_of_joints(self.faces, self._joints)])
            edges = np.concatenate([edges[~odd], self._joints.hinge_edges])
            order = np.argsort(edges, kind="stable")
            hinges, edges = hinges[order], edges[order]
        return read_only(hinges), read_only(edges)

    @property
    def hinges(self) -> Index:
        """Hinges [x0, x1, x2, x3] over the interior edges, shape (H, 4).

        The edge runs x0 -> x1 with x0 < x1; (x0, x1, x2) and (x1, x0, x3) are its faces in their winding, so the fold
        angle of the flexure energy is 0 where the surface is flat. A junction of k faces has k - 1 hinges, all with its
        first face; there x0 -> x1 is such that (x1, x0, x3) is the other one in its winding.
        """
        return self._hinge_data[0]

    @property
    def hinge_edges(self) -> Index:
        """Index into `edges` of each hinge, shape (H,), ascending."""
        return self._hinge_data[1]

    @cached_property
    def hinge_faces(self) -> Index:
        """Faces (x0, x1, x2) and (x1, x0, x3) of each hinge, shape (H, 2)."""
        faces = self.edge_faces[self.hinge_edges]
        if self._joints.edges.size:
            first, other = self._joints.hinge_wings
            faces[np.isin(self.hinge_edges, self._joints.edges)] = np.column_stack([first, other]) // 3
        return read_only(faces)

    @cached_property
    def edge_lengths(self) -> Array:
        """Edge lengths at rest [m], shape (E,)."""
        first, second = self.edges.T
        return read_only(np.linalg.norm(self.vertices[second] - self.vertices[first], axis=1))

    @cached_property
    def _twice_area_vectors(self) -> Array:
        return read_only(area_vectors(self.vertices, self.faces))

    @cached_property
    def face_areas(self) -> Array:
        """Triangle areas at rest [m^2], shape (T,)."""
        return read_only(0.5 * np.linalg.norm(self._twice_area_vectors, axis=1))

    @cached_property
    def face_normals(self) -> Array:
        """Unit normals at rest, shape (T, 3)."""
        return read_only(self._twice_area_vectors / (2.0 * self.face_areas)[:, None])

    @property
    def area(self) -> float:
        """Total area at rest [m^2]."""
        return float(self.face_areas.sum())

    @cached_property
    def size(self) -> float:
        """Largest extent along an axis at rest [m]."""
        return float(np.ptp(self.vertices, axis=0).max())

    @cached_property
    def moment_length(self) -> float:
        """Length [m] of a rectangle whose area has the largest second moment of the mesh's, over their areas.

        That of a rectangle is its longer side. It is the same for a mesh that is turned.
        """
        return self.size * float(np.sqrt(np.linalg.eigvalsh(self._moments)[-1]))

    @cached_property
    def _moments(self) -> Array:
        """Second moments (3, 3) of the area about its centre, over a twelfth of the area and the squared size."""
        shares = self.face_areas / self.area
        corners = self.vertices[self.faces]
        corners = (corners - shares @ corners.mean(axis=1)) / self.size
        # A triangle's moment is a twelfth of its area times that of its corners and of their sum.
        points = np.concatenate([corners, corners.sum(axis=1, keepdims=True)], axis=1)
        return read_only(np.tensordot(shares[:, None, None] * points, points, ((0, 1), (0, 1))))

    @cached_property
    def axes(self) -> Array:
        """Rows (3, 3) of axes that turn with the mesh: the last is its mean normal, or that of its first face.

        The second points from the first vertex to the next one that is not all but there, nor all but along the normal.
        What is drawn at random along these axes, or decided by them, is the same for a mesh that is turned.
        """
        normal, away = self._twice_area_vectors.sum(axis=0), self.vertices[1:] - self.vertices[0]
        if np.linalg.norm(normal) < 0.5 * self.area:
            normal = self.face_normals[0]
        normal = normal / np.linalg.norm(normal)
        flat = away - np.outer(away @ normal, normal)
        lengths = np.linalg.norm(away, axis=1)
        shares = np.linalg.norm(flat, axis=1) / np.maximum(lengths, _APART * lengths.max())
        across = flat[np.argmax(shares >= 0.5 * shares.max())]
        across = across / np.linalg.norm(across)
        return read_only(np.stack([np.cross(across, normal), across, normal]))

    @cached_property
    def principal_axes(self) -> Array:
        """Rows (3, 3) of the axes of the area's second moments, the largest first, that turn with the mesh.

        Their signs are those of :attr:`axes`, so that they may be left-handed. Where two moments differ by less than
        0.1 %, directions of :attr:`axes` in their plane stand in, which follow the numbers of the vertices.
        """
        values, vectors = np.linalg.eigh(self._moments)
        apart = np.flatnonzero(np.diff(values) > _EQUAL * values[-1]) + 1
        found: list[Array] = []
        for space in np.split(vectors, apart, axis=1)[::-1]:
            left = space @ space.T
            for _ in range(space.shape[1]):
                inside = self.axes @ left
                lengths = np.linalg.norm(inside, axis=1)
                first = int(np.argmax(lengths > _SEEN))
                found.append(inside[first] / lengths[first])
                left = left - np.outer(found[-1], found[-1])
        return read_only(np.stack(found))

    @cached_property
    def extent(self) -> float:
        """Largest extent along a principal axis at rest [m], the same for a mesh that is turned.

        Of one with two moments that are all but equal, such as a square, it depends on the numbers of its vertices.
        """
        return float(np.ptp((self.vertices - self.vertices[0]) @ self.principal_axes.T, axis=0).max())

    @cached_property
    def boundary_vertices(self) -> Index:
        """Vertices on the boundary, sorted, shape (b,)."""
        return read_only(np.unique(self.edges[self.edge_faces[:, 1] < 0]))

    @cached_property
    def components(self) -> Index:
        """Label of each vertex's connected component, shape (n,), counted from 0."""
        return read_only(connected_parts(self.edges, len(self.vertices)))

    def shared_among_corners(self, face_values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Sum at each vertex (n,) of a third of every adjacent triangle's value (T,), as lumped masses are made."""
        values = checked_vectors("face_values", face_values, (len(self.faces),), MeshError)
        shares = np.repeat(values / 3.0, 3)
        return np.asarray(np.bincount(self.faces.ravel(), shares, len(self.vertices)), dtype=np.float64)

    def weld(self, tolerance: float | None = None) -> TriangleMesh:
        """Return the mesh with coincident vertices merged.

        Parameters
        ----------
        tolerance : float, optional
            Merging distance [m]; 1e-8 of the bounding box's diagonal by default. Faces that collapse are dropped.
        """
        vertices, faces, _ = weld_arrays(self.vertices, self.faces, tolerance)
        return TriangleMesh(vertices, faces)

    def __repr__(self) -> str:
        return (
            f"TriangleMesh({len(self.vertices)} vertices, {len(self.faces)} faces, {len(self.edges)} edges, "
            f"{len(self.boundary_vertices)} boundary vertices)"
        )
