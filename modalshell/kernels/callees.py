"""What a compiled kernel was made of: the sources of its module and of those that this one imports.

Numba goes by the path and the time of a kernel's file alone: it would load what was compiled of a kernel and of one
that it calls, whose file has changed since, and compile all again in every copy of the package.
"""

from __future__ import annotations

import functools
import hashlib
import os
import re
import shutil
import sys
from contextlib import suppress
from pathlib import Path

_IMPORT = re.compile(r"^(?:from ([\w.]+) )?import (\((?s:.*?)\)|.*)$", re.MULTILINE)
"""Imports of a module, not those within its functions."""
_LETTERS, _KEPT = 20, 6
"""Letters of a digest that name a folder, and forms of a module whose kernels are kept: of several copies at once."""


@functools.cache
def source_digest(module: str, last: str) -> str:
    """Digest of the sources of an imported module and of what it imports, all the way, of its package and of this one.

    Imports of the module ``last`` do not matter. Returns the hexadecimal SHA-256.
    """
    digest, seen, waiting = hashlib.sha256(), {last}, [module]
    packages = {name.partition(".")[0] for name in (module, last)}
    while waiting:
        name = waiting.pop()
        if name not in seen and name.partition(".")[0] in packages:
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
    """Modules that a module imports, themselves by name or something of them; of a package what is named alone."""
    found: list[str] = []
    for origin, names in _IMPORT.findall(_source(module)):
        words = re.findall(r"[\w.]+", re.sub(r"\bas \w+", "", names))
        parts = [f"{origin}.{word}" if origin else word for word in words]
        found += parts if all(part in sys.modules for part in parts) else [origin, *parts]
    return tuple(name for name in found if name in sys.modules)


def folder_of(folder: Path, module: str, digest: str) -> Path:
    """Where kernels of a module are kept, in a cache ``folder``; of its sources' earlier forms some are kept, too."""
    of_module = folder / module
    made = of_module / digest[:_LETTERS]
    if made.is_dir():
        with suppress(OSError):  # somebody else's
            os.utime(made)
        return made
    made.mkdir(parents=True, exist_ok=True)
    with suppress(OSError):  # another process may remove the same
        for old in sorted(of_module.iterdir(), key=lambda path: path.stat().st_mtime)[:-_KEPT]:
            shutil.rmtree(old, ignore_errors=True)
    return made
