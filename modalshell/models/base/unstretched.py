"""Base of modal models that bend without stretching, and what they say where supports hold opposite ends.

A shell between two held ends must stretch to move across: its arc is longer than at rest. Linear modes, turned or not,
know nothing of that: their energy is that of bending alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import final

import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from modalshell.core.typing import Array, Index
from modalshell.integrators.state import MotionState
from modalshell.models.base.equilibrium import Equilibrium
from modalshell.models.base.modal import ModalModel
from modalshell.modes import Basis
from modalshell.shell import Shell
from modalshell.statics.least_potential import Statics

_AT_END = 0.1
"""Part of the shell's length next to an end that counts as the end."""
_WIDE = 0.5
"""Part of an end's width over which it must be held."""
_STRAIGHT = 0.9
"""Cosine between a triangle and the way from end to end above which the surface counts as straight there."""
_STRAIN = 1e-3
"""Stretch by which the resistance to it is measured."""
_MATTERS = 0.05
"""Energy of the stretch that the model leaves out, over its own, from which that is said: 0.1 of the force or so."""
_REMARK = (
    "does not stretch, and supports hold opposite ends: arcs between these grow longer without resistance, and the "
    "shell is stiffer; take DS, coarse DS or MD-ROM"
)


@final
class HeldEnds:
    """Judges whether arcs between held ends grow longer than bending alone allows.

    Along every way from end to end coordinates q lengthen the arcs by ``e = q . A q`` of their length, in the mean.
    That costs ``k e^2 / 2`` [J], which the modes' energy ``q . Lambda q / 2`` leaves out.
    """

    def __init__(self, basis: Basis, ways: Sequence[Array]) -> None:
        stiffness = [_stiffness(basis.shell, way) for way in ways]
        # So scaled that frames have nothing to multiply.
        self._arcs = [np.sqrt(k / _MATTERS) * _arcs(basis, way) for k, way in zip(stiffness, ways, strict=True)]
        self._eigenvalues = basis.eigenvalues

    @classmethod
    def of(cls, basis: Basis) -> HeldEnds | None:
        """Those of a shell whose supports hold opposite ends with a straight surface between these; else None."""
        shell = basis.shell
        centred = shell.rest_positions - shell.rest_positions.mean(axis=0)
        sides = _sides(centred)
        ways = [
            way
            for way, across in (sides, sides[::-1])
            if _holds_ends(shell, centred @ way, centred @ across, way) and _is_straight(shell, way)
        ]
        return cls(basis, ways) if ways else None

    def missed(self, q: Array) -> bool:
        """Whether the energy of the stretch at q matters, compared with the modes' own."""
        stretch = 0.0
        for arcs in self._arcs:
            share = float(arcs.dot(q).dot(q))
            stretch += share * share  # a power would raise where a motion that diverges overflows
        return stretch > float((self._eigenvalues * q).dot(q))


class UnstretchedModel(ModalModel):
    """A modal model whose energy is that of small displacements, whatever the length of its arcs."""

    def warped_rows(self, q: Array, vertices: Index) -> Array:
        """Rows (k, 3, m) of the modes at some vertices, rotated with them."""
        rows = self._patch_rows(self.basis.modes, vertices)
        turns = Rotation.from_rotvec(self._patch_rows(self.basis.rotations, vertices) @ q).as_matrix()
        return np.asarray(turns @ rows)

    @cached_property
    def _held_ends(self) -> HeldEnds | None:
        return HeldEnds.of(self.basis)

    def _answer(self, found: Statics) -> Equilibrium:
        answer = super()._answer(found)
        message = "; ".join(filter(None, [answer.message, self._stretch_remark(found.q)]))
        return replace(answer, message=message)

    def remark(self, state: MotionState) -> str:
        """That supports hold opposite ends, and the model does not stretch between them."""
        remark = super().remark(state)
        if self._held_ends is None:
            return remark
        return "; ".join(filter(None, [remark, self._stretch_remark(state.coordinates)]))

    def _stretch_remark(self, q: Array) -> str:
        ends = self._held_ends
        return f"{self.name} {_REMARK}" if ends is not None and ends.missed(q) else ""


