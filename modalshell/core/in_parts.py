"""Array expressions over many rows, some at a time: temporaries stay in the processor's cache."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

_AT_A_TIME = 10_000
"""Rows at a time."""


def fill_in_parts(out: Any, function: Callable[..., Any], *arrays: Any) -> None:
    """Write ``function(*arrays)`` into ``out``, which has a row for each row of the arrays and depends on no other."""
    for start in range(0, len(out), _AT_A_TIME):
        rows = slice(start, start + _AT_A_TIME)
        out[rows] = function(*(array[rows] for array in arrays))
