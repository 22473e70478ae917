"""Direction of the calibration of a mesh: its long axis, or a given one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from modalshell.core.checks import checked_vectors, shown
from modalshell.core.errors import MaterialError
from modalshell.core.typing import Array
from modalshell.mesh import TriangleMesh

_ELONGATED = 3.0
"""Length over width from which a mesh has a long axis."""
_FLAT = 1e-6
"""Height over length up to which a mesh counts as flat."""
_ACROSS = 1e-3
"""Part of a unit direction in the mesh below which it is normal to it."""


@dataclass(frozen=True)
class Orientation:
    """Extents of a mesh and the direction of its bending."""

    axis: Array
    """Unit vector of the direction; zero if all directions are equivalent. Shape (3,)."""
    length: float
    width: float
    """The two largest extents along the principal axes [m]."""
    flat: bool
    """Whether the mesh is flat."""
    named: bool
    """Whether the user named the direction."""

    @property
    def elongated(self) -> bool:
        """Whether the mesh is at least three times as long as wide."""
        return self.length >= _ELONGATED * self.width


def orient(mesh: TriangleMesh, direction: ArrayLike | None = None) -> Orientation:
    """The named direction; else the long axis; else x in a flat mesh, or y where x is normal to it; else none."""
    centred = mesh.vertices - mesh.vertices.mean(axis=0)
    _, _, axes = np.linalg.svd(centred, full_matrices=False)
    extents = np.ptp(centred @ axes.T, axis=0)
    order = np.argsort(extents)[::-1]
    length, width, height = (float(extent) for extent in extents[order])
    flat = height <= _FLAT * length
    if direction is not None:
        axis = checked_vectors("direction", direction, (3,), MaterialError)
        if not axis.any():
            raise MaterialError(f"direction must not be the zero vector (got {shown(direction)})")
        axis = axis / np.abs(axis).max()
        axis /= np.linalg.norm(axis)
        inside = np.sqrt(np.maximum(1.0 - (mesh.face_normals @ axis) ** 2, 0.0))
        if inside.max() < _ACROSS:
            raise MaterialError(f"direction {direction!r} is normal to the whole mesh; name one that lies in it")
        return Orientation(axis, length, width, flat, True)
    if length >= _ELONGATED * width:
        return Orientation(axes[order[0]], length, width, flat, False)
    if not flat:
        return Orientation(np.zeros(3), length, width, flat, False)
    across = 1.0 - axes[order[2], 0] ** 2 < _ACROSS**2  # x is normal to the mesh
    return Orientation(np.eye(3)[int(across)], length, width, flat, False)


def in_plane_angles(tangents: Array, normals: Array, axis: Array) -> tuple[Array, Array]:
    """Cosine and sine from ``axis``, laid into each tangent plane, to unit ``tangents``; all (..., 3)."""
    inside = axis - normals * (normals @ axis)[..., None]
    inside = inside / np.maximum(np.linalg.norm(inside, axis=-1, keepdims=True), 1e-12)
    return np.sum(inside * tangents, axis=-1), np.sum(np.cross(normals, inside) * tangents, axis=-1)
