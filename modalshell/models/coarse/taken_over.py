"""What a coarse shell takes over from a fine one: fields of its material, its rest shape and its creases."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any, NamedTuple, Self, final

import numpy as np

from modalshell.core.errors import MeshError
from modalshell.core.typing import Array, Index
from modalshell.mesh import TriangleMesh
from modalshell.mesh.closest import closest_points, common_parts, edges_along, nearest_on_segments
from modalshell.shell import Crease, CreaseState, Ply, Sheet, Shell, Temperature

_REGIONS = 0.25
"""Share of the length of all inner edges, up to which those where a field jumps are bounds of regions."""
_JUMP = 1e-9
"""Relative difference of two triangles' values that is a jump."""
_LOST = 0.1
"""Relative difference of a crease's length on both meshes from which they have not the same."""


def edges_to_keep(shell: Shell) -> Index:
    """Edges (k,) that a coarse mesh is to have as well: creases, and those where a region of a field ends.

    A field that jumps at more than a quarter of the edges is a smooth one, or noise.
    """
    mesh = shell.mesh
    kept = [] if shell.creases is None else [mesh.hinge_edges[shell.creases.hinges]]
    inner = np.flatnonzero(mesh.edge_faces[:, 1] >= 0)
    first, second = mesh.edge_faces[inner].T
    lengths = mesh.edge_lengths[inner]
    for values in _fields(shell):
        size = np.abs(values).max()
        jumps = (np.abs(values[first] - values[second]) > _JUMP * size).reshape(len(inner), -1).any(axis=1)
        if lengths[jumps].sum() <= _REGIONS * lengths.sum():
            kept.append(inner[jumps])
    return np.unique(np.concatenate([np.empty(0, dtype=np.int64), *kept]))


def _fields(shell: Shell) -> list[Array]:
    """Values (T, ...) of what is a field over the triangles of a sheet."""
    mesh, rest = shell.mesh, shell.options
    given = []
    if isinstance(shell.material, Sheet):
        sheet: Any = shell.material.on(mesh)
        given += [value for part in fields(sheet) for value in _parts(getattr(sheet, part.name))]
    centroids = mesh.vertices[mesh.faces].mean(axis=1)
    for raw in (rest["prestrain"], rest["rest_curvature"]):
        given.append(raw(centroids) if callable(raw) else raw)
    if (warm := rest["temperature"]) is not None:
        given += [warm.change, warm.through]
    arrays = [np.asarray(value, dtype=np.float64) for value in given if value is not None]
    return [value for value in arrays if value.ndim and len(value) == len(mesh.faces)]


def _parts(value: Any) -> tuple[Any, ...]:
    whole = value if isinstance(value, tuple) else (value,)
    return tuple(part for one in whole for part in ((one.angle, one.thickness) if isinstance(one, Ply) else (one,)))


@final
class FacesBelow:
    """Triangles of a fine mesh, those of a coarse one of the same surface that they lie on, and means over them."""

    def __init__(self, fine: TriangleMesh, coarse: TriangleMesh) -> None:
        self._fine, self._count = fine, len(coarse.faces)
        parts = common_parts(fine, coarse)
        above, under = (mesh.vertices[mesh.faces].mean(axis=1) for mesh in (fine, coarse))
        self._owners = closest_points(coarse, above, parts and (parts[1], parts[0][fine.faces[:, 0]]))[0]
        self._nearest = closest_points(fine, under, parts and (parts[0], parts[1][coarse.faces[:, 0]]))[0]
        self._areas = np.bincount(self._owners, fine.face_areas, self._count)
        self.turned = np.sum(fine.face_normals[self._nearest] * coarse.face_normals, axis=1) < 0.0

    def mean(self, values: Array) -> Array:
        """Means (k, ...) by area of ``values`` (T, ...); the nearest one's where a coarse triangle has none."""
        flat = values.reshape(len(values), -1)
        sums = [np.bincount(self._owners, self._fine.face_areas * column, self._count) for column in flat.T]
        found = flat[self._nearest].copy()
        known = self._areas > 0.0
        found[known] = np.stack(sums, axis=1)[known] / self._areas[known, None]
        return np.asarray(found.reshape(-1, *values.shape[1:]))

    def nearest(self, values: Array) -> Array:
        """Values (k, ...) of the triangles under the centroids."""
        return np.asarray(values[self._nearest])

    def of(self, value: Any) -> Any:
        """A constant or function as it is, a field (T, ...) by its means."""
        if callable(value) or np.ndim(value) == 0 or len(value) != len(self._fine.faces):
            return value
        return self.mean(np.asarray(value, dtype=np.float64))


def restricted_sheet(sheet: Any, below: FacesBelow) -> Any:
    """A sheet on the coarse mesh: means of its fields, directions of the nearest triangles."""
    changed = {}
    for name in (part.name for part in fields(sheet)):
        value = getattr(sheet, name)
        if name == "direction":
            changed[name] = below.nearest(value) if isinstance(value, np.ndarray) else value
        elif name == "plies":
            changed[name] = tuple(_restricted_ply(ply, below) for ply in value)
        else:
            changed[name] = tuple(map(below.of, value)) if isinstance(value, tuple) else below.of(value)
    return replace(sheet, **changed)


