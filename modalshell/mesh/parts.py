"""Connected parts of a mesh: selection, joining of parts that touch, and detection of unsupported ones."""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy.spatial import cKDTree

from modalshell.core.checks import checked_count, checked_number
from modalshell.core.errors import MeshError, SupportError
from modalshell.core.typing import Array, Index, Mask
from modalshell.mesh.triangle_mesh import TriangleMesh
from modalshell.mesh.welding import drop_unused

Component = Literal["largest", "all"] | int
"""Which part of a mesh is taken: that of the largest area, all, or the N-th, counted from 0 by falling area."""
_NEAR = 1e-3
"""Gap between parts, as a share of the mesh's size, up to which joining them is proposed."""
_MOST_NEIGHBOURS = 64
"""Number of nearest vertices searched for one of another part."""


def chosen_part(mesh: TriangleMesh, component: Component | None = None, join: float | None = None) -> TriangleMesh:
    """The mesh with vertices at most ``join`` [m] apart merged, reduced to the requested part.

    MeshError if there is no such part, or joining leaves no valid mesh. OptionError if ``join`` is not a positive
    number, or ``component`` is invalid.
    """
    if join is not None:
        mesh = mesh.weld(checked_number("join", join, above=0.0, unit="m"))
    if component is None or component == "all":
        return mesh
    labels = mesh.components
    order = parts_by_area(mesh)
    number = 0 if component == "largest" else checked_count("component", component, at_least=0)
    if number >= len(order):
        raise MeshError(f"component must be 'largest', 'all' or a number from 0 to {len(order) - 1} (got {number})")
    if len(order) == 1:
        return mesh
    return TriangleMesh(*drop_unused(mesh.vertices, mesh.faces[labels[mesh.faces[:, 0]] == order[number]]))


def refuse_loose_parts(mesh: TriangleMesh, held: Mask) -> None:
    """SupportError if parts of a mesh in several are not held: they would only fall, and take the modes with them."""
    if fault := loose_parts_fault(mesh, held):
        raise SupportError(fault)


def loose_parts_fault(mesh: TriangleMesh, held: Mask, *, wanted: bool = False) -> str:
    """Message on how many parts of a mesh have no support, and on remedies; "" if there are none.

    Where all parts are ``wanted``, that is no remedy any more.
    """
    labels = mesh.components
    count = int(labels.max()) + 1
    loose = np.setdiff1d(labels, labels[held])
    if count == 1 or loose.size == 0:
        return ""
    first = int(np.flatnonzero(labels == loose[0])[0])
    free = f"{loose.size} of {count} parts of the mesh are not held (one of them has vertex {first}, counted from 0)"
    if wanted:
        return f"{free}: each takes six modes; ask for as many more, or hold it"
    return (
        f"{free} and would only fall; take one part (component 'largest', or its number from 0 by falling area), "
        f"{_joining(mesh)}hold each of them, or ask for all as they are (component 'all', in Python loose_parts=True)"
    )


def parts_by_area(mesh: TriangleMesh) -> Index:
    """Labels of the parts, the largest first."""
    areas = np.bincount(mesh.components[mesh.faces[:, 0]], weights=mesh.face_areas)
    return np.argsort(-areas, kind="stable")


def _joining(mesh: TriangleMesh) -> str:
    """Advice on a distance to join parts by, if a small one suffices and leaves a valid mesh; else ""."""
    size = mesh.size
    distance = 1.01 * float(_gaps(mesh, _NEAR * size).max()) + 1e-12 * size
    if not distance <= _NEAR * size:
        return ""
    distance = float(f"{1.1 * distance:.1e}")
    try:
        return f"join what touches (join {distance:g} [m]), " if mesh.weld(distance).components.max() == 0 else ""
    except MeshError:
        return ""


def _gaps(mesh: TriangleMesh, limit: float) -> Array:
    """Distance from each part to the nearest vertex of another, infinite from ``limit`` on (or in a dense cluster)."""
    labels, vertices = mesh.components, mesh.vertices
    tree, open_ones = cKDTree(vertices), np.arange(len(vertices))
    gaps = np.full(int(labels.max()) + 1, np.inf)
    count = 2
    while open_ones.size and count <= _MOST_NEIGHBOURS:
        count = min(2 * count, len(vertices))
        distances, others = tree.query(vertices[open_ones], k=count, distance_upper_bound=limit)
        known = np.isfinite(distances)
        foreign = known & (labels[np.where(known, others, 0)] != labels[open_ones][:, None])
        nearest = np.where(foreign, distances, np.inf).min(axis=1)
        np.minimum.at(gaps, labels[open_ones], nearest)
        open_ones = open_ones[known[:, -1] & ~np.isfinite(nearest)] if count < len(vertices) else open_ones[:0]
    return gaps
