"""Colliders of simple shape, whose gaps are compiled for modal models too: see :mod:`.gap_kernels`."""

from __future__ import annotations

from typing import ClassVar, final

import numpy as np
from scipy.spatial.transform import Rotation

from modalshell.contact.base import (
    BOX,
    CYLINDER,
    PLANE,
    ROUND,
    Collider,
    Gap,
    axis_of,
    point,
    rounded_gap,
)
from modalshell.contact.surfaces import Surface, ball, square, tube
from modalshell.core.checks import checked_number, checked_vectors, unit_vector
from modalshell.core.errors import OptionError
from modalshell.core.thread_safety import read_only
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


class _OnAxis(Collider):
    """A body of revolution about the axis from ``a`` to ``b`` (3,) [m], of a ``radius`` [m]."""

    _kind: ClassVar[int]

    def __init__(self, a: Vector, b: Vector, radius: float) -> None:
        self.a, self.b = point("a", a), point("b", b)
        self._axis, self._length = axis_of(self.a, self.b)
        self.radius = checked_number("radius", radius, above=0.0, unit="m")

    def packed(self) -> tuple[int, Array]:
        """See :meth:`Collider.packed`."""
        return self._kind, np.array([*self.a, *self._axis, self._length, self.radius])


@final
class Capsule(_OnAxis, key="capsule"):
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

    _kind = ROUND

    def gap(self, x: Array, t: float = 0.0) -> Gap:  # noqa: ARG002 (it rests)
        """See :meth:`Collider.gap`."""
        along = (x - self.a) @ self._axis
        nearest = np.clip(along, 0.0, self._length)
        offset = x - self.a - nearest[:, None] * self._axis
        beside = (along > 0.0) & (along < self._length)
        free = np.eye(3) - beside[:, None, None] * np.outer(self._axis, self._axis)
        return rounded_gap(offset, free, self.radius)

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


@final
class Cylinder(_OnAxis, key="cylinder"):
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

    _kind = CYLINDER

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
