"""PyVista set-up for pictures, films and the viewer: lights, theme, camera and shading."""

from __future__ import annotations

import importlib
import math
from typing import Any

from modalshell.render.camera import Camera
from modalshell.render.content import ShadedSurface
from modalshell.render.painter import LIGHTS, reflectance


def open_plotter(size: tuple[int, int], *, off_screen: bool) -> tuple[Any, Any]:
    """PyVista itself, and a plotter of ``size`` (width, height) [pixels], white, with the lights of all painters.

    Both are Any: PyVista's own annotations differ between its releases.
    """
    pyvista: Any = importlib.import_module("pyvista")
    # A theme of its own, so that a user's global theme changes no figure.
    theme = pyvista.themes.DocumentTheme()
    plotter: Any = pyvista.Plotter(off_screen=off_screen, window_size=size, lighting="none", theme=theme)
    plotter.set_background("white")
    for direction, power in LIGHTS:
        plotter.add_light(pyvista.Light(position=direction, intensity=power, light_type="camera light"))
    return pyvista, plotter


def add_faces(plotter: Any, mesh: Any, surface: ShadedSurface, **look: Any) -> Any:
    """Actor of a mesh shown with the shading of ``surface``; ``look`` holds further options of ``add_mesh``."""
    ambient, diffuse = reflectance(surface)
    actor = plotter.add_mesh(mesh, ambient=ambient, diffuse=diffuse, specular=0.0, copy_mesh=False, **look)
    # Faces step back a little so that lines on them are never half hidden.
    actor.mapper.SetResolveCoincidentTopologyToPolygonOffset()
    actor.mapper.SetRelativeCoincidentTopologyPolygonOffsetParameters(1.0, 1.0)
    return actor


def set_camera(plotter: Any, camera: Camera) -> None:
    """Look through a camera."""
    plotter.camera_position = [camera.position, camera.target, camera.axes[1]]
    plotter.camera.view_angle = math.degrees(2.0 * math.atan(camera.slope))


def close_plotter(plotter: Any) -> None:
    """Free a plotter and its OpenGL window."""
    plotter.close()
    plotter.deep_clean()
