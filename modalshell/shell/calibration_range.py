"""Known limits of the calibration of hinges and edge springs to an isotropic sheet."""

from __future__ import annotations

import warnings
from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull

from modalshell.core.errors import REPAIR, ModalShellWarning
from modalshell.core.typing import Array, Mask
from modalshell.mesh import TriangleMesh
from modalshell.shell.bending import BendingConstants
from modalshell.shell.orientation import Orientation, orient

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
_AROUND = 0.95, 1.05
"""Stiffness of a ring around its axis over what is asked, outside which that is said."""
_SLIVERS = 3.0
"""Stiffness of a plate over that of a narrow strip from which thin triangles rule the constants; sound meshes: 1.8."""
_STRETCHED, _STRETCHED_DIMPLE = 0.8, 0.2
"""Extent along over across of a regular lattice's triangles below which, and slack above which, it is too stiff."""
_FEW, _SAME = 3.5, 0.02
"""Edges across below which strips of unequal triangles are up to 12 % off, and by how much areas may differ."""
_PARALLEL = 0.99
"""Cosine from which an edge runs along a strip."""
_END_OF_AXIS = 0.26
"""Share of a sheet's length that its clamped end may take on a coarse mesh."""
_SPANNED = 0.35
"""Share of a sheet's area that supports span, from which they hold more than one end."""
_END = 0.04
"""Share by which the stiffness of a strip may change with the end that is clamped, each way."""


class Doubt(NamedTuple):
    """A known error of the calibration: whether it is one on this mesh, and what is said then."""

    when: bool
    text: str


def calibration_doubts(
    mesh: TriangleMesh,
    orientation: Orientation,
    constants: BendingConstants,
    poisson: float,
    thickness: float,
    narrow: bool,
) -> list[str]:
    """Known errors of the calibration on this mesh, as texts with numbers; empty if there are none.

    Bending in two directions and twist are off on every mesh, and said where supports are known:
    :func:`warn_of_two_way_bending`.
    """
    equilateral, quality = is_equilateral(mesh), _quality(mesh)
    slack = 2.0 * mesh.area / len(mesh.faces) / (thickness * orientation.length)
    first, last = constants.ends if len(constants.ends) == 2 else (1.0, 1.0)
    spread = abs(first - last) / (first + last)
    cells = mesh.area / orientation.length / float(mesh.edge_lengths.mean())
    slivers, across = constants.wide / constants.narrow, constants.across / constants.wide
    around = constants.around / (constants.narrow if narrow else constants.wide)
    doubts = [
        Doubt(
            orientation.elongated and not orientation.flat and poisson < _POISSON and not equilateral,
            f"bending in the plane of the sheet is up to 18 % off at Poisson's ratio {poisson:g} on triangles that are "
            "not equilateral",
        ),
        Doubt(
            narrow and orientation.flat and slack > _DIMPLE and not equilateral,
            f"the sheet is so thin (length over thickness {orientation.length / thickness:.0f}) that its facets cannot "
            f"dimple as it does, and it bends 5 to 15 % too stiffly; it takes at least "
            f"{np.ceil(len(mesh.faces) * slack / _DIMPLE):.0f} triangles (got {len(mesh.faces)}), or equilateral ones",
        ),
        Doubt(
            orientation.elongated
            and orientation.flat
            and slack > _STRETCHED_DIMPLE
            and _is_stretched_across(mesh, orientation.axis),
            "the triangles of an 'equilateral' lattice are stretched across the strip, which then bends up to 17 % too "
            f"stiffly (quality {quality:.2f}, 1 is equilateral); take more cells across, or fewer along",
        ),
        Doubt(
            narrow and spread > _END,
            f"the rows at the ends are not straight, so that a clamp at one end or the other makes the strip "
            f"{100.0 * spread:.0f} % too soft or too stiff",
        ),
        Doubt(
            narrow and orientation.flat and cells < _FEW and not _has_equal_cells(mesh),
            f"a strip of unequal triangles with {cells:.1f} of them across is up to 12 % too soft or stiff; take at "
            f"least {_FEW:g} across, or a structured mesh",
        ),
        Doubt(
            slivers > _SLIVERS,
            "triangles that are long and low have hinges so stiff that they rule the mean: a plate would be "
            f"{slivers:.2g} times as stiff as a narrow strip; take them away ({REPAIR} does from an aspect of 1e4)",
        ),
        Doubt(
            np.isfinite(around) and not _AROUND[0] <= around <= _AROUND[1],
            "a closed ring is calibrated on the mean over directions, and bends around its axis about "
            f"{around:.2f} times as stiffly as asked, off still more where few triangles are across",
        ),
        Doubt(
            not narrow and np.isfinite(across) and not 1.0 / _ACROSS <= across <= _ACROSS,
            f"the cells are longer one way than the other, and the stiffness across the calibrated direction is "
            f"{across:.2f} times that along it",
        ),
    ]
    return [doubt.text for doubt in doubts if doubt.when]


