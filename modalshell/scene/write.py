"""Writing of scenes as TOML."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from modalshell.files.atomic_io import write_text
from modalshell.scene.index_files import KEYS, SUFFIXES
from modalshell.scene.read import read_toml

_FILES = ("file", "young", "poisson", "thickness", "density", "prestrain", "rest_curvature", "change", "through")
"""Keys whose text names a file."""


def toml_table(name: str, table: Mapping[str, Any]) -> str:
    """``[name]`` and one line per key."""
    return "\n".join([f"[{name}]", *(f"{_key(key)} = {_value(value)}" for key, value in table.items())])


def write_scene_with(file: Path, out: str | os.PathLike[str], model: Mapping[str, Any]) -> Path:
    """Write the scene of ``file`` to ``out`` with another ``[model]``; comments are lost, paths of files adapted.

    Its results have the name of the new file: under that of the old one they would take the place of its own.
    """
    raw = _with_paths(read_toml(file), "", file.parent, Path(out).resolve().parent) | {"model": dict(model)}
    raw.pop("name", None)
    top = [f"{_key(key)} = {_value(value)}" for key, value in raw.items() if not isinstance(value, dict)]
    tables = [toml_table(key, value) for key, value in raw.items() if isinstance(value, dict)]
    return write_text(Path(out), "\n\n".join(filter(None, ["\n".join(top), *tables])) + "\n")


def _with_paths(value: Any, key: str, here: Path, there: Path) -> Any:
    """The value of a key with the paths of files in the folder ``here`` as seen from ``there``."""
    if isinstance(value, Mapping):
        return {name: _with_paths(inner, name, here, there) for name, inner in value.items()}
    if isinstance(value, list):
        return [_with_paths(inner, key, here, there) for inner in value]
    if not isinstance(value, str) or not (key in _FILES or (key in KEYS and value.endswith(SUFFIXES))):
        return value
    return Path(os.path.relpath(here / value, there)).as_posix() if (here / value).exists() else value


def _key(key: str) -> str:
    return key if key.replace("-", "").replace("_", "").isalnum() and key.isascii() else _value(key)


def _value(value: Any) -> str:
    """A value as TOML, tables and lists within it on one line."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(key)} = {_value(inner)}" for key, inner in value.items()) + "}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(_value(inner) for inner in value)}]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return {True: "true", False: "false"}[value] if isinstance(value, bool) else repr(value)
