"""Contents of window and web page: the shell, its supports, and an arrow for gravity."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from modalshell.core.errors import OptionError
from modalshell.core.typing import Array
from modalshell.core.units import UnitSystem
from modalshell.render import choose_backend
from modalshell.render.backend import drawing_hint
from modalshell.render.camera import frame_points
from modalshell.render.content import DEFAULT_CAMERA, ShadedSurface
from modalshell.render.painter import LINE_WIDTH, reflectance
from modalshell.render.plotter import add_faces, close_plotter, open_plotter, set_camera
from modalshell.render.surfaces import EdgeTable, line_color, normals
from modalshell.render.views import save_picture
from modalshell.viewer.session import gravity_limit

_SIZE = (1200, 800)
"""Width and height [pixels]."""
_ARROW_COLOR = "#c0504d"
_BODY_COLOR = "#c9b79c"
_ARROW_LENGTH = 0.35
"""Length of the arrow, in shell sizes, at the largest gravity that the sliders offer."""


class Shown(Protocol):
    """Source of a stage: positions (n, 3), which may move, of a shell with triangles ``faces`` (T, 3)."""

    rest_positions: Array
    """Vertex positions (n, 3) at rest [m]."""
    positions: Array
    """Vertex positions (n, 3) [m]."""
    faces: Any
    """Triangles (T, 3)."""
    held: NDArray[np.bool_]
    """Which vertices (n,) are held."""
    gravity: Array
    """Acceleration on every vertex (3,) [m/s^2]."""
    units: UnitSystem
    """Of these numbers."""

    def bodies(self) -> list[tuple[Array, NDArray[np.integer]]]:
        """Vertices [m] and triangles of the colliders, where they are now."""

    def status(self) -> str:
        """One line on its state."""


class Stage:
    """A shell in one PyVista plotter; with ``off_screen`` it is drawn into memory instead of a window."""

    def __init__(self, shown: Shown, *, off_screen: bool) -> None:
        self._shown = shown
        self._pyvista, self.plotter = open_plotter(_SIZE, off_screen=off_screen)
        self._actors: list[Any] = []
        self._build()
        self.refresh()

    def _build(self) -> None:
        """Add the shell to the stage, replacing a previous one."""
        for actor in self._actors:
            self.plotter.remove_actor(actor, render=False)
        self._actors = []
        rest, faces = self._shown.rest_positions, np.asarray(self._shown.faces)
        self._rest, self._faces = rest, faces
        self._size = float(np.ptp(rest, axis=0).max())
        look = ShadedSurface(rest, faces)
        self._surface = self._pyvista.PolyData.from_regular_faces(rest.copy(), faces)
        self._surface.point_data.active_normals = normals(rest, faces)[1]
        self._actors.append(add_faces(self.plotter, self._surface, look, color=look.color))
        table = EdgeTable.of(rest, faces)
        edges = table.edges[table.drawn]
        cells = np.column_stack([np.full(len(edges), 2), edges]).ravel()
        self._add_lines(rest.copy(), cells, "#c8c8c8")  # stays where the shell is at rest
        self._lines = self._add_lines(rest.copy(), cells, tuple(line_color(look)))
        self._held = np.flatnonzero(self._shown.held)
        self._held_points: Any = None
        if self._held.size:
            self._held_points = self._pyvista.PolyData(rest[self._held])
            self._add(self._held_points, color="#404040", point_size=5.0)
        self._bodies = [self._pyvista.PolyData.from_regular_faces(x, each) for x, each in self._shown.bodies()]
        for body in self._bodies:
            self._add(body, color=_BODY_COLOR)
        self._arrow = self._pyvista.Arrow(start=(0.0, 0.0, 0.0), direction=(1.0, 0.0, 0.0))
        self._arrow_shape = np.array(self._arrow.points, dtype=np.float64)
        ambient, diffuse = reflectance(look)
        self._arrow_actor = self._add(self._arrow, color=_ARROW_COLOR, ambient=ambient, diffuse=diffuse)
        self._gravity_limit = gravity_limit(self._shown.gravity, self._shown.units)
        self._place_camera()

    def _add(self, mesh: Any, **look: Any) -> Any:
        self._actors.append(self.plotter.add_mesh(mesh, copy_mesh=False, **look))
        return self._actors[-1]

    def _add_lines(self, points: Array, cells: NDArray[np.int64], color: Any) -> Any:
        lines = self._pyvista.PolyData(points, lines=cells)
        self._add(lines, color=color, line_width=LINE_WIDTH, lighting=False)
        return lines

    def _place_camera(self) -> None:
        """Frame the shape, at rest and as it is, with room to hang and swing."""
        center = 0.5 * (self._rest.min(axis=0) + self._rest.max(axis=0))
        swing = center + self._size * np.array([[0.0, 0.0, -0.9], [0.0, 0.0, 0.6]])
        room = np.concatenate([self._rest, self._shown.positions, swing])
        set_camera(self.plotter, frame_points(room, DEFAULT_CAMERA, _SIZE[0] / _SIZE[1]))

    def refresh(self) -> None:
        """Update the stage to the present state, without rendering."""
        if self._shown.rest_positions is not self._rest:
            self._build()
        positions = self._shown.positions
        self._surface.points = positions
        self._surface.point_data.active_normals = normals(positions, self._faces)[1]
        self._lines.points = positions
        if self._held_points is not None:
            self._held_points.points = positions[self._held]
        for body, (moved, _) in zip(self._bodies, self._shown.bodies(), strict=True):
            body.points = moved
        self._turn_arrow()
        self.plotter.renderer.ResetCameraClippingRange()

    def _turn_arrow(self) -> None:
        gravity = self._shown.gravity
        length = float(np.linalg.norm(gravity))
        self._arrow_actor.SetVisibility(length > 0.0)
        if length == 0.0:
            return
        along = gravity / length
        aside = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
        aside /= np.linalg.norm(aside)
        axes = np.stack([along, aside, np.cross(along, aside)])
        reach = _ARROW_LENGTH * self._size
        stretched = self._arrow_shape * [reach * length / self._gravity_limit, 0.5 * reach, 0.5 * reach]
        low, high = self._rest.min(axis=0), self._rest.max(axis=0)
        tail = np.array([0.5 * (low[0] + high[0]), high[1] + 0.15 * self._size, high[2] + 0.25 * self._size])
        self._arrow.points = tail + stretched @ axes

    def save_picture(self, path: Path) -> None:
        """Render to a PNG file, and close."""
        self.plotter.render()
        save_picture(self.plotter.screenshot(None, return_img=True), path)
        self.close()

    def close(self) -> None:
        """Free the plotter and its OpenGL window."""
        close_plotter(self.plotter)


def demand_opengl() -> None:
    """Raise OptionError if PyVista cannot render: the viewer has no other renderer."""
    if choose_backend() != "pyvista":
        raise OptionError(f"the viewer needs OpenGL, which draws nothing here: {drawing_hint()}")