def is_equilateral(mesh: TriangleMesh) -> bool:
    """Whether almost every interior vertex has six edges and the triangles are nearly equilateral."""
    return _quality(mesh) >= _EQUILATERAL and _is_regular(mesh)


def _has_equal_cells(mesh: TriangleMesh) -> bool:
    """Whether most triangles have the same area, as in structured meshes, but for those along their sides."""
    areas = mesh.face_areas / np.median(mesh.face_areas)
    return bool((np.abs(areas - 1.0) < _SAME).mean() > 0.5)


def _quality(mesh: TriangleMesh) -> float:
    """Median of ``4 sqrt(3) A / sum l^2`` over the triangles: 1 of equilateral ones, 0.87 of half squares."""
    squares = (mesh.edge_lengths[mesh.face_edges] ** 2).sum(axis=1)
    return float(np.median(4.0 * np.sqrt(3.0) * mesh.face_areas / squares))


def _is_stretched_across(mesh: TriangleMesh, axis: Array) -> bool:
    """Whether the triangles of a regular lattice without sides along ``axis`` are wider across it than along."""
    inner = mesh.edges[mesh.hinge_edges]
    sides = mesh.vertices[inner[:, 1]] - mesh.vertices[inner[:, 0]]
    parallel = np.abs(sides @ axis) > _PARALLEL * np.linalg.norm(sides, axis=1)
    if parallel.any() or not _is_regular(mesh):
        return False
    corners = mesh.vertices[mesh.faces]
    along, across = (np.ptp(corners @ way, axis=1).mean() for way in (axis, np.cross(mesh.face_normals[0], axis)))
    return bool(along < _STRETCHED * across)


def _is_regular(mesh: TriangleMesh) -> bool:
    """Whether almost every interior vertex has six edges."""
    degrees = np.bincount(mesh.edges.ravel(), minlength=len(mesh.vertices))
    inner = np.ones(len(mesh.vertices), dtype=bool)
    inner[mesh.boundary_vertices] = False
    return bool((degrees[inner] == 6).sum() >= _REGULAR * inner.sum())


def warn_of_two_way_bending(mesh: TriangleMesh, supported: Mask) -> None:
    """Warn where supports make a flat sheet bend in two directions: not only along one edge, or two opposite ones."""
    shape = orient(mesh, None)
    if not shape.flat or shape.elongated or not supported.any():
        return
    _, _, axes = np.linalg.svd(mesh.vertices - mesh.vertices.mean(axis=0), full_matrices=False)
    if _bends_two_ways(mesh.vertices @ axes[:2].T, supported):
        warnings.warn(
            "the supports make the sheet bend in two directions, where hinges calibrated by from_physical are off on "
            "any mesh (a simply supported square plate: first frequency 25 % too high, deflection 37 % too small), and "
            "so is their twist; ms.Isotropic(young, poisson, thickness, density) is shell theory",
            ModalShellWarning,
            stacklevel=3,
        )


def _bends_two_ways(places: Array, supported: Mask) -> bool:
    """Whether supported points of a plane sheet (n, 2) span it, and are not those of two opposite edges."""
    held = places[supported]
    if np.linalg.matrix_rank(held - held.mean(axis=0), tol=1e-9 * float(np.ptp(places))) < 2:
        return False
    outline = ConvexHull(places)
    if ConvexHull(held).volume < _SPANNED * outline.volume:  # in the plane the volume is the area
        return False
    sides = places[outline.simplices[:, 1]] - places[outline.simplices[:, 0]]
    for side in sides / np.linalg.norm(sides, axis=1)[:, None]:
        turn = np.column_stack((side, (-side[1], side[0])))
        low, size = (places @ turn).min(axis=0), np.ptp(places @ turn, axis=0)
        along, across = ((held @ turn - low) / size).T
        edges = across < _END_OF_AXIS, across > 1.0 - _END_OF_AXIS
        if (edges[0] | edges[1]).all() and all(
            (np.abs(along[edge] - 0.5) < 0.25).any() for edge in edges if edge.any()
        ):
            return False
    return True
