r"""Membrane of the split-fold energy: Green strain, St. Venant-Kirchhoff, plane stress, smoothed per edge.

In a triangle the Green strain E follows linearly from the changes :math:`s_e = (l_e^2 - l_{0,e}^2) / 2` of its three
edges. Each edge e has a part :math:`A_{T,e}` of the triangle's area, in proportion to :math:`l_e^4`, but at least a
quarter of the largest part. Across a smooth edge the strains of both triangles are averaged over these parts,

.. math:: W_e = \frac{A_{T,e} + A_{T',e}}{2} \bar E : C : \bar E, \qquad
          \bar E = \frac{A_{T,e} E_T + A_{T',e} E_{T'}}{A_{T,e} + A_{T',e}},

each in the edge's own axes in its own plane, so that nothing depends on the fold. At free, clamped and sharply folded
edges, at junctions, and where the stiffness or Poisson's ratio jumps, each triangle keeps its own strain, :math:`W_e =
A_{T,e} E_T : C : E_T / 2`; at smooth edges in a plane of symmetry less the shear, which its mirror image has with the
other sign. The energy is :math:`s^T Q s / 2` with one constant matrix Q (theory 6, eq. 2 to 6).

Thirds of the area, as in edge-based smoothed finite elements [liu2009], leave sheets of right triangles too stiff in
their own plane: a strip of length five widths and four union-jack cells across bends in it 6.8 % too little, 0.8 % with
:math:`l_e^4` (its Poisson's ratio is 0.3). Strains that change sign within a row of cells are averaged away at its long
edges, and only the short ones resist them. Without the least part a single row of right triangles, its cells four times
as wide as long, bends 42 times too much in its plane; with it, twice.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, final

import numpy as np
import scipy.sparse as sps

from modalshell.core.in_parts import fill_in_parts
from modalshell.core.typing import Array, Index, Mask
from modalshell.linalg.elements import assembled
from modalshell.mesh import TriangleMesh
from modalshell.mesh.topology import numbers_of_edges
from modalshell.shell.elasticity import Elasticity
from modalshell.shell.kernels.split_folds import EDGES, quadratic_forms

SHARP = np.radians(20.001)
"""Rest fold [rad] above which strains are not smoothed across an edge: folds of just 20 degrees all are, as rounded."""

SHARE_EXPONENT = 4
"""Power of the lengths by which the edges of a triangle share its area."""

_LEAST_POWER = 0.25
"""Least power of an edge, over that of the triangle's longest: that of the legs of a right isosceles triangle."""

PAIR = np.array(EDGES)
"""Edges of two triangles in the order of a hinge's vertices; the first three are the left one's."""


@final
@dataclass(frozen=True)
class MembraneElements:
    """Elements of one kind, each with a constant matrix over the half squared lengths of its edges."""

    stencils: Index
    """Vertices of each element; shape (elements, vertices)."""
    pairs: Index
    """Its edges, as places in the stencil; shape (edges, 2)."""
    edges: Index
    """The same edges, numbered as in the mesh; shape (elements, edges)."""
    matrices: Array
    """Q of each element [N/m^3]; shape (elements, edges, edges)."""
    faces: Index
    """Triangles of each element; shape (elements, triangles)."""
    areas: Array
    """Part of each triangle's area in the element [m^2]; shape (elements, triangles)."""

    def as_pairs(self, slots: Index) -> tuple[Index, Array, Index]:
        """Stencils (elements, 4), matrices (elements, 5, 5) and slots (elements, 4, 4) of :data:`PAIR`'s edges.

        ``slots`` (elements, vertices, vertices) are the elements' own. A single triangle has edges without stiffness to
        a fourth vertex that has no slots.
        """
        if self.stencils.shape[1] == 4:
            return self.stencils, self.matrices, slots
        count = len(self.stencils)
        matrices, places = np.zeros((count, 5, 5)), np.full((count, 4, 4), -1, slots.dtype)
        matrices[:, :3, :3], places[:, :3, :3] = self.matrices, slots
        return np.ascontiguousarray(self.stencils[:, [0, 1, 2, 0]]), matrices, places

    def part(self, chosen: Index, factors: Array, vertices: Index) -> MembraneElements:
        """Chosen elements times factors, on a numbering of the sorted ``vertices``; edges as they were."""
        return replace(
            self,
            stencils=np.ascontiguousarray(np.searchsorted(vertices, self.stencils[chosen])),
            edges=self.edges[chosen],
            matrices=self.matrices[chosen] * factors[:, None, None],
            faces=self.faces[chosen],
            areas=self.areas[chosen] * factors[:, None],
        )


