"""Kinds of scenes other than that of one shell: each has a table of its own, as a flock has ``[flock]``."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

from modalshell.core.registry import Registry
from modalshell.scene.tables import Table

if TYPE_CHECKING:
    from modalshell.scene.scene import Scene


class SceneKind(NamedTuple):
    """A kind of scene."""

    table: type[Table]
    """What its own table must be."""
    builder: Callable[[dict[str, Any]], Scene]
    """Makes the scene of its declared tables, ``constraints`` a tuple of tables; refuses those it does not take."""


KINDS: Registry[SceneKind] = Registry("kind of scene")
"""Every further kind by the name of its table."""
