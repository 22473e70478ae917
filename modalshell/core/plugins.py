"""Plug-ins: packages that add loads, energies, integrators or models through the entry-point group ``modalshell``."""

from __future__ import annotations

from functools import cache
from importlib.metadata import entry_points

from modalshell.core.checks import shortened
from modalshell.core.errors import OptionError


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
