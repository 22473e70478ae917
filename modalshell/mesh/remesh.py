"""Remeshing with nearly equilateral triangles, coarser or finer, by MeshLab (extra ``remesh``)."""

from __future__ import annotations

import importlib.util
import warnings

import numpy as np

from modalshell.core.checks import checked_count, checked_kind, checked_number
from modalshell.core.errors import MeshError, ModalShellWarning, OptionError
from modalshell.core.memory import demand_memory
from modalshell.mesh.repair import repair
from modalshell.mesh.triangle_mesh import TriangleMesh

_PASSES, _NEAR = 4, 0.03
"""Number of edge lengths tried, and the accepted relative error of the triangle count."""
_FAR = 0.25
"""Relative error of the triangle count above which a warning is given."""
_BYTES = 1000.0
"""Memory of MeshLab per triangle [bytes]."""
_ITERATIONS = 10
"""Rounds of splitting, collapsing, flipping and smoothing."""


def remesh(mesh: TriangleMesh, triangles: int, *, crease: float = 25.0) -> TriangleMesh:
    """Remesh a surface with about as many nearly equilateral triangles as requested.

    Edges are split, collapsed and flipped towards one length, and vertices are smoothed on the surface
    [botsch2004]; boundaries and creases stay where they are, but their vertices slide along them. The surface moves by
    1 % of the bounding box's diagonal at most, so that a coarse mesh may keep more triangles where it is strongly
    curved. Vertex numbers change: select supports again.

    Parameters
    ----------
    mesh : TriangleMesh
        The surface.
    triangles : int
        Number of triangles, at least 4.
    crease : float
        Angle between neighbouring triangles from which their edge is kept as a crease [degrees], between 0 and 180.

    Returns
    -------
    TriangleMesh
        The mesh; a :class:`ModalShellWarning` says where it has more than a quarter more or fewer triangles.

    Raises
    ------
    OptionError
        If MeshLab is not installed, or an option is out of range.
    MeshError
        If MeshLab fails on this surface, or the mesh has junctions, whose sheets it would part.
    """
    checked_kind("mesh", mesh, TriangleMesh)
    if mesh.joints.edges.size:
        raise MeshError(
            f"remeshing would part the sheets that meet at {len(mesh.junctions)} junctions and {len(mesh.seams)} seams "
            "of this mesh: mesh each sheet apart, with the same vertices along the junctions, and weld them "
            "(TriangleMesh.from_soup)"
        )
    asked = checked_count("triangles", triangles, at_least=4)
    demand_memory(f"a mesh of {asked} triangles", _BYTES * asked, "ask for fewer triangles")
    angle = checked_number("crease", crease, above=0.0, at_most=180.0, unit="degrees")
    if importlib.util.find_spec("pymeshlab") is None:
        raise OptionError("remeshing needs pymeshlab, which is not installed: pip install 'modalshell[remesh]'")
    length = float(np.sqrt(4.0 / np.sqrt(3.0) * mesh.area / asked))
    made = _of_length(mesh, length, angle)
    for _ in range(_PASSES - 1):
        if abs(len(made.faces) / asked - 1.0) <= _NEAR:
            break
        length *= float(np.sqrt(len(made.faces) / asked))
        other = _of_length(mesh, length, angle)
        if abs(len(other.faces) - asked) >= abs(len(made.faces) - asked):
            break
        made = other
    if abs(len(made.faces) / asked - 1.0) > _FAR:
        warnings.warn(
            f"the mesh has {len(made.faces)} triangles, not {asked}: with so few it would leave its surface or lose a "
            "boundary",
            ModalShellWarning,
            stacklevel=2,
        )
    return made


def _of_length(mesh: TriangleMesh, length: float, crease: float) -> TriangleMesh:
    """The surface in triangles whose edges are about ``length`` [m]."""
    import pymeshlab

    size = mesh.size  # MeshLab takes lengths far from 1 for degenerate
    held = pymeshlab.MeshSet()
    held.add_mesh(pymeshlab.Mesh(mesh.vertices / size, mesh.faces))
    try:
        held.meshing_isotropic_explicit_remeshing(
            targetlen=pymeshlab.PureValue(length / size), iterations=_ITERATIONS, featuredeg=crease
        )
    except pymeshlab.PyMeshLabException as error:
        raise MeshError(f"MeshLab could not remesh the surface ({error}); repair the mesh first") from error
    made = held.current_mesh()
    return repair(size * made.vertex_matrix(), made.face_matrix(), split=True)[0]
