"""Registry: what models, integrators, loads, energies, supports and scenes are known by; a taken key is refused."""

from __future__ import annotations

import importlib.util
from functools import cache
from importlib.metadata import entry_points
from typing import Any, TypeVar, final

from modalshell.core.checks import shortened
from modalshell.core.errors import OptionError

T = TypeVar("T")
_OWN = ("modalshell.crowd", "modalshell.springs")
"""Features of this package that register themselves, each where its folder is there."""


@final
class Registry(dict[str, T]):
    """Classes, or records of them, by their keys; ``kind`` says in messages what is registered, such as a "load"."""

    def __init__(self, kind: str) -> None:
        super().__init__()
        self.kind = kind

    def __setitem__(self, key: str, value: T) -> None:
        """Register ``value``.

        OptionError if the key belongs to another class; names both. A class that is defined again, as by a notebook's
        cell that runs twice, takes the place of the old one.
        """
        if key in self and (old := full_name(self[key])) != (new := full_name(value)):
            raise OptionError(f"{self.kind} {key!r} exists already, as {old}: give {new} another key")
        super().__setitem__(key, value)


def full_name(value: Any) -> str:
    """Module and name of a class or function, or of what a record builds."""
    built = getattr(value, "builder", value)
    return f"{built.__module__}.{built.__qualname__}"


@cache
def load_features() -> None:
    """Import this package's own features that register models or kinds of scenes, and are not imported at once."""
    for feature in filter(importlib.util.find_spec, _OWN):
        importlib.import_module(feature)


@cache
def load_plugins() -> tuple[str, ...]:
    """Import the modules that installed packages name in the entry-point group ``modalshell``; return their names.

    Classes with a key register themselves when their module is imported. OptionError if an import fails.
    """
    names = []
    for entry in entry_points(group="modalshell"):
        try:
            entry.load()
        except Exception as error:  # whatever another package's import may raise
            raise OptionError(
                f"the package behind the entry point {entry.name!r} ({entry.value}) cannot be imported: "
                f"{shortened(str(error))}; repair or uninstall it"
            ) from error
        names.append(entry.name)
    return tuple(names)