def plane_stress(stiffness: Array, poisson: Array) -> Array:
    """Elasticity (T, 3, 3) for (E11, E22, 2 E12) of ``E h / (1 - nu^2)`` and Poisson's ratio (T,) of every triangle."""
    elastic = np.zeros((len(stiffness), 3, 3))
    elastic[:, 0, 0] = elastic[:, 1, 1] = stiffness
    elastic[:, 0, 1] = elastic[:, 1, 0] = poisson * stiffness
    elastic[:, 2, 2] = 0.5 * (1.0 - poisson) * stiffness
    return elastic


@final
class Strained(NamedTuple):
    """Elements of one kind by their strains: ``s . B^T C B s / 2`` of half squared lengths s of their edges."""

    stencils: Index
    pairs: Index
    edges: Index
    strain_of: Callable[[Index, Array], Array]
    """B (elements, 3, edges), to (E11, E22, 2 E12), of the ``stencils`` and ``areas`` of some of them."""
    areas: Array
    """Part of each triangle's area in the element [m^2]; shape (elements, triangles)."""
    faces: Index
    """Like ``stencils``, ``pairs`` and ``edges``: those of :class:`MembraneElements`."""

    def in_tables(self) -> Strained:
        """The elements with their places in a list of :func:`turned_elasticity` for faces."""
        return self._replace(faces=np.arange(self.faces.size).reshape(self.faces.shape))

    def elastic(self, elastic: Array) -> Array:
        """C (elements, 3, 3) [N m] of the elasticity (T, 3, 3) [N/m] of every triangle."""
        return _summed_elasticity(elastic, self.areas, self.faces)


def strained_elements(mesh: TriangleMesh, clamped: Mask, smooth: Mask, mirrored: Index) -> list[Strained]:
    """Pairs of triangles over smooth edges, single triangles for their other edges, and those at planes of symmetry.

    ``clamped`` (n,) are held vertices, ``smooth`` (H,) hinges of the mesh that are folded little at rest, with about
    the same sheet on either side, ``mirrored`` smooth boundary edges in planes of symmetry.
    """
    lengths = mesh.edge_lengths[mesh.face_edges]
    powers = np.maximum((lengths / lengths.max(axis=1, keepdims=True)) ** SHARE_EXPONENT, _LEAST_POWER)
    own_areas = mesh.face_areas[:, None] * powers / powers.sum(axis=1, keepdims=True)

    def taken(faces: Index, corners: Index) -> Array:
        """Parts of the faces' areas at their edges that begin at ``corners``, which are then no longer their own."""
        areas = own_areas[faces, corners]
        own_areas[faces, corners] = 0.0
        return areas

    smooth = smooth & ~clamped[mesh.edges[mesh.hinge_edges]].all(axis=1)
    smooth[np.isin(mesh.hinge_edges, mesh.junctions)] = False
    hinges, edges = mesh.hinges[smooth], mesh.hinge_edges[smooth]
    both, corners, others = _around(mesh, edges)
    areas = taken(both, corners)
    numbers = np.empty((len(edges), 5), dtype=np.int64)
    numbers[:, 0] = edges
    for k, side in enumerate((0, 0, 1, 1)):
        numbers[:, 1 + k] = mesh.face_edges[both[:, side], (corners[:, side] + others[:, k]) % 3]
    found = [
        Strained(np.ascontiguousarray(hinges), PAIR, numbers, functools.partial(_strain_of_pairs, mesh), areas, both)
    ]

    edges = mirrored[~clamped[mesh.edges[mirrored]].all(axis=1)]
    rim = mesh.edge_faces[edges, 0]
    rim_areas = taken(rim, mesh.edge_corners[edges, 0])[:, None]
    own = np.flatnonzero(own_areas.any(axis=1))
    faces = np.ascontiguousarray(mesh.faces[own])
    numbers = np.ascontiguousarray(mesh.face_edges[own][:, [0, 2, 1]])
    strain_of = functools.partial(_strain_of_triangles, mesh)
    found.append(Strained(faces, PAIR[:3], numbers, strain_of, own_areas[own].sum(axis=1)[:, None], own[:, None]))
    if rim.size:
        ends = mesh.edges[edges]
        triangles = np.column_stack([ends, mesh.faces[rim].sum(axis=1) - ends.sum(axis=1)])
        strain_of = functools.partial(_strain_of_triangles, mesh, sheared=False)
        numbers = numbers_of_edges(mesh.edges, triangles[:, PAIR[:3]])
        found.append(Strained(triangles, PAIR[:3], numbers, strain_of, rim_areas, rim[:, None]))
    return found


