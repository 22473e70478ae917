"""What window and browser page both show: the shell, its supports, and an arrow for gravity."""

from __future__ import annotations

import importlib
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modalshell.errors import OptionError
from modalshell.render import choose_backend
from modalshell.render.backend import APT_LINE
from modalshell.render.camera import frame_points
from modalshell.render.painter import LIGHTS, LINE_WIDTH
from modalshell.render.scene import DEFAULT_CAMERA, ShadedSurface
from modalshell.render.surfaces import EdgeTable, line_color, vertex_normals
from modalshell.viewer.session import ViewSession

Array = NDArray[np.float64]

_AMBIENT, _DIFFUSE = 0.38, 1.0
_ARROW_COLOR = "#c0504d"
_ARROW_LENGTH = 0.35
"""Length of the arrow, in shell sizes, at the largest gravity that the sliders offer."""


class Stage:
    """The scene of one session in one PyVista plotter.

    Parameters
    ----------
    session : ViewSession
        What to show.
    off_screen : bool
        Draw into memory instead of a window.
    size : tuple of int
        Width and height [pixels].

    Attributes
    ----------
    plotter : pyvista.Plotter
        Where it is drawn.
    """

    def __init__(self, session: ViewSession, *, off_screen: bool, size: tuple[int, int] = (1200, 800)) -> None:
        # Loaded as Any: PyVista's own annotations differ between its releases.
        pyvista: Any = importlib.import_module("pyvista")
        self._session = session
        theme = pyvista.themes.DocumentTheme()
        self.plotter: Any = pyvista.Plotter(off_screen=off_screen, window_size=size, lighting="none", theme=theme)
        for direction, power in LIGHTS:
            self.plotter.add_light(pyvista.Light(position=direction, intensity=power, light_type="camera light"))
        rest, faces = session.shell.rest_positions, np.asarray(session.shell.mesh.faces)
        self._faces = faces
        self._size = float(np.ptp(rest, axis=0).max())
        look = ShadedSurface(rest, faces)
        self._surface = pyvista.PolyData.from_regular_faces(rest.copy(), faces)
        self._surface.point_data.active_normals = vertex_normals(rest, faces)
        actor = self.plotter.add_mesh(
            self._surface, color=look.color, ambient=_AMBIENT, diffuse=_DIFFUSE, specular=0.0, copy_mesh=False
        )
        # Faces step back a little so that lines on them are never half hidden.
        actor.mapper.SetResolveCoincidentTopologyToPolygonOffset()
        actor.mapper.SetRelativeCoincidentTopologyPolygonOffsetParameters(1.0, 1.0)
        table = EdgeTable.of(rest, faces)
        edges = table.edges[table.drawn]
        cells = np.column_stack([np.full(len(edges), 2), edges]).ravel()
        self._add_lines(pyvista, rest.copy(), cells, "#c8c8c8")  # stays where the shell is at rest
        self._lines = self._add_lines(pyvista, rest.copy(), cells, tuple(line_color(look)))
        self._held = np.flatnonzero(session.shell.clamped)
        self._held_points: Any = None
        if self._held.size:
            self._held_points = pyvista.PolyData(rest[self._held])
            self.plotter.add_mesh(self._held_points, color="#404040", point_size=5.0, copy_mesh=False)
        self._arrow = pyvista.Arrow(start=(0.0, 0.0, 0.0), direction=(1.0, 0.0, 0.0))
        self._arrow_shape = np.array(self._arrow.points, dtype=np.float64)
        self._arrow_actor = self.plotter.add_mesh(
            self._arrow, color=_ARROW_COLOR, ambient=_AMBIENT, diffuse=_DIFFUSE, copy_mesh=False
        )
        self._place_camera(size[0] / size[1])
        self.refresh()

    def _add_lines(self, pyvista: Any, points: Array, cells: NDArray[np.int64], color: Any) -> Any:
        lines = pyvista.PolyData(points, lines=cells)
        self.plotter.add_mesh(lines, color=color, line_width=LINE_WIDTH, lighting=False, copy_mesh=False)
        return lines

    def _place_camera(self, aspect: float) -> None:
        """Frame the shape at rest with room to hang and swing."""
        rest = self._session.shell.rest_positions
        center = 0.5 * (rest.min(axis=0) + rest.max(axis=0))
        room = np.concatenate([rest, center + self._size * np.array([[0.0, 0.0, -0.9], [0.0, 0.0, 0.6]])])
        camera = frame_points(room, DEFAULT_CAMERA, aspect)
        self.plotter.camera_position = [camera.position, camera.target, camera.axes[1]]
        self.plotter.camera.view_angle = math.degrees(2.0 * math.atan(camera.slope))

    def refresh(self) -> None:
        """Bring what is shown up to the session's present state; draws nothing yet."""
        positions = self._session.positions
        self._surface.points = positions
        self._surface.point_data.active_normals = vertex_normals(positions, self._faces)
        self._lines.points = positions
        if self._held_points is not None:
            self._held_points.points = positions[self._held]
        self._turn_arrow()
        self.plotter.renderer.ResetCameraClippingRange()

    def _turn_arrow(self) -> None:
        gravity = self._session.gravity
        length = float(np.linalg.norm(gravity))
        self._arrow_actor.SetVisibility(length > 0.0)
        if length == 0.0:
            return
        along = gravity / length
        aside = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
        aside /= np.linalg.norm(aside)
        axes = np.stack([along, aside, np.cross(along, aside)])
        reach = _ARROW_LENGTH * self._size
        stretched = self._arrow_shape * [reach * length / self._session.gravity_limit, 0.5 * reach, 0.5 * reach]
        rest = self._session.shell.rest_positions
        low, high = rest.min(axis=0), rest.max(axis=0)
        tail = np.array([0.5 * (low[0] + high[0]), high[1] + 0.15 * self._size, high[2] + 0.25 * self._size])
        self._arrow.points = tail + stretched @ axes

    def save_picture(self, path: Path) -> None:
        """Write what is shown to a PNG file."""
        self.plotter.render()
        self.plotter.screenshot(str(path))

    def close(self) -> None:
        """Free the plotter and its OpenGL window."""
        self.plotter.close()
        self.plotter.deep_clean()


def demand_opengl() -> None:
    """Raise OptionError where PyVista draws nothing: the viewer has no slower way to draw."""
    if choose_backend() != "pyvista":
        raise OptionError(f"the viewer needs OpenGL, which draws nothing here; on Debian or Ubuntu: {APT_LINE}")