def _sides(centred: Array) -> Array:
    """Directions (2, 3) of the sides of the smallest rectangle around positions (n, 3), seen along their short axis."""
    plane = np.linalg.svd(centred, full_matrices=False)[2][:2]
    outline = centred @ plane.T
    corners = outline[ConvexHull(outline).vertices]
    edges = np.roll(corners, -1, axis=0) - corners
    edges /= np.linalg.norm(edges, axis=1)[:, None]
    frames = np.stack([edges, edges[:, ::-1] * [-1.0, 1.0]], axis=1)
    sizes = np.ptp(frames @ corners.T, axis=2)
    return np.asarray(frames[sizes.prod(axis=1).argmin()] @ plane)


def _holds_ends(shell: Shell, along: Array, across: Array, way: Array) -> bool:
    """Whether supports resist displacements along ``way`` (3,) over both ends of positions ``along`` (n,) it.

    An end is held over a good part of its width, positions ``across`` (n,).
    """
    resisted = shell.unknowns.resisted(np.tile(way, (len(along), 1))[:, :, None])[:, :, 0] @ way > 0.5
    held = np.flatnonzero(shell.unknowns.supported)[resisted]
    margin = _AT_END * np.ptp(along)
    ends = held[along[held] < along.min() + margin], held[along[held] > along.max() - margin]
    return all(end.size > 0 and np.ptp(across[end]) > _WIDE * np.ptp(across) for end in ends)


def _tangents(shell: Shell, way: Array) -> Array:
    """Part of ``way`` in the plane of every triangle (T, 3)."""
    normals = shell.mesh.face_normals
    return np.asarray(way - normals * (normals @ way)[:, None])


def _is_straight(shell: Shell, way: Array) -> bool:
    """Whether the surface runs along ``way`` nearly everywhere."""
    areas = shell.mesh.face_areas
    straight = np.linalg.norm(_tangents(shell, way), axis=1) > _STRAIGHT
    return bool(areas[straight].sum() > _STRAIGHT * areas.sum())


def _arcs(basis: Basis, way: Array) -> Array:
    """A (m, m) along ``way``: the mean square of the slopes of the modes along it, across the arcs, over two."""
    mesh = basis.shell.mesh
    corners, areas = mesh.vertices[mesh.faces], mesh.face_areas
    opposite = corners[:, [2, 0, 1]] - corners[:, [1, 2, 0]]
    gradients = np.cross(mesh.face_normals[:, None], opposite) / (2.0 * areas)[:, None, None]
    tangents = _tangents(basis.shell, way)
    lengths = np.linalg.norm(tangents, axis=1)
    tangents = tangents / np.where(lengths > 0.0, lengths, 1.0)[:, None]
    modes = basis.modes.reshape(len(mesh.vertices), 3, -1)[mesh.faces]
    slopes = np.einsum("tc,tcim->tim", np.einsum("tcx,tx->tc", gradients, tangents), modes)
    slopes -= tangents[:, :, None] * np.einsum("ti,tim->tm", tangents, slopes)[:, None]
    flat = slopes.reshape(-1, slopes.shape[2])
    return np.asarray(0.5 * flat.T @ (np.repeat(areas, 3)[:, None] * flat) / areas.sum())


def _stiffness(shell: Shell, way: Array) -> float:
    """Second derivative [J] of the energy by a uniform stretch along ``way``."""
    x = np.array(shell.rest_positions)
    stretch = _STRAIN * np.outer((x - x.mean(axis=0)) @ way, way)
    return float((shell.elastic_energy.energy(x + stretch) + shell.elastic_energy.energy(x - stretch)) / _STRAIN**2)
