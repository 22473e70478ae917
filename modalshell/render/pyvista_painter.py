"""Drawing with PyVista, off-screen."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modalshell.render.camera import Camera
from modalshell.render.content import ShadedSurface
from modalshell.render.painter import LINE_WIDTH, MESH_LINE_WIDTH, SUPERSAMPLING, line_opacity, shrink
from modalshell.render.plotter import add_faces, close_plotter, open_plotter, set_camera
from modalshell.render.surfaces import EdgeTable, ScalarColors, Sides, line_color, vertex_colors


class PyvistaPainter:
    """One off-screen plotter of a ``size`` (width, height) [pixels], reused for every view and frame."""

    threaded = False  # OpenGL's context belongs to the thread that made it

    def __init__(self, size: tuple[int, int]) -> None:
        window = (size[0] * SUPERSAMPLING, size[1] * SUPERSAMPLING)
        self._pyvista, self._plotter = open_plotter(window, off_screen=True)
        # With multisampling on, depth peeling gives a blank picture under Mesa's EGL; supersampling needs none.
        self._plotter.disable_anti_aliasing()
        self._shown: list[_Shown] = []
        self._camera: Camera | None = None

    def start(self, surfaces: Sequence[ShadedSurface], camera: Camera, scalar_colors: ScalarColors | None) -> None:
        """Replace everything shown."""
        plotter = self._plotter
        plotter.clear_actors()
        self._camera = camera
        self._shown = [_Shown(self._pyvista, plotter, surface, camera, scalar_colors) for surface in surfaces]
        if any(surface.opacity < 1.0 for surface in surfaces):
            plotter.enable_depth_peeling(number_of_peels=8)
        else:
            plotter.disable_depth_peeling()
        set_camera(plotter, camera)

    def move(self, index: int, vertices: NDArray[np.float64], scalars: NDArray[np.float64] | None = None) -> None:
        """Move the vertices (n, 3) of one surface, keeping its triangles; and give it other scalars (n,), if any."""
        assert self._camera is not None
        self._shown[index].move(vertices, self._camera, scalars)

    def image(self) -> NDArray[np.uint8]:
        """Draw, and return pixels of shape (height, width, 3)."""
        self._plotter.renderer.ResetCameraClippingRange()
        self._plotter.render()
        return shrink(np.asarray(self._plotter.screenshot(None, return_img=True)))

    def close(self) -> None:
        """Close the plotter, which frees its OpenGL window."""
        close_plotter(self._plotter)


class _Shown:
    """A surface inside the plotter: its faces, and its outline as lines over the same points."""

    def __init__(
        self, pyvista: Any, plotter: Any, surface: ShadedSurface, camera: Camera, scalar_colors: ScalarColors | None
    ) -> None:
        self._surface, self._scalar_colors = surface, scalar_colors
        vertices, self._faces = np.array(surface.vertices), np.asarray(surface.faces)
        self._mesh = self._lines = None
        if surface.style == "surface":
            self._mesh = pyvista.PolyData.from_regular_faces(vertices, self._faces)
            self._mesh.point_data["colors"] = np.round(255.0 * vertex_colors(surface, scalar_colors)).astype(np.uint8)
            actor = add_faces(
                plotter,
                self._mesh,
                surface,
                scalars="colors",
                rgb=True,
                opacity=surface.opacity,
                show_edges=surface.edges,
                edge_color=tuple(line_color(surface)),
                line_width=MESH_LINE_WIDTH * SUPERSAMPLING,
                smooth_shading=False,
                reset_camera=False,
            )
            if surface.smooth:
                actor.prop.interpolation = "Phong"
        if surface.style == "surface" and not surface.lined:
            self.move(vertices, camera)
            return
        self._table = EdgeTable.of(vertices, self._faces)
        self._lines = pyvista.PolyData(vertices.copy(), lines=self._line_cells(Sides.of(vertices, self._faces, camera)))
        plotter.add_mesh(
            self._lines,
            color=tuple(line_color(surface)),
            opacity=line_opacity(surface),
            line_width=LINE_WIDTH * SUPERSAMPLING,
            lighting=False,
            reset_camera=False,
            copy_mesh=False,
        )
        self.move(vertices, camera)

    def move(self, vertices: NDArray[np.float64], camera: Camera, scalars: NDArray[np.float64] | None = None) -> None:
        """Update the points in place, and what depends on them; and colour the faces by other scalars (n,), if any."""
        sides = Sides.of(vertices, self._faces, camera)
        if self._mesh is not None:
            self._mesh.points = vertices
            if scalars is not None and self._scalar_colors is not None:
                self._mesh.point_data["colors"] = np.round(255.0 * self._scalar_colors(scalars)).astype(np.uint8)
            if self._surface.smooth:
                self._mesh.point_data.active_normals = sides.smooth
        if self._lines is not None:
            self._lines.points = vertices
            self._lines.lines = self._line_cells(sides)

    def _line_cells(self, sides: Sides) -> NDArray[np.int64]:
        edges = self._table.edges[self._table.outline(sides)]
        return np.column_stack([np.full(len(edges), 2), edges]).ravel()
