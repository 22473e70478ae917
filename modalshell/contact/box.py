"""A box with rounded edges."""

from __future__ import annotations

from typing import final

import numpy as np
from scipy.spatial.transform import Rotation

from modalshell.contact.base import BOX, Collider, Gap, point, rounded_gap
from modalshell.contact.surfaces import Surface, ball
from modalshell.core.checks import checked_number, checked_vectors
from modalshell.core.errors import OptionError
from modalshell.core.thread_safety import read_only
from modalshell.core.typing import Array, Vector


@final
class Box(Collider, key="box"):
    """A box with rounded edges.

    Edges of a mesh pass a sharp corner between their vertices: round a box by their length, or more.

    Parameters
    ----------
    center : (float, float, float)
        Its centre [m].
    half : (float, float, float)
        Half its lengths along its axes [m], roundings with them.
    rotation : (float, float, float), optional
        Rotation vector [rad] from the world's axes to its own.
    rounding : float
        Radius of its edges and corners [m].

    Raises
    ------
    OptionError
        For numbers that are not finite, lengths that are not positive, or a rounding beyond the smallest of ``half``.
    """

    def __init__(self, center: Vector, half: Vector, rotation: Vector | None = None, rounding: float = 0.0) -> None:
        self.center = point("center", center)
        self.half = read_only(checked_vectors("half", half, (3,), OptionError).copy())
        if not (self.half > 0.0).all():
            raise OptionError(f"half must be three positive lengths [m] (got {self.half.tolist()})")
        self.rotation = None if rotation is None else point("rotation", rotation)
        least = float(self.half.min())
        self.rounding = checked_number("rounding", rounding, at_least=0.0, at_most=least, unit="m")
        self._turn = np.eye(3) if self.rotation is None else Rotation.from_rotvec(self.rotation.copy()).as_matrix()

    def gap(self, x: Array, t: float = 0.0) -> Gap:  # noqa: ARG002 (it rests)
        """See :meth:`Collider.gap`."""
        local = (x - self.center) @ self._turn
        core = self.half - self.rounding
        over = np.abs(local) - core
        outside = over > 0.0
        sign = np.where(local < 0.0, -1.0, 1.0)
        free = outside[:, :, None] * np.eye(3)
        gap, normal, curvature = rounded_gap(sign * np.maximum(over, 0.0), free, self.rounding)
        within = ~outside.any(axis=1)
        if within.any():
            face = np.argmax(over[within], axis=1)
            normals = np.eye(3)[face] * np.take_along_axis(sign[within], face[:, None], axis=1)
            gap[within] = over[within].max(axis=1) - self.rounding
            normal[within], curvature[within] = normals, 0.0
        turn = self._turn
        return gap, normal @ turn.T, turn @ curvature @ turn.T

    def packed(self) -> tuple[int, Array]:
        """See :meth:`Collider.packed`."""
        core = self.half - self.rounding
        return BOX, np.array([*self.center, *self._turn.ravel(), *core, self.rounding])

    def surface(self, corners: Array) -> Surface:  # noqa: ARG002 (it is drawn whole)
        """See :meth:`Collider.surface`."""
        directions, triangles = ball()
        core = np.where(directions < 0.0, -1.0, 1.0) * (self.half - self.rounding)
        return self.center + (core + self.rounding * directions) @ self._turn.T, triangles

    @property
    def smallest_radius(self) -> float:
        """Half its smallest length [m]."""
        return float(self.half.min())
