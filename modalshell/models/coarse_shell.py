"""Coarse shells: fewer vertices of the same surface, calibrated to the fine shell's lowest frequency."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import final

import numpy as np
from scipy.optimize import brentq

from modalshell.brief import brief
from modalshell.checks import checked_kind, shown
from modalshell.errors import MeshError, OptionError, SupportError
from modalshell.mesh import TriangleMesh
from modalshell.modes import solve_modes
from modalshell.modes.rigid import rigid_motions
from modalshell.reduction.prolongation import closest_points
from modalshell.shell import Isotropic, Material, Shell

_WIDEST = 2.5
"""Logarithm of the largest factor on the membrane that calibration tries."""
_MEMBRANE_SHARE = 0.1
"""Slope of the lowest eigenvalue over the membrane stiffness, both as logarithms, below which bending decides."""


@final
@brief
@dataclass(frozen=True)
class CoarseMesh:
    """A coarser mesh of the same surface.

    Attributes
    ----------
    mesh : TriangleMesh
        The mesh.
    name : str
        Short name.
    material : Material, Isotropic or None
        Where that is another than the fine shell's.
    cells : tuple of int, or None
        Cells along and across of a generated shape.
    """

    mesh: TriangleMesh
    name: str
    material: Material | Isotropic | None = None
    cells: tuple[int, int] | None = None


def coarse_shell(shell: Shell, mesh: TriangleMesh, material: Material | Isotropic | None = None) -> Shell:
    """A coarse shell on ``mesh`` with the supports of ``shell`` and, by calibration, its lowest frequency.

    A coarse mesh is too stiff, mostly in its membrane: that is scaled until the lowest elastic eigenvalues agree; or
    the flexure, where the lowest mode hardly stretches. Sheets of :class:`Isotropic` need no calibration. To clamp
    alike, give ``mesh`` a row of vertices where the fine shell's held region ends.

    Parameters
    ----------
    shell : Shell
        The fine shell.
    mesh : TriangleMesh
        The same surface with fewer vertices.
    material : Material or Isotropic, optional
        Stiffnesses for ``mesh``; without it those of ``shell``, which must then be single numbers, or functions of an
        :class:`Isotropic`. The shear stiffness of a :class:`Material`, a force, is scaled by edge length.

    Raises
    ------
    OptionError
        If ``material`` is left out and that of ``shell`` has values of single elements.
    SupportError
        If no vertex of ``mesh`` lies where ``shell`` is held.
    """
    checked_kind("shell", shell, Shell)
    checked_kind("mesh", mesh, TriangleMesh)
    shell.require_clamps("a coarse shell")
    given = shell.material if material is None else material
    if not isinstance(given, Material | Isotropic):
        raise OptionError(f"material must be a Material or an Isotropic (got {shown(given)})")
    if material is None and any(isinstance(getattr(given, part.name), np.ndarray) for part in fields(given)):
        raise OptionError("the fine shell's material has a value an element: pass the material of the coarse mesh")
    nearest, shares, _ = closest_points(shell.mesh, mesh.vertices)
    corners = shell.mesh.faces[nearest, shares.argmax(axis=1)]
    clamped = shell.clamped[corners]
    if shell.clamped.any() and not clamped.any():
        raise SupportError("no vertex of the coarse mesh lies where the fine shell is held: refine it there")
    if isinstance(given, Isotropic):
        return Shell(mesh, given, clamped, energies=shell.energies)
    if material is None:
        ratio = float(mesh.edge_lengths.mean() / shell.mesh.edge_lengths.mean())
        given = replace(given, shear=given.shear * ratio)
    goal = _lowest(shell)
    if not goal > 0.0:
        raise OptionError(
            f"a coarse shell is calibrated on the lowest mode of the fine one, which has no stiffness (got {goal:g}): "
            "give the material more, or pass the coarse mesh's own"
        )

    def stiffened(membrane: float, flexure: float) -> Shell:
        changed = replace(
            given, stretch=given.stretch * membrane, shear=given.shear * membrane, flexure=given.flexure * flexure
        )
        return Shell(mesh, changed, clamped, energies=shell.energies)

    def excess(logarithm: float) -> float:
        return float(np.log(_lowest(stiffened(np.exp(logarithm), 1.0)) / goal))

    low, middle, high = excess(-_WIDEST), excess(0.0), excess(_WIDEST)
    if high - low > _MEMBRANE_SHARE * 2.0 * _WIDEST and low < 0.0 < high:
        return stiffened(float(np.exp(brentq(excess, -_WIDEST, _WIDEST, xtol=1e-3))), 1.0)
    return stiffened(1.0, float(np.exp(-middle)))


def drawn_to_supports(shell: Shell, mesh: TriangleMesh) -> TriangleMesh:
    """A coarse mesh with a second row of vertices where the held region of ``shell`` ends.

    With one held row it would be hinged where the fine shell is clamped. The neighbours of that row are moved onto the
    held vertices nearest to them.
    """
    nearest, shares, _ = closest_points(shell.mesh, mesh.vertices)
    held = shell.clamped[shell.mesh.faces[nearest, shares.argmax(axis=1)]]
    if not held.any() or held[mesh.faces].all(axis=1).any():
        return mesh
    beside = np.zeros(len(held), dtype=bool)
    beside[mesh.faces[held[mesh.faces].any(axis=1)]] = True
    places = shell.rest_positions[shell.clamped]
    vertices = np.array(mesh.vertices)
    for vertex in np.flatnonzero(beside & ~held):
        vertices[vertex] = places[np.argmin(np.linalg.norm(places - vertices[vertex], axis=1))]
    try:
        moved = TriangleMesh(vertices, mesh.faces)
    except MeshError:  # the fine shell has one held row too
        return mesh
    return moved if moved.face_areas.min() > 0.02 * moved.face_areas.mean() else mesh


def _lowest(shell: Shell) -> float:
    """Lowest elastic eigenvalue [1/s^2]."""
    rigid = rigid_motions(shell).shape[1]
    return float(solve_modes(shell, rigid + 1).eigenvalues[-1])
