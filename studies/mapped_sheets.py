"""Sheets that are mapped onto a surface from the unit square, and loads along their edges."""

from __future__ import annotations

import numpy as np

import modalshell as ms


def square(family: str, cells: tuple[int, int]) -> ms.TriangleMesh:
    """A mesh of the unit square with coordinates from 0 to 1."""
    if family == "equilateral":
        cells = (round(cells[0] * np.sqrt(3.0) / 2.0), cells[1])
    # Near-equilateral or square cells of the long sheet, which is then brought to the unit square.
    flat = ms.flat_beam(length=cells[0] / cells[1], width=1.0, cells=cells, family=family)
    points = np.array(flat.vertices)
    points[:, 0] /= cells[0] / cells[1]
    points[:, 1] += 0.5
    return ms.TriangleMesh(points, flat.faces)


def near(mesh: ms.TriangleMesh, point: tuple[float, float, float]) -> int:
    """The vertex at a point."""
    distances = np.linalg.norm(mesh.vertices - point, axis=1)
    return int(distances.argmin())


def spread(mesh: ms.TriangleMesh, line: np.ndarray, total: np.ndarray) -> np.ndarray:
    """A line load (n, 3) of ``total`` over the edges between the vertices ``line`` (bool), by their lengths."""
    edges = mesh.edges[line[mesh.edges].all(axis=1)]
    lengths = np.linalg.norm(mesh.vertices[edges[:, 1]] - mesh.vertices[edges[:, 0]], axis=1)
    weight = np.zeros(len(mesh.vertices))
    np.add.at(weight, edges, 0.5 * lengths[:, None] / lengths.sum())
    return np.outer(weight, total)


def quarter_cylinder(
    family: str, cells: tuple[int, int], radius: float, length: float, grading: float = 1.0
) -> tuple[ms.TriangleMesh, np.ndarray, np.ndarray]:
    """A quarter of a cylinder about the y axis, from its side (v = 0) to its top, and its coordinates u along y, v.

    Above 1 the ``grading`` is the power that draws cells together where u = 0 meets v = 1.
    """
    plain = square(family, cells)
    u, v = plain.vertices[:, 0] ** grading, 1.0 - (1.0 - plain.vertices[:, 1]) ** grading
    angle = 0.5 * np.pi * v
    points = np.column_stack([radius * np.cos(angle), length * u, radius * np.sin(angle)])
    return ms.TriangleMesh(points, plain.faces), u, v
