"""Where the calibration of hinges and edge springs on a mesh is known to miss an isotropic sheet."""

from __future__ import annotations

import numpy as np

from modalshell.errors import REPAIR
from modalshell.mesh import TriangleMesh
from modalshell.shell.bending import BendingConstants
from modalshell.shell.orientation import Orientation

_REGULAR = 0.95
"""Share of interior vertices of six edges from which a mesh counts as a regular lattice."""
_EQUILATERAL = 0.95
"""Median of ``4 sqrt(3) A / sum l^2`` from which triangles count as equilateral; half squares have 0.87."""
_POISSON = 0.15
"""Poisson's ratio below which bending in the plane is 6 to 18 % off on meshes that are not equilateral."""
_DIMPLE = 5.0
"""Area of a cell over thickness times length above which flat strips of other triangles are over 5 % too stiff."""
_ACROSS = 1.25
"""Ratio of the stiffnesses along and across above which a plate is not isotropic."""
_SLIVERS = 3.0
"""Stiffness of a plate over that of a narrow strip from which thin triangles rule the constants; sound meshes: 1.8."""
_END = 0.04
"""Share by which the stiffness of a strip may change with the end that is clamped, each way."""


def calibration_doubts(
    mesh: TriangleMesh,
    orientation: Orientation,
    constants: BendingConstants,
    poisson: float,
    thickness: float,
    narrow: bool,
) -> list[str]:
    """What is known to be off, in words with numbers; empty where nothing is.

    Bending in two directions and twist are off on every mesh and are not listed: no load is known here.
    """
    doubts = []
    equilateral = is_equilateral(mesh)
    if orientation.elongated and not orientation.flat and poisson < _POISSON and not equilateral:
        doubts.append(
            f"bending in the plane of the sheet is up to 18 % off at Poisson's ratio {poisson:g} on triangles that are "
            "not equilateral"
        )
    slack = 2.0 * mesh.area / len(mesh.faces) / (thickness * orientation.length)
    if narrow and orientation.flat and slack > _DIMPLE and not equilateral:
        doubts.append(
            f"the sheet is so thin (length over thickness {orientation.length / thickness:.0f}) that its facets cannot "
            f"dimple as it does, and it bends 5 to 15 % too stiffly; it takes at least "
            f"{int(np.ceil(len(mesh.faces) * slack / _DIMPLE))} triangles (got {len(mesh.faces)}), or equilateral ones"
        )
    if narrow and len(constants.ends) == 2:
        spread = abs(constants.ends[0] - constants.ends[1]) / sum(constants.ends)
        if spread > _END:
            doubts.append(
                f"the rows at the ends are not straight, so that a clamp at one end or the other makes the strip "
                f"{100.0 * spread:.0f} % too soft or too stiff"
            )
    if constants.wide > _SLIVERS * constants.narrow:
        doubts.append(
            "triangles that are long and low have hinges so stiff that they rule the mean: a plate would be "
            f"{constants.wide / constants.narrow:.2g} times as stiff as a narrow strip; take them away ({REPAIR} does "
            "from an aspect of 1e4)"
        )
    ratio = constants.across / constants.wide
    if not narrow and not 1.0 / _ACROSS <= ratio <= _ACROSS and np.isfinite(ratio):
        doubts.append(
            f"the cells are longer one way than the other, and the stiffness across the calibrated direction is "
            f"{ratio:.2f} times that along it"
        )
    return doubts


def is_equilateral(mesh: TriangleMesh) -> bool:
    """Whether almost every interior vertex has six edges and the triangles are nearly equilateral."""
    degrees = np.bincount(mesh.edges.ravel(), minlength=len(mesh.vertices))
    inner = np.ones(len(mesh.vertices), dtype=bool)
    inner[mesh.boundary_vertices] = False
    squares = (mesh.edge_lengths[mesh.face_edges] ** 2).sum(axis=1)
    quality = np.median(4.0 * np.sqrt(3.0) * mesh.face_areas / squares)
    return bool(quality >= _EQUILATERAL and (degrees[inner] == 6).sum() >= _REGULAR * inner.sum())
