"""Coarse DS: discrete shells on a coarse mesh of the surface, carried to the fine one by a rotation-strain fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np
import scipy.sparse as sps
from scipy.optimize import brentq
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from modalshell.checks import checked_kind
from modalshell.constraints.constraints import Constraint
from modalshell.errors import MeshError, OptionError, SupportError
from modalshell.integrators.state import Damping, MotionState
from modalshell.mesh import TriangleMesh
from modalshell.models.base import Model
from modalshell.models.discrete_shell import DiscreteShell
from modalshell.models.equilibrium import Equilibrium
from modalshell.modes import solve_modes
from modalshell.modes.rigid import rigid_motions
from modalshell.reduction.poisson import PoissonFit
from modalshell.shell import Isotropic, Material, Shell
from modalshell.typing import Array, Index
from modalshell.work import count_products

_PROLONGED = 10_000
"""Operations that carrying positions to the fine mesh takes for each triangle of either mesh."""
_NEAR = 12
"""Coarse triangles, by their centres, among which the one under a fine point is looked for."""
_APART = 0.2
"""Distance between the meshes, as a share of the surface's size, from which they are not the same surface."""
_WIDEST = 2.5
"""Logarithm of the largest factor on the membrane that calibration tries."""
_MEMBRANE_SHARE = 0.1
"""Slope of the lowest eigenvalue over the membrane stiffness, both as logarithms, below which bending decides."""
_SMOOTH = np.cos(np.radians(20.0))
"""Cosine of the rest angle between triangles above which a fold is kept sharp when turns are averaged."""


@final
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


@final
class CoarseDiscreteShell(Model):
    """DS on fewer vertices: it bends, stiffens and snaps as a shell does, a little too stiff and a little too coarse.

    Rotations and strains of the coarse triangles, averaged at corners except across sharp folds, are interpolated to
    the fine triangles; the least-squares fit that also serves the rotation-strain warp [huang2011] puts the fine
    surface together. Loads are handed down with the weights that carry positions up.

    Parameters
    ----------
    shell : Shell
        The fine shell, whose positions are wanted.
    coarse : Shell
        The same surface with fewer vertices: its own material for its mesh, and the same supports; see
        :func:`coarse_shell`.

    Raises
    ------
    MeshError
        If the meshes lie apart: they are not the same surface.
    """

    name = "coarse DS"
    in_shell_frame = True

    def __init__(self, shell: Shell, coarse: Shell) -> None:
        self.shell = checked_kind("shell", shell, Shell)
        self.coarse = DiscreteShell(checked_kind("coarse", coarse, Shell))
        mesh, under = shell.mesh, coarse.mesh
        size = mesh.size
        below, vertex_shares, distance = closest_points(under, mesh.vertices)
        if distance.max() > _APART * size:
            worst = int(distance.argmax())
            raise MeshError(
                f"the coarse mesh is another surface: vertex {worst} is {distance[worst]:.3g} m from it, the shell is "
                f"{size:.3g} m long; make both from one shape"
            )
        self._below = below
        rows = np.repeat(np.arange(len(mesh.vertices)), 3)
        entries = (vertex_shares.ravel(), (rows, under.faces[below].ravel()))
        self._up = sps.csr_array(entries, shape=(len(mesh.vertices), len(under.vertices)))
        self._down = self._up.T.tocsr()
        self._offsets = mesh.vertices - self._up @ under.vertices  # fine vertices stand off the coarse facets
        triangles, self._shares, _ = closest_points(under, mesh.vertices[mesh.faces].mean(axis=1))
        self._fit = PoissonFit(shell)
        slots = self._fit.slots.T.ravel()
        self._to_rows = sps.csr_array(
            (np.ones(slots.size), (slots, np.arange(slots.size))), shape=(self._fit.rows, slots.size)
        )
        self._corner_mean = _corner_means(under, triangles)
        self._rest_frames = _frames(under.vertices, under.faces)
        self._fine_frames = np.swapaxes(self._fit.frames, 1, 2)

    def _solve(self, load: Array, start: Array | None, constraints: Sequence[Constraint]) -> Equilibrium:
        """Static equilibrium of the coarse shell, carried up; a start (n, 3) is handed down to begin from."""
        begin = None if start is None else self._averaged(start)
        answer = self.coarse.equilibrium(force=self.handed_down(load), start=begin)
        return replace(answer, positions=self.carried_up(answer.positions), coordinates=answer.positions)

    def tangent_eigenvalue(self, answer: Equilibrium, load: Array) -> float | None:
        """Lowest eigenvalue [1/s^2] of the coarse shell's tangent stiffness over its mass."""
        return None if answer.coordinates is None else self.coarse.lowest_eigenvalue(answer.coordinates)

    def handed_down(self, load: Array) -> Array:
        """Load (n, 3) [N] on the coarse vertices: the same total force, and nearly the same torque."""
        return np.asarray(self._down @ load)

    def _averaged(self, positions: Array) -> Array:
        """Coarse positions from the fine displacements, averaged with the same weights."""
        moved = positions - self.shell.rest_positions
        weights = self.handed_down(np.ones_like(moved))
        return self.coarse.shell.rest_positions + self.handed_down(moved) / np.where(weights > 0, weights, 1.0)

    def carried_up(self, positions: Array) -> Array:
        """Fine positions (n, 3) [m] from coarse ones."""
        coarse = self.coarse.shell
        count_products(_PROLONGED * len(self._rest_frames) + _PROLONGED * len(self._fine_frames))
        gradients = _frames(positions, coarse.mesh.faces) @ np.linalg.inv(self._rest_frames)
        left, stretch, right = np.linalg.svd(gradients)
        mirrored = np.linalg.det(left @ right) < 0.0  # of triangles that have collapsed: their third stretch is zero
        left[mirrored, :, 2] *= -1.0
        turns = left @ right
        strains = np.swapaxes(right, 1, 2) @ (stretch[:, :, None] * right)
        quaternions = Rotation.from_matrix(turns).as_quat()
        wanted = _interpolated(quaternions, strains, self._corner_mean, self._shares)
        at = self._up @ positions
        at += np.einsum("nij,nj->ni", gradients[self._below], self._offsets)
        return self._fitted(wanted, at - self.shell.rest_positions)

    def _fitted(self, gradients: Array, carried: Array) -> Array:
        """Surface whose triangles have the ``gradients`` (T, 3, 3); parts that nothing holds move as ``carried``."""
        fit = self._fit
        change = (gradients - np.eye(3)) @ self._fine_frames  # columns: along a, b, n
        height, foot, length = (side[:, None] for side in fit.sides.T)
        along, across = change[:, :, 0], change[:, :, 1]
        two = 0.5 * (height * along - foot * across)
        three = 0.5 * length * across
        right_side = self._to_rows @ np.concatenate([-two - three, two, three])
        centres = np.array([share @ carried[vertices] for vertices, share in fit.floating]).reshape(-1, 3)
        return self.shell.rest_positions + fit.displacement(right_side, centres)

    def start_motion(self, positions: Array | None = None) -> MotionState:
        """State of the coarse shell at rest."""
        return self.coarse.start_motion(
            None if positions is None else self._averaged(self.shell.checked_positions(positions))
        )

    def step(
        self, state: MotionState, dt: float, load: Array, damping: Damping, held: Array | None = None
    ) -> tuple[MotionState, bool]:
        """One implicit Euler step of the coarse shell, in the frame of its supports."""
        return self.coarse.step(state, dt, self.handed_down(load), damping)

    def positions(self, state: MotionState) -> Array:
        """Fine positions (n, 3) [m]."""
        return self.carried_up(state.coordinates)

    def elastic_energy(self, state: MotionState) -> float:
        """Elastic energy of the coarse shell [J]."""
        return self.coarse.elastic_energy(state)

    def kinetic_energy(self, state: MotionState) -> float:
        """Kinetic energy of the coarse shell [J]."""
        return self.coarse.kinetic_energy(state)


