"""Pictures and films left out: drawing takes a second, and has no input of its own that a scene could spoil."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from modalshell.files.atomic_io import write_text


def _checked(surfaces: Any) -> None:
    for surface in surfaces:
        if not np.isfinite(np.asarray(surface, dtype=np.float64)).all():
            raise AssertionError("a picture was asked of positions that are not finite")


def _views(views: Any, path: Any, **_: Any) -> Path:
    _checked(surface.vertices for view in views for surface in view.surfaces)
    return write_text(path, "picture")


def _film(path: Any, surfaces: Any, motions: Any, **_: Any) -> Path:
    _checked(surface.vertices for surface in surfaces)
    for motion in motions:
        _checked([] if motion is None else motion)  # what rests has no motion
    return write_text(path, "film")


def _surfaces(path: Any, surfaces: Any, *_: Any, **__: Any) -> Path:
    _checked([surface.vertices for surface in surfaces])
    return write_text(path, "picture")


@contextmanager
def without_pictures() -> Iterator[None]:
    """Draw nothing, but look at what should be drawn."""
    with (
        mock.patch.multiple("modalshell.run.results", draw_views=_views, write_film=_film),
        mock.patch.multiple("modalshell.crowd.run", draw_surfaces=_surfaces, write_film=_film),
    ):
        yield
