"""Opening the back end that draws on this machine."""

from __future__ import annotations

from modalshell.render.backend import choose_backend
from modalshell.render.painter import Painter


def open_painter(size: tuple[int, int]) -> Painter:
    """Open the back end that draws here, for images of `size` (width, height) in pixels."""
    if choose_backend() == "pyvista":
        from modalshell.render.pyvista_painter import PyvistaPainter

        return PyvistaPainter(size)
    from modalshell.render.rasteriser_painter import RasteriserPainter

    return RasteriserPainter(size)
