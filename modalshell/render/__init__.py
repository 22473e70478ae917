"""Pictures and films of shells, by PyVista where OpenGL works, otherwise by the built-in rasteriser.

Importing this package imports neither PyVista nor matplotlib: they are loaded when something is drawn.
"""

from modalshell.render.backend import choose_backend
from modalshell.render.camera import look_at
from modalshell.render.content import ShadedSurface, View
from modalshell.render.film import write_film
from modalshell.render.picture import Picture, html_of
from modalshell.render.views import draw_surfaces, draw_views

__all__ = [
    "Picture",
    "ShadedSurface",
    "View",
    "choose_backend",
    "draw_surfaces",
    "draw_views",
    "html_of",
    "look_at",
    "write_film",
]
