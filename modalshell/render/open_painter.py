"""Opens the renderer of this machine."""

from __future__ import annotations

from modalshell.core.memory import demand_memory
from modalshell.render.backend import choose_backend, draws_faster
from modalshell.render.painter import Painter

_PIXEL_BYTES = 200
"""For each pixel of an image, drawn twice as large each way and averaged."""


def open_painter(size: tuple[int, int], *, film: bool = False) -> Painter:
    """Open the back end that draws here, for images of `size` (width, height) in pixels; refused without the memory.

    A film of opaque surfaces is drawn by the built-in rasteriser where OpenGL would run on the processor: the pictures
    are the same but for lines' edges, in a third of the time.
    """
    what, needed = f"a picture of {size[0]} x {size[1]} pixels", _PIXEL_BYTES * size[0] * size[1]
    demand_memory(what, needed, "make it smaller")
    if not (film and draws_faster()) and choose_backend() == "pyvista":
        from modalshell.render.pyvista_painter import PyvistaPainter

        return PyvistaPainter(size)
    from modalshell.render.rasteriser_painter import RasteriserPainter

    return RasteriserPainter(size)