def coarse_shell(shell: Shell, mesh: TriangleMesh, material: Material | Isotropic | None = None) -> Shell:
    """A coarse shell on ``mesh`` with the supports of ``shell`` and, by calibration, its lowest frequency.

    A coarse mesh is too stiff, mostly in its membrane: that is scaled until the lowest elastic eigenvalues agree; or
    the flexure, where the lowest mode hardly stretches. To clamp alike, give ``mesh`` a row of vertices where the fine
    shell's held region ends.

    Parameters
    ----------
    shell : Shell
        The fine shell.
    mesh : TriangleMesh
        The same surface with fewer vertices.
    material : Material, optional
        Stiffnesses for ``mesh``; without it those of ``shell``, which must then be single numbers, with the shear
        stiffness, a force, scaled by edge length.

    Raises
    ------
    OptionError
        If ``material`` is left out and that of ``shell`` is an :class:`Isotropic` or has values of single elements.
    SupportError
        If no vertex of ``mesh`` lies where ``shell`` is held.
    """
    checked_kind("shell", shell, Shell)
    checked_kind("mesh", mesh, TriangleMesh)
    shell.require_clamps("a coarse shell")
    given = shell.material if material is None else material
    if not isinstance(given, Isotropic):
        checked_kind("material", given, Material)
    else:
        raise OptionError(
            "coarse_shell calibrates discrete-shell stiffnesses, which a shell of ms.Isotropic has not: build the "
            "coarse shell as ms.Shell(mesh, ms.Isotropic(...), clamped=...), or pass a Material as material="
        )
    if material is None:
        if any(np.ndim(value) for value in (given.stretch, given.shear, given.flexure, given.density)):
            raise OptionError("the fine shell's material has a value an element: pass the material of the coarse mesh")
        ratio = float(mesh.edge_lengths.mean() / shell.mesh.edge_lengths.mean())
        given = replace(given, shear=given.shear * ratio)
    nearest, shares, _ = closest_points(shell.mesh, mesh.vertices)
    corners = shell.mesh.faces[nearest, shares.argmax(axis=1)]
    clamped = shell.clamped[corners]
    if shell.clamped.any() and not clamped.any():
        raise SupportError("no vertex of the coarse mesh lies where the fine shell is held: refine it there")
    goal = _lowest(shell)

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


