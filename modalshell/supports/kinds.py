"""Kinds of supports: clamp, pin, fix, symmetry, roller, diaphragm, tie."""

from __future__ import annotations

from abc import ABC
from typing import final

import numpy as np

from modalshell.core.checks import shown, unit_vector
from modalshell.core.errors import SupportError
from modalshell.core.typing import Array, Mask, Vector
from modalshell.mesh import TriangleMesh
from modalshell.mesh.selection import Selection
from modalshell.supports.base import Support, complement

_PLANE = 1e-6
"""Distance from a plane, as a share of the shape's size, up to which vertices lie in it."""


class _WholeSupport(Support, ABC):
    """A support along all directions."""

    def directions(self) -> Array:
        """All three."""
        return np.eye(3)


class _AxesSupport(Support, ABC):
    """A support along some axes."""

    def __init__(self, sel: Selection, axes: str) -> None:
        super().__init__(sel)
        if not isinstance(axes, str) or not axes or set(axes) - set("xyz") or len(set(axes)) < len(axes):
            raise SupportError(f"axes must be some of the letters x, y and z, each once (got {shown(axes)})")
        self.axes = axes

    def directions(self) -> Array:
        """The axes that are named."""
        return np.eye(3)[["xyz".index(axis) for axis in self.axes]]


@final
class Clamp(_WholeSupport, key="clamp"):
    """Holds vertices, and the slope of the surface at them.

    An :class:`~modalshell.Isotropic` shell is clamped at every edge with both ends in it. The hinges of a
    :class:`~modalshell.Material` know no slope at a boundary: there two rows of vertices must be held.

    Parameters
    ----------
    sel : str, array_like of bool, shape (n,), or of int
        The vertices.
    """

    clamps = True


@final
class Pin(_WholeSupport, key="pin"):
    """Holds vertices, and lets the surface turn about them.

    Parameters
    ----------
    sel : str, array_like of bool, shape (n,), or of int
        The vertices; triangles with all their corners among them do not move at all.
    """


@final
class Fix(_AxesSupport, key="fix"):
    """Holds single components of the vertices' positions.

    Parameters
    ----------
    sel : str, array_like of bool, shape (n,), or of int
        The vertices.
    axes : str
        Some of the letters x, y and z.

    Raises
    ------
    SupportError
        For other ``axes``.
    """


@final
class Symmetry(Support, key="symmetry"):
    """Holds vertices in a plane of symmetry, and the surface's boundary there at right angles to it as at rest.

    The shell then moves as half of a symmetric whole. Triangles in the plane, as of a web, have half of its thickness.

    Parameters
    ----------
    sel : str, array_like of bool, shape (n,), or of int
        The vertices in the plane.
    normal : (float, float, float)
        Normal of the plane, of any length.

    Raises
    ------
    SupportError
        For a normal that is no direction; on a shell, for vertices that do not lie in one such plane.
    """

    def __init__(self, sel: Selection, normal: Vector) -> None:
        super().__init__(sel)
        self.normal = unit_vector("normal", normal, SupportError)

    def directions(self) -> Array:
        """The normal."""
        return self.normal[None]

    def mirror(self) -> Array:
        """The normal."""
        return self.normal

    def vertices(self, mesh: TriangleMesh) -> Mask:
        """Mask (n,) of its vertices; SupportError unless they lie in one plane of the normal."""
        chosen = super().vertices(mesh)
        heights = mesh.vertices[chosen] @ self.normal
        if np.ptp(heights) > _PLANE * mesh.size:
            raise SupportError(
                f"sel of a symmetry plane must select vertices in one plane of normal {self.normal.tolist()}: they "
                f"reach from {heights.min():g} to {heights.max():g} m along it"
            )
        return chosen


@final
class Roller(Support, key="roller"):
    """Lets vertices move along one direction only.

    Parameters
    ----------
    sel : str, array_like of bool, shape (n,), or of int
        The vertices.
    direction : (float, float, float)
        The direction, of any length.

    Raises
    ------
    SupportError
        For an invalid direction.
    """

    def __init__(self, sel: Selection, direction: Vector) -> None:
        super().__init__(sel)
        self.direction = unit_vector("direction", direction, SupportError)

    def directions(self) -> Array:
        """The two across."""
        return complement(self.direction)


@final
class Diaphragm(Support, key="diaphragm"):
    """A rigid diaphragm: holds vertices in its plane, and lets them move along its axis and turn.

    Parameters
    ----------
    sel : str, array_like of bool, shape (n,), or of int
        The vertices, such as the rim of a cylinder.
    axis : (float, float, float)
        Normal of the diaphragm, of any length.

    Raises
    ------
    SupportError
        For an axis that is no direction.
    """

    def __init__(self, sel: Selection, axis: Vector) -> None:
        super().__init__(sel)
        self.axis = unit_vector("axis", axis, SupportError)

    def directions(self) -> Array:
        """The two in the plane."""
        return complement(self.axis)


@final
class Tie(_AxesSupport, key="tie"):
    """Lets vertices move together: along the axes their displacements are equal.

    Parameters
    ----------
    sel : str, array_like of bool, shape (n,), or of int
        The vertices.
    axes : str
        Some of the letters x, y and z; by default all.

    Raises
    ------
    SupportError
        For other ``axes``.
    """

    ties = True

    def __init__(self, sel: Selection, axes: str = "xyz") -> None:
        super().__init__(sel, axes)
