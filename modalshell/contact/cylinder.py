"""A cylinder with flat ends."""

from __future__ import annotations

from typing import final

import numpy as np

from modalshell.contact.base import CYLINDER, Collider, Gap, axis_of, point, rounded_gap
from modalshell.contact.surfaces import Surface, tube
from modalshell.core.checks import checked_number
from modalshell.core.typing import Array, Vector


@final
class Cylinder(Collider, key="cylinder"):
    """A cylinder with flat ends, whose rims are sharp: let it reach beyond the shell, or take a :class:`Capsule`.

    Parameters
    ----------
    a, b : (float, float, float)
        Centres of its ends [m].
    radius : float
        Its radius [m].

    Raises
    ------
    OptionError
        For points that are not finite or coincide, or a radius that is not positive.
    """

    def __init__(self, a: Vector, b: Vector, radius: float) -> None:
        self.a, self.b = point("a", a), point("b", b)
        self._axis, self._length = axis_of(self.a, self.b)
        self.radius = checked_number("radius", radius, above=0.0, unit="m")

    def gap(self, x: Array, t: float = 0.0) -> Gap:  # noqa: ARG002 (it rests)
        """See :meth:`Collider.gap`."""
        axis, half = self._axis, 0.5 * self._length
        along = (x - self.a) @ axis
        beyond = np.abs(along - half) - half
        radial = x - self.a - along[:, None] * axis
        side, outward, curvature = rounded_gap(radial, np.eye(3) - np.outer(axis, axis), self.radius)
        ends = np.where(along > half, 1.0, -1.0)[:, None] * axis
        # Inside, and beside an end, the nearer surface counts; beyond both, the rim.
        flat = (beyond > side) & (side <= 0.0)
        rim = (beyond > 0.0) & (side > 0.0)
        gap = np.where(flat, beyond, side)
        normal = np.where(flat[:, None], ends, outward)
        curvature = np.where(flat[:, None, None], 0.0, curvature)
        if rim.any():
            across, over = side[rim], beyond[rim]
            far = np.hypot(across, over)
            gap[rim] = far
            cosine, sine = across / far, over / far
            out, up = outward[rim], ends[rim]
            normal[rim] = cosine[:, None] * out + sine[:, None] * up
            turn = sine[:, None] * out - cosine[:, None] * up
            around = np.cross(axis, out)
            ring = cosine / (across + self.radius)
            curvature[rim] = turn[:, :, None] * turn[:, None, :] / far[:, None, None]
            curvature[rim] += ring[:, None, None] * around[:, :, None] * around[:, None, :]
        return gap, normal, curvature

    def packed(self) -> tuple[int, Array]:
        """See :meth:`Collider.packed`."""
        return CYLINDER, np.array([*self.a, *self._axis, self._length, self.radius])

    def surface(self, corners: Array) -> Surface:
        """See :meth:`Collider.surface`."""
        along = (corners - self.a) @ self._axis / self._length
        low, high = max(0.0, float(along.min())), min(1.0, float(along.max()))
        if low >= high:
            low, high = 0.0, 1.0
        return tube(self.a, self.b, [0.0, self.radius, self.radius, 0.0], [low, low, high, high])

    @property
    def smallest_radius(self) -> float:
        """The radius, or half the length where that is less [m]."""
        return min(self.radius, 0.5 * self._length)
