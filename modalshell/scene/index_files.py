"""Selections of a scene by files of vertex indices: ``sel = "rim.txt"`` or ``"rim.npy"``."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from modalshell.core.checks import shortened
from modalshell.core.errors import SceneError
from modalshell.files.regular import read_regular

_KEYS = ("clamped", "sel", "where", "vertices")
"""Keys that select vertices."""
_SUFFIXES = (".txt", ".npy")


def with_index_files(file: Path, raw: Any, path: str = "") -> Any:
    """The tables of a scene with the indices of every such file in its place; SceneError where one cannot be read.

    Files are searched in the scene's folder.
    """
    if isinstance(raw, dict):
        return {
            key: _indices(file, f"{path}.{key}" if path else key, value)
            if key in _KEYS and isinstance(value, str) and value.endswith(_SUFFIXES)
            else with_index_files(file, value, f"{path}.{key}" if path else key)
            for key, value in raw.items()
        }
    if isinstance(raw, list):
        return [with_index_files(file, entry, f"{path}[{index}]") for index, entry in enumerate(raw)]
    return raw


def _indices(file: Path, path: str, name: str) -> list[int]:
    place = file.parent / name
    try:
        data = read_regular(place)
        if place.suffix == ".npy":
            array = np.asarray(np.lib.format.read_array(BytesIO(data), allow_pickle=False))
            numbers = np.flatnonzero(array) if array.dtype == bool else array
            if numbers.ndim != 1 or numbers.dtype.kind not in "iu" or (numbers.size and numbers.min() < 0):
                raise ValueError(f"an array of {array.dtype} with shape {array.shape}")
            return [int(number) for number in numbers]
        numbers_in_text = [int(word) for word in data.decode("utf-8").split()]
        if min(numbers_in_text, default=0) < 0:
            raise ValueError(f"the index {min(numbers_in_text)}")
        return numbers_in_text
    except (OSError, ValueError, TypeError, EOFError) as error:
        reason = getattr(error, "strerror", None) or shortened(str(error))
        raise SceneError(
            f"{file}: {path}: must be a file of vertex indices, .npy or text with one per line (got {name!r:.60}: "
            f"{reason})"
        ) from error
