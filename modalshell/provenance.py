"""What a result was made with: versions, seed, parameters, machine; and where the package's data files are."""

from __future__ import annotations

import datetime
import importlib
import os
import platform
from pathlib import Path
from typing import Any

from modalshell.errors import FileFormatError

_PACKAGES = ("modalshell", "numpy", "scipy", "numba")


def run_record(parameters: dict[str, Any], seed: int = 0) -> dict[str, Any]:
    """What must be known to make a result again: versions, seed, parameters, machine."""
    return {
        "made": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "versions": {name: importlib.import_module(name).__version__ for name in _PACKAGES}
        | {"python": platform.python_version()},
        "seed": seed,
        "parameters": parameters,
        "machine": {"system": platform.system(), "processor": platform.machine(), "cores": os.cpu_count()},
    }


def repository_file(name: str) -> Path:
    """Path of a file such as ``meshes/creature.ply``, in a checkout or in an installed copy; else FileFormatError."""
    package = Path(__file__).resolve().parent
    for root in (package.parent, package / "bundled"):
        if (root / name).is_file():
            return root / name
    raise FileFormatError(f"{name} is neither beside the package nor inside it; reinstall modalshell")
