"""Base class of loads, and their registry."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

from modalshell.core.registry import Registry
from modalshell.core.typing import Array
from modalshell.loads.applied import AppliedLoad
from modalshell.mesh import TriangleMesh


class Load(ABC):
    """A load on a shell; a dead one, whose forces stay those at rest, unless a subclass says how they change.

    A subclass with a key is known to scenes: with ``class Gust(Load, key="gust")`` each table ``[[loads.gust]]`` is a
    load, its keys the parameters of the constructor, whose annotations are numbers, texts, tuples, or
    :data:`~modalshell.mesh.selection.Selection`. A dead load defines :meth:`force` alone; one that follows the shell's
    positions, velocities or the time defines :meth:`applied` too.
    """

    key: ClassVar[str]

    def __init_subclass__(cls, *, key: str = "") -> None:
        cls.key = key
        if key:
            LOADS[key] = cls

    @abstractmethod
    def force(self, mesh: TriangleMesh) -> Array:
        """Force on every vertex (n, 3) [N] of the shape at rest, at time 0."""

    def applied(self, mesh: TriangleMesh, mass: Array) -> AppliedLoad | None:  # noqa: ARG002 (dead loads need none)
        """What the load does on one shell of vertex masses (n,) [kg]; None where it is dead."""
        return None


class LiveLoad(Load):
    """A load whose forces follow the shell's positions, its velocities or the time."""

    @abstractmethod
    def applied(self, mesh: TriangleMesh, mass: Array) -> AppliedLoad | None:
        """What the load does on one shell of vertex masses (n,) [kg]."""

    def force(self, mesh: TriangleMesh) -> Array:
        """Force on every vertex (n, 3) [N] of the shape at rest, at time 0."""
        applied = self.applied(mesh, mesh.shared_among_corners(mesh.face_areas))
        assert applied is not None
        return applied.force(mesh.vertices)


LOADS: Registry[type[Load]] = Registry("load")
"""Every load by its key."""
