"""Pictures in memory, which notebooks show and which may be saved."""

from __future__ import annotations

import base64
import html
import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, final

from modalshell.files.atomic_io import write_bytes
from modalshell.render.content import View, checked_path
from modalshell.render.views import draw_views

SMALL = (480, 300)
"""Width of a picture next to the numbers of an object [pixels]."""


@final
@dataclass(frozen=True)
class Picture:
    """A PNG picture; a notebook shows it."""

    data: bytes = field(repr=False)
    """The PNG file."""

    @classmethod
    def of(cls, draw: Callable[[Path], object]) -> Picture:
        """The picture that ``draw`` writes to the path that it is called with."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "picture.png")
            draw(path)
            return cls(path.read_bytes())

    @classmethod
    def of_views(cls, views: Sequence[View], **options: Any) -> Picture:
        """The picture of :func:`modalshell.render.draw_views`, with its options."""
        return cls.of(lambda path: draw_views(views, path, **options))

    @property
    def base64(self) -> str:
        """The file in base 64."""
        return base64.b64encode(self.data).decode("ascii")

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the picture to a ``.png`` file; return its path."""
        return write_bytes(checked_path(Path(path), ".png"), self.data)

    def _repr_png_(self) -> bytes:
        return self.data


def html_of(headline: str, rows: Mapping[str, str], picture: Picture | None, *, text: str = "") -> str:
    """An object in a notebook: a headline, a table of two columns, plain text and a picture."""
    cells = "".join(
        f"<tr><td>{html.escape(name)}</td><td style='text-align: left'>{html.escape(value)}</td></tr>"
        for name, value in rows.items()
    )
    parts = [f"<b>{html.escape(headline)}</b>", f"<table>{cells}</table>" if cells else ""]
    parts += [f"<pre style='white-space: pre-wrap'>{html.escape(text)}</pre>" if text else ""]
    parts += [f'<img alt="{html.escape(headline)}" src="data:image/png;base64,{picture.base64}">' if picture else ""]
    return f"<div>{''.join(parts)}</div>"
