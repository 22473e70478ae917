"""The base of loads, and their registry."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

from modalshell.mesh import TriangleMesh
from modalshell.typing import Array


class Load(ABC):
    """A dead load: its forces are those on the shape at rest, however the shell moves.

    A subclass with a key is known to scenes: with ``class Gust(Load, key="gust")`` each table ``[[loads.gust]]`` is a
    load, its keys the parameters of the constructor, whose annotations are numbers, texts, tuples, or
    :data:`~modalshell.selection.Selection`.
    """

    key: ClassVar[str]

    def __init_subclass__(cls, *, key: str = "") -> None:
        cls.key = key
        if key:
            LOADS[key] = cls

    @abstractmethod
    def force(self, mesh: TriangleMesh) -> Array:
        """Force on every vertex (n, 3) [N]."""


LOADS: dict[str, type[Load]] = {}
"""Every load by its key."""
