"""A ball."""

from __future__ import annotations

from typing import final

import numpy as np

from modalshell.contact.base import ROUND, Collider, Gap, point, rounded_gap
from modalshell.contact.surfaces import Surface, ball
from modalshell.core.checks import checked_number
from modalshell.core.typing import Array, Vector


@final
class Sphere(Collider, key="sphere"):
    """A ball.

    Parameters
    ----------
    center : (float, float, float)
        Its centre [m].
    radius : float
        Its radius [m].

    Raises
    ------
    OptionError
        For a centre that is not finite, or a radius that is not positive.
    """

    def __init__(self, center: Vector, radius: float) -> None:
        self.center = point("center", center)
        self.radius = checked_number("radius", radius, above=0.0, unit="m")

    def gap(self, x: Array, t: float = 0.0) -> Gap:  # noqa: ARG002 (it rests)
        """See :meth:`Collider.gap`."""
        return rounded_gap(x - self.center, np.eye(3), self.radius)

    def distance(self, x: Array, t: float = 0.0) -> Array:  # noqa: ARG002
        """See :meth:`Collider.distance`."""
        return np.asarray(np.linalg.norm(x - self.center, axis=1) - self.radius)

    def packed(self) -> tuple[int, Array]:
        """See :meth:`Collider.packed`."""
        return ROUND, np.array([*self.center, 0.0, 0.0, 0.0, 0.0, self.radius])

    def surface(self, corners: Array) -> Surface:  # noqa: ARG002 (it is drawn whole)
        """See :meth:`Collider.surface`."""
        directions, triangles = ball()
        return self.center + self.radius * directions, triangles

    @property
    def smallest_radius(self) -> float:
        """Its radius [m]."""
        return self.radius