def _restricted_ply(ply: Ply, below: FacesBelow) -> Ply:
    angle: Any = ply.angle
    angle = below.nearest(angle) if isinstance(angle, np.ndarray) else angle
    return replace(ply, angle=angle, thickness=below.of(ply.thickness))


def restricted_options(shell: Shell, mesh: TriangleMesh, below: FacesBelow) -> dict[str, Any]:
    """Rest shape and creases of a shell on a coarse mesh; MeshError where that has no edges along a crease."""
    given = shell.options
    found = {name: below.of(given[name]) for name in ("prestrain", "rest_curvature") if given[name] is not None}
    if (warm := given["temperature"]) is not None:
        found["temperature"] = Temperature(below.of(warm.change), warm.expansion, below.of(warm.through))
    if shell.rest_mesh is not shell.mesh:
        nearest, shares, _ = closest_points(shell.mesh, mesh.vertices, common_parts(shell.mesh, mesh))
        moves = (shell.rest_mesh.vertices - shell.mesh.vertices)[shell.mesh.faces[nearest]]
        found["rest"] = mesh.vertices + np.einsum("kc,kcx->kx", shares, moves)
    if shell.creases is not None:
        found["creases"] = [_crease_on(mesh, shell.mesh, crease, k) for k, crease in enumerate(given["creases"])]
    return found


def _crease_on(mesh: TriangleMesh, fine: TriangleMesh, crease: Crease, index: int) -> Crease:
    edges = fine.hinge_edges[crease.hinges(fine)]
    along, segments = edges_along(mesh, fine.vertices[fine.edges[edges]])
    if (parts := common_parts(fine, mesh)) is not None:  # a sheet close by has none of them
        along = along[parts[1][mesh.edges[along, 0]] == parts[0][fine.edges[edges[segments], 0]]]
    along = np.setdiff1d(along[mesh.edge_faces[along, 1] >= 0], mesh.joints.edges)
    whole, left = float(fine.edge_lengths[edges].sum()), float(mesh.edge_lengths[along].sum())
    if abs(left / whole - 1.0) > _LOST:
        raise MeshError(
            f"the coarse mesh has {left:.3g} m of edges along creases[{index}], which is {whole:.3g} m long: give one "
            "with edges there, or a number of triangles, by which they are kept (extra remesh)"
        )
    return Crease(mesh.edges[along], crease.yield_moment, crease.hardening)


@final
class CreasesBelow(NamedTuple):
    """Creases of a fine shell and those of a coarse one."""

    nearest: Index
    """Coarse crease of each fine one; shape (C,)."""
    signs: Array
    """-1 where their folds count the other way; shape (C,)."""
    lengths: Array
    """Of the fine ones [m]; shape (C,)."""
    below: int
    """Number of coarse ones."""

    @classmethod
    def of(cls, fine: Shell, coarse: Shell) -> Self | None:
        """Those of two shells, None where the coarse one has none."""
        if fine.creases is None or coarse.creases is None:
            return None
        above, under = fine.mesh, coarse.mesh
        edges, folds = above.hinge_edges[fine.creases.hinges], under.hinge_edges[coarse.creases.hinges]
        middles = above.vertices[above.edges[edges]].mean(axis=1)
        nearest = np.zeros(len(edges), dtype=np.int64)
        parts = common_parts(above, under) or (np.zeros(len(above.vertices)), np.zeros(len(under.vertices)))
        labels, below = parts[0][above.edges[edges, 0]], parts[1][under.edges[folds, 0]]
        for label in np.unique(labels):
            own, chosen = np.flatnonzero(labels == label), np.flatnonzero(below == label)
            chosen = chosen if chosen.size else np.arange(len(folds))  # a short one may be lost
            nearest[own] = chosen[nearest_on_segments(under.vertices[under.edges[folds[chosen]]], middles[own])[0]]
        one = above.face_normals[above.edge_faces[edges]].sum(axis=1)
        other = under.face_normals[under.edge_faces[folds]].sum(axis=1)[nearest]
        signs = np.where(np.sum(one * other, axis=1) < 0.0, -1.0, 1.0)
        return cls(nearest, signs, above.edge_lengths[edges], len(folds))

    def prolonged(self, angles: Array) -> Array:
        """Plastic folds (C,) [rad] of the fine creases from those of the coarse ones."""
        return np.asarray(self.signs * angles[self.nearest])

    def restricted(self, angles: Array) -> Array:
        """Plastic folds of the coarse creases [rad]: means over the length."""
        sums = np.bincount(self.nearest, self.lengths * self.signs * angles, self.below)
        lengths = np.bincount(self.nearest, self.lengths, self.below)
        return np.asarray(sums / np.where(lengths > 0.0, lengths, 1.0))

    def state_of(self, state: CreaseState, *, restrict: bool = False) -> CreaseState:
        """What coarse creases keep on the fine ones; or the other way, to ``restrict`` it."""
        move = self.restricted if restrict else self.prolonged
        return CreaseState(move(state.angles), state.dissipated)
