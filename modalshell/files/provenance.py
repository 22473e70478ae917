"""Provenance of results (versions, seed, parameters, machine), and paths of the package's data files."""

from __future__ import annotations

import datetime
import difflib
import importlib
import os
import platform
from pathlib import Path
from types import ModuleType
from typing import Any

from modalshell.core.errors import FileFormatError

_PACKAGE = Path(__file__).resolve().parents[1]
_PACKAGES = ("modalshell", "numpy", "scipy", "numba")


def run_record(parameters: dict[str, Any], seed: int = 0) -> dict[str, Any]:
    """Record of what reproduces a result: versions, seed, parameters, machine."""
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
    roots = _PACKAGE.parent, _PACKAGE / "bundled"
    for root in roots:
        if (root / name).is_file():
            return root / name
    beside = [file.name for root in roots for file in (root / name).parent.glob("*.*")]
    near = difflib.get_close_matches(Path(name).name, beside, 1)
    advice = f"did you mean {near[0]}?" if near else "check the name, or reinstall modalshell"
    raise FileFormatError(f"{name} is neither in the checkout nor in the installed package; {advice}")


def repository_module(name: str) -> ModuleType:
    """Import a module of ``studies`` or ``paper_figures``, the packages that are installed with this one.

    FileFormatError if another package of that name comes first on Python's path, or the module is missing.
    """
    package, folder = name.partition(".")[0], _PACKAGE.parent
    try:
        found = importlib.import_module(package).__file__
        if found is None or Path(found).resolve().parent != folder / package:
            raise FileFormatError(f"{package} is {found}, not that of modalshell in {folder}; run from another folder")
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        raise FileFormatError(f"{name} is not installed ({error}); reinstall modalshell") from error
