"""Selections of a scene by files of vertex indices or a mask: ``sel = "rim.txt"`` or ``"rim.npy"``."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modalshell.core.checks import shortened
from modalshell.core.errors import SceneError
from modalshell.files.regular import read_regular

KEYS = ("clamped", "sel", "where", "vertices", "watch")
"""Keys that select vertices."""
SUFFIXES = (".txt", ".npy")
"""Of files of indices."""


def with_index_files(file: Path, raw: Any, path: str = "") -> Any:
    """The tables of a scene with the indices of every such file in its place; SceneError where one cannot be read.

    Files are searched in the scene's folder.
    """
    if isinstance(raw, dict):
        return {
            key: _indices(file, f"{path}.{key}" if path else key, value)
            if key in KEYS and isinstance(value, str) and value.endswith(SUFFIXES)
            else with_index_files(file, value, f"{path}.{key}" if path else key)
            for key, value in raw.items()
        }
    if isinstance(raw, list):
        return [with_index_files(file, entry, f"{path}[{index}]") for index, entry in enumerate(raw)]
    return raw


def numbered(value: Any, key: str = "") -> str:
    """A key of a scene's tables that selects vertices by their numbers, which are those of one mesh; "" without any."""
    if isinstance(value, dict):
        return next(filter(None, (numbered(inner, name) for name, inner in value.items())), "")
    if key in KEYS and (value.endswith(SUFFIXES) if isinstance(value, str) else isinstance(value, int | list)):
        return key
    return next(filter(None, map(numbered, value)), "") if isinstance(value, list) else ""


def _indices(file: Path, path: str, name: str) -> list[int] | list[bool]:
    """Indices, or the whole mask of a file: its length is checked where the mesh is known."""
    try:
        numbers = read_numbers(file.parent / name, int)
        if numbers.ndim != 1 or numbers.dtype.kind not in "biu":
            raise ValueError(f"an array of {numbers.dtype} with shape {numbers.shape}")
        if numbers.dtype != bool and numbers.size and numbers.min() < 0:
            raise ValueError(f"the index {numbers.min()}")
        return list(numbers.tolist())
    except ValueError as error:
        raise SceneError(
            f"{file}: {path}: must be a file of vertex indices (.npy, or text with one per line) or of a mask (.npy) "
            f"(got {name!r:.60}: {error})"
        ) from error


def read_numbers(file: Path, kind: type[int] | type[float]) -> NDArray[Any]:
    """The array of a ``.npy`` file, or numbers of a ``kind`` from text with one per line; ValueError says why not."""
    try:
        data = read_regular(file)
        if file.suffix == ".npy":
            return np.asarray(np.lib.format.read_array(BytesIO(data), allow_pickle=False))
        return np.array([kind(word) for word in data.decode("utf-8-sig").split()], dtype=kind)
    except (OSError, ValueError, TypeError, EOFError, OverflowError) as error:
        raise ValueError(getattr(error, "strerror", None) or shortened(str(error))) from error
