"""A capsule: what is within a radius of a segment."""

from __future__ import annotations

from typing import final

import numpy as np

from modalshell.contact.base import ROUND, Collider, Gap, axis_of, point, rounded_gap
from modalshell.contact.surfaces import Surface, tube
from modalshell.core.checks import checked_number
from modalshell.core.typing import Array, Vector


@final
class Capsule(Collider, key="capsule"):
    """A cylinder with half balls as its ends, such as a limb.

    Parameters
    ----------
    a, b : (float, float, float)
        Ends of its axis, the centres of the half balls [m].
    radius : float
        Of the cylinder and the balls [m].

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
        along = (x - self.a) @ self._axis
        nearest = np.clip(along, 0.0, self._length)
        offset = x - self.a - nearest[:, None] * self._axis
        beside = (along > 0.0) & (along < self._length)
        free = np.eye(3) - beside[:, None, None] * np.outer(self._axis, self._axis)
        return rounded_gap(offset, free, self.radius)

    def packed(self) -> tuple[int, Array]:
        """See :meth:`Collider.packed`."""
        return ROUND, np.array([*self.a, *self._axis, self._length, self.radius])

    def surface(self, corners: Array) -> Surface:  # noqa: ARG002 (it is drawn whole)
        """See :meth:`Collider.surface`."""
        polar = np.linspace(0.0, 0.5 * np.pi, 12)
        caps = self.radius / self._length * np.cos(polar)
        radii = self.radius * np.concatenate([np.sin(polar), np.sin(polar)[::-1]])
        return tube(self.a, self.b, radii.tolist(), [*(-caps).tolist(), *(1.0 + caps[::-1]).tolist()])

    @property
    def smallest_radius(self) -> float:
        """Its radius [m]."""
        return self.radius
