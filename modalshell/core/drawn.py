"""Methods of what can be drawn; the drawing itself stands above, in :mod:`modalshell.plot`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

DRAWING: dict[str, Callable[..., Any]] = {}
"""The functions ``plot``, ``as_html`` and ``page``, which :mod:`modalshell.plot` enters here."""


class Drawn:
    """Base of what :func:`modalshell.plot` draws."""

    def plot(self, **options: Any) -> Any:
        """Draw it, by :func:`modalshell.plot` and its options for this class.

        A notebook shows the :class:`modalshell.render.Picture`, and its ``save(path)`` writes it.
        """
        return DRAWING["plot"](self, **options)

    def _repr_html_(self) -> str:
        shown: str = DRAWING["as_html"](self)
        return shown
