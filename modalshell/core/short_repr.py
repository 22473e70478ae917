"""Short reprs: a line for what holds arrays of thousands of numbers."""

from __future__ import annotations

from dataclasses import fields
from enum import Enum
from typing import Any, TypeVar

import numpy as np

C = TypeVar("C", bound=type)
_FEW = 4
"""Numbers of an array that are written out."""
_LONGEST_VALUE, _LONGEST = 60, 280
"""Characters of a value and of the whole."""


def short_repr(cls: C) -> C:
    """Give a dataclass a ``repr`` of one short line: shapes and ranges in place of arrays."""
    cls.__repr__ = _repr  # type: ignore[assignment]
    return cls


def _repr(self: Any) -> str:
    name, parts = type(self).__name__, []
    room = _LONGEST - len(name)
    for field in fields(self):
        value = getattr(self, field.name)
        if not field.repr or _is_empty(value):
            continue
        text = f"{field.name}={_short(value)}"
        if len(text) + 2 > room:
            parts.append("...")
            break
        parts.append(text)
        room -= len(text) + 2
    return f"{name}({', '.join(parts)})"


def _is_empty(value: Any) -> bool:
    """Whether it says nothing: None, or an empty text, array or container."""
    if isinstance(value, np.ndarray):
        return not value.size
    return value is None or (isinstance(value, str | list | tuple | dict) and not value)


def _short(value: Any) -> str:
    """A value in a few characters."""
    if isinstance(value, Enum):
        return str(value)
    if isinstance(value, np.ndarray):
        return _of_array(value)
    if isinstance(value, float | np.floating):
        return f"{value:.6g}"
    if isinstance(value, list | tuple | dict) and len(value) > _FEW:
        return f"<{len(value)} of {type(value).__name__}>"
    text = " ".join(repr(value).split())
    return text if len(text) <= _LONGEST_VALUE else f"<{type(value).__name__}>"


def _of_array(array: np.ndarray[Any, Any]) -> str:
    """Few numbers as they are, of many their shape and where they lie."""
    if array.dtype.kind not in "fiu":
        return f"<{array.dtype} {' x '.join(map(str, array.shape))}>"
    if array.size <= _FEW:
        return np.array2string(array, separator=", ", precision=6).replace("\n", "")
    shape = " x ".join(map(str, array.shape))
    return f"<{shape}, {array.min():.4g} to {array.max():.4g}>" if array.size < 10_000_000 else f"<{shape}>"
