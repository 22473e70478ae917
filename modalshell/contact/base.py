"""Base class of colliders, and their registry."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar

import numpy as np

from modalshell.contact.surfaces import Surface
from modalshell.core.checks import checked_vectors
from modalshell.core.errors import OptionError
from modalshell.core.registry import Registry
from modalshell.core.thread_safety import ReadOnlyArrays, read_only
from modalshell.core.typing import Array, Vector

PLANE, ROUND, CYLINDER, BOX = range(4)
"""Kinds of colliders with a compiled gap."""

Gap = tuple[Array, Array, Array]
"""Signed distances (n,) [m], unit normals (n, 3), and second derivatives (n, 3, 3) [1/m] of the distance."""


class Collider(ReadOnlyArrays, ABC):
    """A rigid body that shells do not enter, by its signed distance.

    A subclass with a key is known to scenes: with ``class Plane(Collider, key="plane")`` each table ``[[contacts]]`` of
    ``kind = "plane"`` has such a collider, its further keys the parameters of the constructor.
    """

    key: ClassVar[str]

    def __init_subclass__(cls, *, key: str = "") -> None:
        cls.key = key
        if key:
            COLLIDERS[key] = cls

    @abstractmethod
    def gap(self, x: Array, t: float = 0.0) -> Gap:
        """Signed distance of points (n, 3) [m] at the time ``t`` [s], its gradient and second derivatives.

        Returns
        -------
        gap : ndarray, shape (n,)
            Distance from the surface [m], negative inside.
        normal : ndarray, shape (n, 3)
            Unit normals, out of the collider.
        curvature : ndarray, shape (n, 3, 3)
            Second derivatives of the distance [1/m]: zero for a plane, ``(I - n n^T) / |x - c|`` for a sphere.
        """

    def distance(self, x: Array, t: float = 0.0) -> Array:
        """Signed distance (n,) [m] of points (n, 3) [m] alone, for the search of what is near."""
        return self.gap(x, t)[0]

    def velocity(self, x: Array, t: float = 0.0) -> Array:  # noqa: ARG002 (of colliders that move by themselves)
        """Velocity (n, 3) [m/s] of the collider at points (n, 3) [m] at the time ``t`` [s]."""
        return np.zeros_like(x)

    @abstractmethod
    def surface(self, corners: Array) -> Surface:
        """Triangles of the surface, for pictures, as far as they matter to what has ``corners`` (k, 3) [m]."""

    def packed(self) -> tuple[int, Array] | None:
        """Its kind and numbers for compiled gaps; None for colliders that have none, and are asked by :meth:`gap`."""
        return None

    @property
    def smallest_radius(self) -> float:
        """Smallest radius [m] of its convex surface, which it must not move by in a step; infinite for half-spaces."""
        return np.inf

    def plain(self) -> dict[str, Any]:
        """The parameters of its constructor, as numbers and lists."""
        return {
            name: value.tolist() if isinstance(value, np.ndarray) else value
            for name, value in vars(self).items()
            if not name.startswith("_")
        }


COLLIDERS: Registry[type[Collider]] = Registry("collider")
"""Every collider by its key."""


def point(name: str, value: Vector) -> Array:
    """A point (3,) of a collider [m]; OptionError unless it is finite."""
    return read_only(checked_vectors(name, value, (3,), OptionError).copy())


def axis_of(a: Array, b: Array) -> tuple[Array, float]:
    """Unit vector (3,) from a to b, and their distance [m]; OptionError where they coincide."""
    length = float(np.linalg.norm(b - a))
    if length == 0.0:
        raise OptionError(f"a and b must be two points (got {a.tolist()} twice)")
    return (b - a) / length, length


def rounded_gap(offset: Array, free: Array, radius: float) -> Gap:
    """Gap about a nearest feature: its distance less ``radius`` [m].

    ``offset`` (n, 3) [m] leads from the nearest point of the feature; ``free`` (n, 3, 3) or (3, 3) projects on the
    directions along which that point does not follow.
    """
    distance = np.linalg.norm(offset, axis=1)
    inside = distance == 0.0  # on the feature every direction leads out
    size = np.where(inside, 1.0, distance)
    normal = offset / size[:, None]
    if inside.any():
        spread = np.broadcast_to(free, (len(offset), 3, 3))[inside]
        column = np.argmax(np.einsum("nii->ni", spread), axis=1)
        chosen = spread[np.arange(len(spread)), :, column]
        normal[inside] = chosen / np.maximum(np.linalg.norm(chosen, axis=1, keepdims=True), 1e-300)
    curvature = (free - normal[:, :, None] * normal[:, None, :]) / size[:, None, None]
    curvature[inside] = 0.0
    return distance - radius, normal, curvature
