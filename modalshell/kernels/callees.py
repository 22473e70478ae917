"""What a compiled kernel was made of: the sources of its module and of those that this one imports.

Numba looks at the file of a kernel alone; of a kernel that calls another, whose file has changed since, it would load
what was compiled of both.
"""

from __future__ import annotations

import functools
import hashlib
import re
import sys
from contextlib import suppress
from pathlib import Path

_IMPORT = re.compile(r"^(?:from ([\w.]+) )?import (\((?s:.*?)\)|.*)$", re.MULTILINE)
"""Imports of a module, not those within its functions."""


@functools.cache
def source_digest(module: str, last: str) -> str:
    """Digest of the sources of an imported module and of those of its own package that it imports, and so on.

    Parameters
    ----------
    module : str
        Name of the module.
    last : str
        Name of a module whose imports do not matter.

    Returns
    -------
    str
        Hexadecimal SHA-256.
    """
    digest, seen, waiting = hashlib.sha256(), {last}, [module]
    while waiting:
        name = waiting.pop()
        if name not in seen:
            seen.add(name)
            waiting += _imports(name)
    for name in sorted(seen):
        digest.update(f"{name}\n{_source(name)}\n".encode())
    return digest.hexdigest()


@functools.cache
def _source(module: str) -> str:
    file = getattr(sys.modules.get(module), "__file__", None)
    with suppress(OSError, UnicodeDecodeError):
        return Path(file).read_text(encoding="utf-8") if file else ""
    return ""


@functools.cache
def _imports(module: str) -> tuple[str, ...]:
    """Modules of the same package that a module imports, itself by name or something of them."""
    package, found = module.partition(".")[0], []
    for origin, names in _IMPORT.findall(_source(module)):
        words = re.findall(r"[\w.]+", names)
        found += [origin, *(f"{origin}.{word}" for word in words)] if origin else words
    return tuple(name for name in found if name.partition(".")[0] == package and name in sys.modules)
