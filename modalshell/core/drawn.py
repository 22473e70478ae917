"""Methods of what can be drawn; the drawing itself stands above, in :mod:`modalshell.plot`."""

from __future__ import annotations

import os
from importlib import import_module
from types import ModuleType
from typing import Any


def _drawing() -> ModuleType:
    """The module that draws, imported at the first picture: nothing that is drawn depends on it."""
    return import_module("modalshell.plot")


class Drawn:
    """Base of what :func:`modalshell.plot` draws."""

    def plot(self, **options: Any) -> Any:
        """Draw it, by :func:`modalshell.plot` and its options for this class.

        A notebook shows the :class:`modalshell.render.Picture`, and its ``save(path)`` writes it.
        """
        return _drawing().plot(self, **options)

    def _repr_html_(self) -> str:
        shown: str = _drawing().as_html(self)
        return shown


class Paged(Drawn):
    """Base of what also has a web page."""

    def page(self, path: str | os.PathLike[str] | None = None, **options: Any) -> Any:
        """A self-contained :class:`modalshell.page.Page` that moves in a browser; ``path`` names a file to write it to.

        See :func:`modalshell.plot.basis_page` for the options.
        """
        page = _drawing().basis_page(self, **options)
        if path is not None:
            page.save(path)
        return page