def closest_points(mesh: TriangleMesh, points: Array) -> tuple[Index, Array, Array]:
    """Triangle nearest each point (k,), barycentric shares there (k, 3), none negative, and the distance (k,) [m]."""
    corners = mesh.vertices[mesh.faces]
    near = cKDTree(corners.mean(axis=1)).query(points, k=min(_NEAR, len(corners)))[1].reshape(len(points), -1)
    shares = _barycentric(corners[near], points[:, None])
    offsets = np.einsum("pkc,pkcx->pkx", shares, corners[near]) - points[:, None]
    distance = np.linalg.norm(offsets, axis=2)
    best = distance.argmin(axis=1)
    rows = np.arange(len(points))
    return near[rows, best], shares[rows, best], distance[rows, best]


def _barycentric(corners: Array, points: Array) -> Array:
    """Shares (..., 3) of the point of each triangle (..., 3, 3) that is (nearly) nearest to its point (..., 3)."""
    first, second = corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :]
    arm = points - corners[..., 0, :]
    aa, bb, ab = (np.sum(u * v, axis=-1) for u, v in ((first, first), (second, second), (first, second)))
    ra, rb = np.sum(arm * first, axis=-1), np.sum(arm * second, axis=-1)
    determinant = aa * bb - ab**2
    shares = np.stack([(bb * ra - ab * rb) / determinant, (aa * rb - ab * ra) / determinant], axis=-1)
    whole = np.concatenate([1.0 - shares.sum(axis=-1, keepdims=True), shares], axis=-1).clip(0.0, None)
    return whole / whole.sum(axis=-1, keepdims=True)


def _frames(positions: Array, faces: Index) -> Array:
    """Two edges and the unit normal of every triangle, as columns (T, 3, 3)."""
    first = positions[faces[:, 1]] - positions[faces[:, 0]]
    second = positions[faces[:, 2]] - positions[faces[:, 0]]
    normal = np.cross(first, second)
    length = np.linalg.norm(normal, axis=1)[:, None]  # zero where a triangle has collapsed
    return np.stack([first, second, normal / np.where(length > 0.0, length, 1.0)], axis=2)


def _corner_means(mesh: TriangleMesh, triangles: Index) -> sps.csr_array:
    """Means over triangles at the corners of ``triangles``, weighted by area: a sparse matrix (3 k, T).

    Row 3 t + c belongs to corner c of the t-th of the k wanted triangles.
    """
    around: list[list[int]] = [[] for _ in range(len(mesh.vertices))]
    for face, corners in enumerate(mesh.faces):
        for vertex in corners:
            around[vertex].append(face)
    normals, areas = mesh.face_normals, mesh.face_areas
    numbers, members = [], []
    corners = [(face, vertex) for face in triangles for vertex in mesh.faces[face]]
    for number, (face, vertex) in enumerate(corners):
        smooth = [other for other in around[vertex] if normals[other] @ normals[face] > _SMOOTH]
        numbers += [number] * len(smooth)
        members += smooth
    chosen, rows = np.array(members), np.array(numbers)
    shares = areas[chosen] / np.bincount(rows, areas[chosen])[rows]
    return sps.csr_array((shares, (rows, chosen)), shape=(len(corners), len(areas)))


def _interpolated(quaternions: Array, strains: Array, mean: sps.csr_array, shares: Array) -> Array:
    """Deformation gradients (T, 3, 3) at fine triangles: mean turns and strains at corners, then shares of those."""
    # A quaternion and its negative are one turn: all of a corner's get the sign of its last one.
    last = np.repeat(mean.indices[mean.indptr[1:] - 1], np.diff(mean.indptr))
    sign = np.sign(np.sum(quaternions[last] * quaternions[mean.indices], axis=1))
    turn = sps.csr_array((mean.data * sign, mean.indices, mean.indptr), shape=mean.shape) @ quaternions
    turn = (turn / np.linalg.norm(turn, axis=1)[:, None]).reshape(-1, 3, 4)
    corner_strain = (mean @ strains.reshape(-1, 9)).reshape(-1, 3, 3, 3)
    turn = turn * np.where(np.sum(turn * turn[:, :1], axis=2, keepdims=True) < 0.0, -1.0, 1.0)
    rotation = Rotation.from_quat(np.einsum("tk,tkq->tq", shares, turn)).as_matrix()
    return rotation @ np.einsum("tk,tkij->tij", shares, corner_strain)