def _around(mesh: TriangleMesh, edges: Index) -> tuple[Index, Index, Index]:
    """Triangles (e, 2) of hinges at ``edges``, the corners (e, 2) from which they run, and their other edges (e, 4).

    These come in the order of :data:`PAIR`, as places after the common edge; at seams the first triangle runs the
    other way.
    """
    both, corners = mesh.edge_faces[edges], mesh.edge_corners[edges]
    others = np.tile([2, 1, 1, 2], (len(edges), 1))
    if mesh.seams.size:
        seam = np.isin(edges, mesh.seams)
        wings = np.column_stack(mesh.joints.hinge_wings)[np.searchsorted(mesh.joints.hinge_edges, edges[seam])]
        both, corners = both.copy(), corners.copy()
        both[seam], corners[seam] = wings // 3, wings % 3
        others[seam, :2] = 1, 2
    return both, corners, others


def membrane_of(
    mesh: TriangleMesh, strained: list[Strained], stiffness: Array, poisson: Array, directed: Elasticity | None
) -> list[MembraneElements]:
    """Elements of an isotropic sheet of ``E h / (1 - nu^2)`` and Poisson's ratio (T,), or of a ``directed`` one."""
    if directed is None:
        return membrane_elements(strained, plane_stress(stiffness, poisson))
    return membrane_elements(strained, turned_elasticity(mesh, strained, directed))


def turned_elasticity(mesh: TriangleMesh, strained: list[Strained], elasticity: Elasticity) -> list[Any]:
    """Elasticity (elements * triangles, 3, 3) in the axes in which each of the elements has its strains."""
    found = []
    for e in strained:
        x0, x1 = mesh.vertices[e.stencils[:, 0]], mesh.vertices[e.stencils[:, 1]]
        along = (x1 - x0) / np.linalg.norm(x1 - x0, axis=1)[:, None]
        sides = []
        for side in range(e.faces.shape[1]):
            arm = (1.0 - 2.0 * side) * (mesh.vertices[e.stencils[:, 2 + side]] - x0)
            across = arm - np.sum(arm * along, axis=1)[:, None] * along
            across = across / np.linalg.norm(across, axis=1)[:, None]
            sides.append(elasticity.in_axes(mesh, e.faces[:, side], along, across))
        found.append(np.stack(sides, axis=1).reshape(-1, 3, 3))
    return found


def membrane_elements(strained: list[Strained], elastic: Array | list[Any]) -> list[MembraneElements]:
    """The :func:`strained_elements` with their matrices: pairs, and all single triangles together.

    ``elastic`` (T, 3, 3) is the elasticity of every triangle [N/m], or a list of those of every kind's elements from
    :func:`turned_elasticity`; means over the areas count across smooth edges.
    """
    tables = elastic if isinstance(elastic, list) else [elastic] * len(strained)
    own = [e.in_tables() if isinstance(elastic, list) else e for e in strained]
    pairs, *singles = (
        MembraneElements(e.stencils, e.pairs, e.edges, _matrices(used, table), e.faces, e.areas)
        for e, used, table in zip(strained, own, tables, strict=True)
    )
    names = ("stencils", "edges", "matrices", "faces", "areas")
    if len(singles) > 1:
        joined = {name: np.concatenate([getattr(e, name) for e in singles]) for name in names}
        singles = [replace(singles[0], **joined)]
    return [pairs, *singles]


