"""Coarse shells: fewer vertices of the same surface, calibrated to the fine shell's lowest frequencies."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, final

import numpy as np
from scipy.optimize import brentq
from scipy.spatial import cKDTree

from modalshell.brief import brief
from modalshell.checks import checked_count, checked_kind, shown
from modalshell.errors import MeshError, OptionError, SupportError
from modalshell.mesh import TriangleMesh
from modalshell.models.coarse_mesh import remeshed_to_supports
from modalshell.modes import solve_modes
from modalshell.modes.rigid import rigid_motions
from modalshell.reduction.prolongation import closest_points
from modalshell.shell import Isotropic, Material, Shell
from modalshell.typing import Array, Index

_WIDEST = 2.5
"""Logarithm of the largest factor on the membrane that calibration tries."""
_SOFTEST, _STIFFEST = -1.2, 0.6
"""Logarithms of the membrane's factor beyond which the flexure is scaled in its place: meshes are not so far apart."""
_MEMBRANE_SHARE = 0.1
"""Slope of the lowest eigenvalue over the membrane stiffness, both as logarithms, below which bending decides."""
_COMPARED = 6
"""Lowest modes among which one is looked for that the other stiffness decides."""
_APART = 0.3
"""Least difference of two modes' fractions of membrane energy for them to determine both stiffnesses."""
_ALIKE = 0.7
"""Square of the cosine between a fine mode and the coarse one that is it."""
_TWISTED = 0.5
"""Part of the logarithm of the flexure's factor that is taken from a mode above the lowest: uniform bends need less."""
_SAME = 1e-6
"""Relative distance and difference of areas below which a surface is the same."""
_ROUNDS, _MET = 12, 1e-4
"""Newton steps on both stiffnesses at most, and the logarithm of a ratio of eigenvalues that counts as met."""


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
    options : mapping
        Keys of a scene's ``[model]`` table that make it: ``cells`` of a generated shape, or ``triangles``; empty if no
        scene can name it.
    """

    mesh: TriangleMesh
    name: str
    material: Material | Isotropic | None = None
    options: Mapping[str, Any] = field(default_factory=dict)


def remeshed(shell: Shell, triangles: int) -> CoarseMesh:
    """The surface of ``shell`` in about ``triangles`` triangles; see :func:`remeshed_to_supports`."""
    mesh = remeshed_to_supports(shell, triangles)
    return CoarseMesh(mesh, f"{triangles} triangles", options={"triangles": triangles})


def coarse_shell(shell: Shell, mesh: TriangleMesh | int, material: Material | Isotropic | None = None) -> Shell:
    """A coarse shell on ``mesh`` with the supports of ``shell`` and, by calibration, its lowest frequencies.

    A coarse mesh is too stiff in its membrane and, with hinges, too soft or too stiff against bending. Where one of the
    lowest six modes is decided by the membrane and another by bending, the lowest of them included, both stiffnesses
    are scaled until the elastic eigenvalues of these two agree. Where the membrane decides the lowest, the flexure is
    scaled by half as much, as a logarithm: the bending mode is then a twist, and uniform bends ask for less. Else one
    stiffness is scaled, until the lowest eigenvalues agree: the membrane, or the flexure where the lowest mode hardly
    stretches or the membrane's factor would be beyond 0.3 to 1.8. Sheets of :class:`Isotropic` need no calibration. To
    clamp alike, give ``mesh`` a row of vertices where the fine shell's held region ends.

    Parameters
    ----------
    shell : Shell
        The fine shell.
    mesh : TriangleMesh or int
        The same surface with fewer vertices; or about how many triangles to remesh it in (extra ``remesh``), with an
        edge wherever the clamped region ends. On hinges the new mesh has a twist stiffness of its own: compare.
    material : Material or Isotropic, optional
        Stiffnesses for ``mesh``; without it those of ``shell``, which must then be single numbers, or functions of an
        :class:`Isotropic`. The shear stiffness of a :class:`Material`, a force, is scaled by edge length.

    Returns
    -------
    Shell
        The coarse shell.

    Raises
    ------
    OptionError
        If ``material`` is left out and that of ``shell`` has values of single elements, or if a number of triangles
        is given and MeshLab is not installed or they are not fewer than those of ``shell``.
    MeshError
        If MeshLab fails on this surface.
    SupportError
        If no vertex of ``mesh`` lies where ``shell`` is held, or if those that do leave it free to turn.
    """
    checked_kind("shell", shell, Shell)
    shell.require_clamps("a coarse shell")
    if not isinstance(mesh, TriangleMesh):
        if isinstance(mesh, bool) or not isinstance(mesh, int | np.integer):
            raise OptionError(f"mesh must be a TriangleMesh or a number of triangles (got {shown(mesh)})")
        mesh = remeshed_to_supports(shell, checked_count("mesh", mesh, at_least=4))
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
    if clamped.any() and rigid_motions(Shell(mesh, given, clamped)).shape[1] > rigid_motions(shell).shape[1]:
        raise SupportError(
            "a row of held vertices leaves the coarse shell free to turn where the fine one is clamped: give its "
            "mesh a second row there, as drawn_to_supports does"
        )
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

    if (both := _both_stiffnesses(shell, stiffened, nearest, shares)) is not None:
        return both

    def excess(logarithm: float) -> float:
        return float(np.log(_lowest(stiffened(np.exp(logarithm), 1.0)) / goal))

    low, middle, high = excess(-_WIDEST), excess(0.0), excess(_WIDEST)
    if high - low > _MEMBRANE_SHARE * 2.0 * _WIDEST and low < 0.0 < high:
        membrane = float(brentq(excess, -_WIDEST, _WIDEST, xtol=1e-3))
        if _SOFTEST < membrane < _STIFFEST:
            return stiffened(float(np.exp(membrane)), 1.0)
    return stiffened(1.0, float(np.exp(-middle)))


def _both_stiffnesses(
    shell: Shell, stiffened: Callable[[float, float], Shell], nearest: Index, shares: Array
) -> Shell | None:
    """Coarse shell with both stiffnesses scaled to two modes of ``shell``; None if no two modes determine them.

    Coarse vertices lie on the fine mesh in triangles ``nearest`` (k,), at barycentric ``shares`` (k, 3).
    """
    eigenvalues, modes, parts = _elastic_modes(shell)
    apart = parts[0, 0] - parts[:, 0]
    if apart.max() >= _APART:
        pair, taken = [0, int(np.argmax(apart >= _APART))], _TWISTED
    elif apart.min() <= -_APART:
        pair, taken = [int(np.argmax(apart <= -_APART)), 0], 1.0
    else:
        return None
    corners = modes.reshape(len(shell.mass), 3, -1)[shell.mesh.faces[nearest]]
    sampled = np.einsum("kc,kcxm->kxm", shares, corners)[:, :, pair].reshape(-1, 2)
    factors = np.zeros(2)
    for _ in range(_ROUNDS):
        coarse = stiffened(*np.exp(factors))
        found, own, sensitivities = _elastic_modes(coarse)
        mass = np.repeat(coarse.mass, 3)[:, None]
        lengths = np.sum(mass * sampled**2, axis=0)[:, None] * np.sum(mass * own**2, axis=0)
        alike = (sampled.T @ (mass * own)) ** 2 / lengths
        same = alike.argmax(axis=1)
        if alike.max(axis=1).min() < _ALIKE or same[0] == same[1]:
            return None
        excess = np.log(found[same] / eigenvalues[pair])
        slope = sensitivities[same]
        excess[1] += (1.0 / taken - 1.0) * slope[1, 1] * factors[1]
        slope[1, 1] /= taken
        if np.abs(excess).max() < _MET:
            return coarse
        if abs(np.linalg.det(slope)) < 0.5 * _APART:
            return None
        factors -= np.linalg.solve(slope, excess).clip(-1.0, 1.0)
        if np.abs(factors).max() > _WIDEST:
            return None
    return None


def _elastic_modes(shell: Shell) -> tuple[Array, Array, Array]:
    """Lowest elastic eigenvalues (k,), modes (3n, k), and the shares (k, 2) of membrane and flexure in their energy."""
    rigid = rigid_motions(shell).shape[1]
    basis = solve_modes(shell, min(rigid + _COMPARED, shell.unknowns.count))
    modes = basis.modes[:, rigid:]
    rest, parts = shell.rest_positions, np.zeros((modes.shape[1], 2))
    offsets = shell.predicted_stresses(rest, np.zeros_like(rest))
    for mode, part in zip(modes.T, parts, strict=True):
        stresses = shell.predicted_stresses(rest, mode.reshape(-1, 3))
        for elements, stress, offset in zip(shell.elements, stresses, offsets, strict=True):
            stiff = elements.weight != 0
            energy = float(np.sum((stress - offset)[stiff] ** 2 / (4.0 * elements.weight[stiff])))
            if elements.name in ("stretch", "shear"):
                part[0] += energy
            elif elements.name.endswith("flexure"):
                part[1] += energy
    eigenvalues = np.asarray(basis.eigenvalues[rigid:])
    return eigenvalues, modes, 2.0 * parts / eigenvalues[:, None]


def drawn_to_supports(shell: Shell, mesh: TriangleMesh) -> TriangleMesh:
    """A coarse mesh with a second row of vertices where the held region of ``shell`` ends.

    With one held row it would be hinged where the fine shell is clamped. The neighbours of that row are moved to the
    nearest points of held edges. The other vertices follow, the farthest not at all, where that keeps the surface and
    its outline: rows stay evenly apart.
    """
    nearest, shares, _ = closest_points(shell.mesh, mesh.vertices)
    held = shell.clamped[shell.mesh.faces[nearest, shares.argmax(axis=1)]]
    if not held.any() or held[mesh.faces].all(axis=1).any():
        return mesh
    beside = np.zeros(len(held), dtype=bool)
    beside[mesh.faces[held[mesh.faces].any(axis=1)]] = True
    beside &= ~held
    edges = shell.mesh.edges[shell.clamped[shell.mesh.edges].all(axis=1)]
    if not beside.any() or len(edges) == 0:
        return mesh
    row = mesh.vertices[beside]
    moves = _nearest_on_edges(shell.rest_positions[edges], row) - row
    drawn = np.array(mesh.vertices)
    drawn[beside] += moves
    try:
        moved = TriangleMesh(drawn, mesh.faces)
    except MeshError:  # the fine shell has one held row too
        return mesh
    if moved.face_areas.min() <= 0.02 * moved.face_areas.mean():
        return mesh
    rest = ~held & ~beside
    distances, leaders = (np.asarray(found) for found in cKDTree(row).query(mesh.vertices[rest]))
    drawn[rest] += (1.0 - distances / distances.max(initial=0.0))[:, None] * moves[leaders]
    try:
        even = TriangleMesh(drawn, mesh.faces)
    except MeshError:
        return moved
    off = closest_points(shell.mesh, even.vertices)[2].max() / mesh.size
    grown = abs(even.face_areas.sum() / moved.face_areas.sum() - 1.0)
    return even if max(off, grown) < _SAME else moved


def _nearest_on_edges(edges: Array, points: Array) -> Array:
    """Nearest points (k, 3) of edges (e, 2, 3) to ``points`` (k, 3)."""
    arms, starts = edges[:, 1] - edges[:, 0], edges[:, 0]
    shares = np.einsum("kex,ex->ke", points[:, None] - starts, arms) / np.sum(arms**2, axis=1)
    candidates = starts + shares.clip(0.0, 1.0)[:, :, None] * arms
    chosen = np.linalg.norm(candidates - points[:, None], axis=2).argmin(axis=1)
    return np.asarray(candidates[np.arange(len(points)), chosen])


def _lowest(shell: Shell) -> float:
    """Lowest elastic eigenvalue [1/s^2]."""
    rigid = rigid_motions(shell).shape[1]
    return float(solve_modes(shell, rigid + 1).eigenvalues[-1])
