"""Remeshing with nearly equilateral triangles, coarser or finer, by MeshLab (extra ``remesh``)."""

from __future__ import annotations

import importlib.util
import warnings
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from modalshell.core.checks import as_array, checked_count, checked_kind, checked_number
from modalshell.core.errors import MeshError, ModalShellWarning, OptionError
from modalshell.core.memory import demand_memory
from modalshell.core.typing import Array, Index
from modalshell.mesh.closest import closest_points, edges_along
from modalshell.mesh.repair import repair
from modalshell.mesh.topology import connected_parts, numbers_of_edges
from modalshell.mesh.triangle_mesh import TriangleMesh
from modalshell.mesh.welding import drop_unused

_PASSES, _NEAR = 4, 0.03
"""Number of edge lengths tried, and the accepted relative error of the triangle count."""
_FAR = 0.25
"""Relative error of the triangle count above which a warning is given."""
_BYTES = 1000.0
"""Memory of MeshLab per triangle [bytes]."""
_ITERATIONS = 10
"""Rounds of splitting, collapsing, flipping and smoothing."""
_LOST = 0.03
"""Relative change of the length of junctions and kept edges, from which they count as lost."""


def remesh(mesh: TriangleMesh, triangles: int, *, crease: float = 25.0, keep: ArrayLike | None = None) -> TriangleMesh:
    """Remesh a surface with about as many nearly equilateral triangles as requested.

    Edges are split, collapsed and flipped towards one length, and vertices are smoothed on the surface
    [botsch2004]; boundaries, creases and junctions stay where they are, but their vertices slide along them. The
    surface moves by 1 % of the bounding box's diagonal at most, so that a coarse mesh may keep more triangles where it
    is strongly curved. Vertex numbers change: select supports again. Meshes of some fifty triangles may differ from
    process to process, as MeshLab goes through them in the order of their addresses.

    Parameters
    ----------
    mesh : TriangleMesh
        The surface.
    triangles : int
        Number of triangles, at least 4.
    crease : float
        Angle between neighbouring triangles from which their edge is kept as a crease [degrees], between 0 and 180.
    keep : array_like of int, shape (k, 2), optional
        Pairs of vertices whose edges are to lie along edges of the new mesh too, such as lines where a material ends.

    Returns
    -------
    TriangleMesh
        The mesh; a :class:`ModalShellWarning` says where it has more than a quarter more or fewer triangles.

    Raises
    ------
    OptionError
        If MeshLab is not installed, an option is out of range, or a pair of ``keep`` is no edge.
    MeshError
        If MeshLab fails on this surface, loses a junction or an edge of ``keep``, or the surface is one-sided.
    """
    checked_kind("mesh", mesh, TriangleMesh)
    if mesh.seams.size:
        raise MeshError(
            f"remeshing takes no one-sided surface (got one with {len(mesh.seams)} seams): cut it open first "
            "(modalshell repair --split)"
        )
    asked = checked_count("triangles", triangles, at_least=4)
    demand_memory(f"a mesh of {asked} triangles", _BYTES * asked, "ask for fewer triangles")
    angle = checked_number("crease", crease, above=0.0, at_most=180.0, unit="degrees")
    if importlib.util.find_spec("pymeshlab") is None:
        raise OptionError("remeshing needs pymeshlab, which is not installed: pip install 'modalshell[remesh]'")
    edges = _kept_edges(mesh, keep)
    length = float(np.sqrt(4.0 / np.sqrt(3.0) * mesh.area / asked))
    made, after = _of_length(mesh, length, angle, edges), 0.0
    for _ in range(_PASSES - 1):
        if abs(len(made.faces) / asked - 1.0) <= _NEAR:
            break
        after = after or length * float(np.sqrt(len(made.faces) / asked))
        other = _of_length(mesh, after, angle, edges)
        if abs(len(other.faces) - asked) < abs(len(made.faces) - asked):
            made, length, after = other, after, 0.0
        elif (len(other.faces) - asked) * (len(made.faces) - asked) < 0:
            after = float(np.sqrt(length * after))  # the number leaps between the two
        else:
            break
    if abs(len(made.faces) / asked - 1.0) > _FAR:
        few = len(made.faces) < asked
        why = "next to this the number leaps" if few else "with so few it would leave its surface or lose a boundary"
        warnings.warn(
            f"the mesh has {len(made.faces)} triangles, not {asked}: {why}",
            ModalShellWarning,
            stacklevel=2,
        )
    return made


def _kept_edges(mesh: TriangleMesh, keep: ArrayLike | None) -> Index:
    """Edges of two faces to keep (k,): others are kept as boundaries or junctions."""
    if keep is None:
        return np.empty(0, dtype=np.int64)
    pairs = as_array("keep", keep, "pairs of vertices (k, 2)", OptionError, "iu")
    if pairs.ndim != 2 or pairs.shape[1] != 2:
        raise OptionError(f"keep must be pairs of vertices (k, 2) (got shape {pairs.shape})")
    edges = numbers_of_edges(mesh.edges, pairs)
    if (edges < 0).any():
        raise OptionError(f"keep names the pair {tuple(pairs[np.argmax(edges < 0)].tolist())}, which is no edge")
    inner = mesh.edge_faces[edges, 1] >= 0
    return np.setdiff1d(edges[inner], mesh.junctions)


def _of_length(mesh: TriangleMesh, length: float, crease: float, keep: Index) -> TriangleMesh:
    """The surface in triangles whose edges are about ``length`` [m], with edges along those of ``keep`` (k,)."""
    import pymeshlab

    size = mesh.size  # MeshLab takes lengths far from 1 for degenerate
    given = (mesh.vertices, mesh.faces) if not keep.size else with_fins(mesh, keep, length)
    held = pymeshlab.MeshSet()
    held.add_mesh(pymeshlab.Mesh(given[0] / size, given[1]))
    try:
        held.meshing_isotropic_explicit_remeshing(
            targetlen=pymeshlab.PureValue(length / size), iterations=_ITERATIONS, featuredeg=crease
        )
    except pymeshlab.PyMeshLabException as error:
        raise MeshError(f"MeshLab could not remesh the surface ({error}); repair the mesh first") from error
    found = held.current_mesh()
    joined = bool(keep.size or mesh.junctions.size)
    made = repair(size * found.vertex_matrix(), found.face_matrix(), split=not joined)[0]
    if not joined:
        return made
    made = made if not keep.size else without_fins(made, mesh, given)
    refuse_losses(made, mesh, keep, length)
    return made


def refuse_losses(made: TriangleMesh, mesh: TriangleMesh, keep: Index, length: float) -> None:
    """MeshError where edges to keep, or junctions, are no longer edges of the new mesh, or no junctions."""
    for name, wanted, among in (("junctions", mesh.junctions, made.junctions), ("edges to keep", keep, None)):
        if not wanted.size:
            continue
        along = edges_along(made, mesh.vertices[mesh.edges[wanted]])[0]
        along = along if among is None else np.intersect1d(along, among)
        whole, left = (float(lengths.sum()) for lengths in (mesh.edge_lengths[wanted], made.edge_lengths[along]))
        if abs(left / whole - 1.0) > _LOST:
            raise MeshError(
                f"remeshing in edges of {length:.3g} m keeps {left:.4g} m of {whole:.4g} m of {name}: ask for more "
                "triangles"
            )


def with_fins(mesh: TriangleMesh, edges: Index, height: float) -> tuple[Array, Index]:
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


def without_fins(made: TriangleMesh, mesh: TriangleMesh, finned: tuple[Array, Index]) -> TriangleMesh:
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
