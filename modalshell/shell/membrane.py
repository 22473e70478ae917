"""Effective membrane stiffness of a mesh of edge springs and triangle areas.

Springs of stiffness ``k_h = 2 E h sum(A) / (3 (1 + nu) l)`` (A: the triangles at the edge, so that a boundary edge
counts half) and areas of ``k_s = E h (3 nu - 1) / (4 (1 - nu^2))`` have the energy of an isotropic sheet on the mean
over directions, and in every direction where triangles are equilateral (theory 3, eq. 3). Right-angled ones are stiffer
along their legs.
"""

from __future__ import annotations

import warnings

import numpy as np

from modalshell.core.errors import MaterialError, ModalShellWarning
from modalshell.core.typing import Array
from modalshell.mesh import TriangleMesh
from modalshell.shell.orientation import Orientation, in_plane_angles

_STABLE_SHARE = 0.8
"""Share of the lowest stable area stiffness that is used: at the bound itself a triangle has a strain for free."""


def membrane_stiffness(
    mesh: TriangleMesh, young_thickness: float, poisson: float, orientation: Orientation
) -> tuple[Array, Array]:
    """Area stiffness (T,) [N/m] and edge stiffness (E,) [N] of an isotropic sheet with ``E h`` [N/m].

    Where the mesh has a long axis, or the user named a direction, both are scaled so that pulling along it meets E
    exactly.
    """
    shear = 2.0 * young_thickness / (3.0 * (1.0 + poisson)) * adjacent_areas(mesh) / mesh.edge_lengths
    stretch = np.full(len(mesh.faces), young_thickness * (3.0 * poisson - 1.0) / (4.0 * (1.0 - poisson**2)))
    bound = _STABLE_SHARE * lowest_stable_stretch(mesh, shear)
    unstable = np.flatnonzero(stretch < bound)
    if unstable.size:
        stretch = np.maximum(stretch, bound)
        warnings.warn(
            f"{unstable.size} of {len(mesh.faces)} triangles are too obtuse for Poisson's ratio {poisson:g} "
            f"(first: triangle {unstable[0]}): their area term is limited, which makes them stiffer across. "
            "Remesh to near-equilateral triangles to avoid it",
            ModalShellWarning,
            stacklevel=3,
        )
    if orientation.elongated or orientation.named:
        scale = young_thickness / axial_stiffness(mesh, stretch, shear, orientation.axis)
        return scale * stretch, scale * shear
    return stretch, shear


def axial_stiffness(mesh: TriangleMesh, stretch: Array, shear: Array, axis: Array) -> float:
    """Effective ``E h`` [N/m] along ``axis``, with free sides, for uniform strain of the whole mesh."""
    corners = mesh.vertices[mesh.faces]
    edges = np.roll(corners, -1, axis=1) - corners
    tangents = edges / np.linalg.norm(edges, axis=2, keepdims=True)
    normals = np.repeat(mesh.face_normals[:, None], 3, axis=1)
    cosine, sine = in_plane_angles(tangents, normals, axis)
    rows = np.stack([cosine**2, sine**2, cosine * sine], axis=-1)
    share = mesh.face_areas[:, None] / adjacent_areas(mesh)[mesh.face_edges]
    spring = shear[mesh.face_edges] * mesh.edge_lengths[mesh.face_edges] * share
    tensor = np.einsum("tk,tki,tkj->ij", spring, rows, rows)
    tensor[:2, :2] += float(np.sum(stretch * mesh.face_areas))
    # The energy per area is strain . C . strain, so a stress-free side leaves E h = 2 / (C^-1)_00.
    try:
        return float(2.0 / np.linalg.inv(tensor / mesh.area)[0, 0])
    except np.linalg.LinAlgError as error:
        raise MaterialError(
            f"no stiffness of the {len(mesh.faces)} triangles resists every strain of the sheet: they are needles that "
            "all lie along one direction; remesh to triangles nearer to equilateral"
        ) from error


def adjacent_areas(mesh: TriangleMesh) -> Array:
    """Sum of the areas of the triangles at each edge (E,) [m^2]; a boundary edge has one triangle."""
    total = np.zeros(len(mesh.edges))
    np.add.at(total, mesh.face_edges, mesh.face_areas[:, None])
    return total


def lowest_stable_stretch(mesh: TriangleMesh, shear: Array) -> Array:
    """Lowest area stiffness (T,) [N/m] at which each triangle resists every strain, for edge stiffnesses (E,) [N].

    A triangle's strain energy per area is ``sum_i a_i e_i^2 + k_s (g . e)^2`` in its edge strains e, so it is positive
    as long as ``1 + k_s sum_i g_i^2 / a_i > 0``. An edge's stiffness is shared between its triangles by their areas.
    """
    areas = mesh.face_areas
    lengths = mesh.edge_lengths[mesh.face_edges]
    share = areas[:, None] / adjacent_areas(mesh)[mesh.face_edges]
    spring = shear[mesh.face_edges] * lengths * share / areas[:, None]
    squared = lengths**2
    # dA/dl of Heron's formula: tr(strain) = sum_i g_i e_i with g_i = l_i^2 (sum of the others - l_i^2) / (8 A^2).
    gradient = squared * (squared.sum(axis=1, keepdims=True) - 2.0 * squared) / (8.0 * areas[:, None] ** 2)
    slack = np.where(gradient == 0, 0.0, np.inf)
    compliance = np.where(spring > 0, gradient**2 / np.where(spring > 0, spring, 1.0), slack)
    with np.errstate(divide="ignore"):
        return -1.0 / compliance.sum(axis=1)
