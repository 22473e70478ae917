"""A ground whose height is given on a grid."""

from __future__ import annotations

from typing import final

import numpy as np
from numpy.typing import ArrayLike

from modalshell.contact.base import Collider, Gap, point
from modalshell.contact.surfaces import Surface, grid_triangles
from modalshell.core.checks import as_array, checked_number, checked_vectors
from modalshell.core.errors import OptionError
from modalshell.core.thread_safety import read_only
from modalshell.core.typing import Array, Vector

_ORDER = 3
"""Of the spline through the heights: the curvature of the ground is continuous."""


@final
class HeightField(Collider, key="height-field"):
    """A ground ``z = h(x, y)``, a cubic spline through heights on a grid, extended by the heights at its edge.

    The gap is of first order, ``(z - h) n_z``: it is exact on the surface, and its sign everywhere.

    Parameters
    ----------
    z : array_like, shape (p, q)
        Heights [m] at ``origin + (i, j) spacing``; at least four along each axis.
    spacing : float
        Between the points of the grid [m].
    origin : (float, float, float)
        Of the point (0, 0) of the grid, and what the heights count from [m].

    Raises
    ------
    OptionError
        For heights of another shape or not finite, or a spacing that is not positive.
    """

    def __init__(self, z: ArrayLike, spacing: float, origin: Vector = (0.0, 0.0, 0.0)) -> None:
        heights = as_array("z", z, "heights of shape (p, q)", OptionError)
        if heights.ndim != 2 or min(heights.shape) <= _ORDER:
            raise OptionError(f"z must be heights (p, q), at least 4 x 4 of them (got shape {heights.shape})")
        self.z = read_only(checked_vectors("z", heights, heights.shape, OptionError).copy())
        self.spacing = checked_number("spacing", spacing, above=0.0, unit="m")
        self.origin = point("origin", origin)
        self._ends = self.spacing * (np.array(self.z.shape) - 1.0)
        first, second = (self.spacing * np.arange(count) for count in self.z.shape)
        from scipy.interpolate import RectBivariateSpline  # not before there is one: its import takes long

        self._spline = RectBivariateSpline(first, second, self.z, kx=_ORDER, ky=_ORDER)

    def gap(self, x: Array, t: float = 0.0) -> Gap:  # noqa: ARG002 (it rests)
        """See :meth:`Collider.gap`."""
        local = x - self.origin
        at = np.clip(local[:, :2], 0.0, self._ends)
        inside = (local[:, :2] >= 0.0) & (local[:, :2] <= self._ends)

        def spline(dx: int, dy: int) -> Array:
            values = self._spline(at[:, 0], at[:, 1], dx=dx, dy=dy, grid=False)
            along = (inside[:, 0] if dx else True) & (inside[:, 1] if dy else True)
            return np.asarray(np.where(along, values, 0.0))

        slopes = np.stack([-spline(1, 0), -spline(0, 1), np.ones(len(x))], axis=1)
        cosine = 1.0 / np.linalg.norm(slopes, axis=1)
        normal = slopes * cosine[:, None]
        second = np.zeros((len(x), 3, 3))
        second[:, 0, 0], second[:, 1, 1] = spline(2, 0), spline(0, 2)
        second[:, 0, 1] = second[:, 1, 0] = spline(1, 1)
        across = np.eye(3) - normal[:, :, None] * normal[:, None, :]
        curvature = -cosine[:, None, None] * (across @ second @ across)
        return (local[:, 2] - spline(0, 0)) * cosine, normal, curvature

    def surface(self, corners: Array) -> Surface:  # noqa: ARG002 (it is drawn whole)
        """See :meth:`Collider.surface`."""
        first, second = (self.spacing * np.arange(count) for count in self.z.shape)
        x, y = np.meshgrid(first, second, indexing="ij")
        points = np.stack([x, y, self.z], axis=-1).reshape(-1, 3)
        return self.origin + points, grid_triangles(*self.z.shape)[:, ::-1]
