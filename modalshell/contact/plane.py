"""A half-space."""

from __future__ import annotations

from typing import final

import numpy as np

from modalshell.contact.base import PLANE, Collider, Gap
from modalshell.contact.surfaces import Surface, square
from modalshell.core.checks import checked_number, unit_vector
from modalshell.core.errors import OptionError
from modalshell.core.typing import Array, Vector


@final
class Plane(Collider, key="plane"):
    """The half-space ``normal . x < offset``: a floor, a table, a wall.

    Parameters
    ----------
    normal : (float, float, float)
        Direction out of it, of any length.
    offset : float
        Of its surface from the origin along the normal [m].

    Raises
    ------
    OptionError
        For a normal that is no direction, or an offset that is not finite.
    """

    def __init__(self, normal: Vector = (0.0, 0.0, 1.0), offset: float = 0.0) -> None:
        self.normal = unit_vector("normal", normal, OptionError)
        self.offset = checked_number("offset", offset, unit="m")

    def gap(self, x: Array, t: float = 0.0) -> Gap:  # noqa: ARG002 (it rests)
        """See :meth:`Collider.gap`."""
        count = len(x)
        normals = np.broadcast_to(self.normal, (count, 3))
        return x @ self.normal - self.offset, normals, np.broadcast_to(np.zeros((3, 3)), (count, 3, 3))

    def packed(self) -> tuple[int, Array]:
        """See :meth:`Collider.packed`."""
        return PLANE, np.append(self.normal, self.offset)

    def surface(self, corners: Array) -> Surface:
        """See :meth:`Collider.surface`."""
        return square(self.offset * self.normal, self.normal, corners)

    def distance(self, x: Array, t: float = 0.0) -> Array:  # noqa: ARG002
        """See :meth:`Collider.distance`."""
        return np.asarray(x @ self.normal - self.offset)
