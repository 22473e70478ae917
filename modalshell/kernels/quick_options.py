"""Numba's options of compilation, compared without a call for each of them.

For each call that it types, numba looks up what it has found under the same options, and compares some twenty of them
by properties: that is a seventh of the time that the kernels of a long command take to compile.
"""

from __future__ import annotations

import functools
from contextlib import suppress
from typing import Any

from numba.core import targetconfig


@functools.cache
def _defaults(kind: Any) -> dict[str, Any]:
    return {name: option.default for name, option in kind.options.items()}


def values(options: Any) -> dict[str, Any]:
    """All options by name, as numba's own method finds them."""
    return _defaults(type(options)) | options._values  # type: ignore[arg-type]


def apply(kind: Any = targetconfig.TargetConfig) -> None:
    """Let numba's options find their values so; other versions of numba, which keep them otherwise, are left alone."""
    with suppress(AttributeError, TypeError):
        for own in kind.__subclasses__():
            made = own()
            if values(made) != made.values():
                return
        kind.values = values