def membrane_matrix(elements: list[MembraneElements], edge_count: int) -> sps.csr_array:
    """Q (E, E) of all elements together."""
    kinds = [assembled(e.matrices, e.edges, e.edges, (edge_count, edge_count)) for e in elements]
    return sps.csr_array(sum(kinds[1:], kinds[0]))


def strain_of_lengths(mesh: TriangleMesh, triangles: Index, side: float = 1.0) -> Array:
    """Matrices (T, 3, 3) from half squared lengths of a triangle's edges to (E11, E22, 2 E12), axis 1 along v0 -> v1.

    The edges are (v0, v1), (v0, v2), (v1, v2). With ``side`` -1, v2 lies to the right of the first.
    """
    x0, x1, x2 = (mesh.vertices[triangles[:, k]] for k in range(3))
    edge, arm = x1 - x0, x2 - x0
    length = np.linalg.norm(edge, axis=1)
    along = np.sum(arm * edge, axis=1) / length
    across = side * np.linalg.norm(np.cross(edge, arm), axis=1) / length
    # Laid flat the edges are d = (t, n). The strain of one of them is the product of the two others' normals, which
    # leaves these as long as they are, over +- 4 times the squared area.
    edges = (length, 0.0), (along, across), (along - length, across)
    area = (length * across) ** 2
    strain = np.empty((len(triangles), 3, 3))
    for k, sign in enumerate((1.0, -1.0, 1.0)):
        (t, n), (s, m) = (edges[other] for other in range(3) if other != k)
        weight = sign / area
        strain[:, 0, k], strain[:, 1, k], strain[:, 2, k] = weight * n * m, weight * t * s, -weight * (n * s + t * m)
    return strain


def _strain_of_triangles(mesh: TriangleMesh, triangles: Index, _: Array, *, sheared: bool = True) -> Array:
    """Strains (T, 3, 3) of triangles (T, 3); those not ``sheared`` have no shear."""
    strain = strain_of_lengths(mesh, triangles)
    if not sheared:
        strain[:, 2] = 0.0
    return strain


def _strain_of_pairs(mesh: TriangleMesh, hinges: Index, areas: Array) -> Array:
    """Means (P, 3, 5) of the strains of both triangles of hinges (P, 4), by their areas (P, 2)."""
    strain = np.zeros((len(hinges), 3, 5))
    shares = (areas / (areas[:, :1] + areas[:, 1:]))[:, :, None, None]
    # Seen from the edge, the left apex lies at +h, the right one at -h.
    strain[:, :, [0, 1, 2]] = shares[:, 0] * strain_of_lengths(mesh, hinges[:, [0, 1, 2]])
    strain[:, :, [0, 3, 4]] += shares[:, 1] * strain_of_lengths(mesh, hinges[:, [0, 1, 3]], -1.0)
    return strain


def _summed_elasticity(elastic: Array, areas: Array, faces: Index) -> Array:
    """Sums (elements, 3, 3) of the elasticity (T, 3, 3) of ``faces`` times their ``areas`` (elements, triangles)."""
    total, *further = (areas[:, k, None, None] * elastic[faces[:, k]] for k in range(faces.shape[1]))
    for other in further:
        total += other
    return total


def _matrices(e: Strained, elastic: Array) -> Array:
    """Q (elements, edges, edges) of the elasticity (T, 3, 3) of every triangle."""

    def products(stencils: Index, areas: Array, faces: Index) -> Array:
        matrices = np.empty((len(stencils), len(e.pairs), len(e.pairs)))
        quadratic_forms(e.strain_of(stencils, areas)[None], _summed_elasticity(elastic, areas, faces)[None], matrices)
        return np.asarray(0.5 * (matrices + matrices.transpose(0, 2, 1)))

    matrices = np.empty((len(e.stencils), len(e.pairs), len(e.pairs)))
    fill_in_parts(matrices, products, e.stencils, e.areas, e.faces)
    return matrices
