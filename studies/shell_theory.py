"""What the studies of shell theory share: sheets with either bending energy on three mesh families, and their cases."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator

import modalshell as ms
from modalshell.core.typing import Progress
from modalshell.supports import Support
from studies.pages import counted

FAMILIES = ("union-jack", "equilateral", "delaunay")
ENERGIES = ("Isotropic", "hinges")


class Sheet(TypedDict):
    """Young's modulus [Pa], Poisson's ratio, thickness [m] and density [kg/m^3]."""

    young: float
    poisson: float
    thickness: float
    density: float


def crossed(**axes: Iterable[Any]) -> list[dict[str, Any]]:
    """Every combination of the values of some axes, such as mesh families and energies, the last the fastest."""
    return [dict(zip(axes, values, strict=True)) for values in product(*axes.values())]


def rows_of(
    answer: Callable[..., Mapping[str, Any] | Iterable[Mapping[str, Any]]],
    cases: Sequence[dict[str, Any]],
    on_step: Progress | None = None,
) -> list[dict[str, Any]]:
    """Rows of findings: what each case is, and the row or rows that ``answer`` finds of it by its keywords."""
    rows = []
    for case in counted(cases, on_step):
        found = answer(**case)
        rows += [{**case, **row} for row in ([found] if isinstance(found, Mapping) else found)]
    return rows


def finite_elements(section: str) -> Any:
    """Cases that solid finite elements answered (``studies/finite_elements.json``)."""
    text = Path(__file__).with_name("finite_elements.json").read_text(encoding="utf-8")
    return json.loads(text)[section]["cases"]


def columns(family: str, squares: float) -> int:
    """Columns of cells along a strip: that many squares, or triangles that are near equilateral."""
    return round(squares * 0.5 * np.sqrt(3.0)) if family == "equilateral" else round(squares)


def plate(family: str, cells: int) -> ms.TriangleMesh:
    """The sheet of side 1 along x from 0, about ``cells`` cells a side."""
    along = round(cells * 2.0 / np.sqrt(3.0)) if family == "equilateral" else cells
    return ms.sheet(length=1.0, width=1.0, cells=(along, cells), family=family)


def flat_shell(
    energy: str,
    mesh: ms.TriangleMesh,
    sheet: Sheet,
    held: NDArray[np.bool_] | None = None,
    supports: Sequence[Support] = (),
    direction: tuple[float, float, float] | None = None,
) -> ms.Shell:
    """Shell of ``sheet`` with one of the ``ENERGIES``, clamped along the vertices ``held``, or on other ``supports``.

    Hinges are calibrated for bending along ``direction``, or along what is longest.

    One held row clamps split folds. Hinges bend at edges between two triangles only: the triangles along the clamped
    line get mirror images behind it, which are held too. Both shells then have the same free vertices, numbered alike,
    and are clamped at the same line.
    """
    if energy == "Isotropic":
        return ms.Shell(mesh, ms.Isotropic(**sheet), clamped=held, supports=supports)
    # Obtuse triangles change the membrane alone, and these sheets hardly stretch.
    with warnings.catch_warnings(action="ignore", category=ms.ModalShellWarning):
        material = ms.Material.from_physical(**sheet, mesh=mesh, direction=direction)
        if held is not None:
            mesh, held = with_mirrored_triangles(mesh, held)
            # The images have no part in the calibration of bending; the membrane's is of each triangle and edge.
            material = replace(ms.Material.from_physical(**sheet, mesh=mesh), flexure=material.flexure)
        return ms.Shell(mesh, material, clamped=held, supports=supports)


def with_mirrored_triangles(
    mesh: ms.TriangleMesh, held: NDArray[np.bool_]
) -> tuple[ms.TriangleMesh, NDArray[np.bool_]]:
    """``mesh`` and the mirror images, behind the line x = 0 of ``held``, of its triangles along it; what they hold."""
    rows = np.flatnonzero(held[mesh.faces].sum(axis=1) == 2)
    opposite, images = np.unique(mesh.faces[rows][~held[mesh.faces[rows]]], return_inverse=True)
    count = len(mesh.vertices)
    mirrored = mesh.faces[rows][:, ::-1].copy()  # reversed, so that they face as the others do
    mirrored[~held[mirrored]] = count + images
    vertices = np.vstack([mesh.vertices, mesh.vertices[opposite] * (-1.0, 1.0, 1.0)])
    further = ms.TriangleMesh(vertices, np.vstack([mesh.faces, mirrored]))
    return further, np.append(held, np.ones(len(opposite), dtype=bool))


def displacements_at(shell: ms.Shell, positions: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Displacements (k, 3) [m] at ``points`` of a shell whose parts lie side by side, seen from above."""
    rest = shell.rest_positions
    kept = rest[:, 0] > -1e-9  # without mirror images behind the clamp
    low, high = rest[kept, :2].min(axis=0), rest[kept, :2].max(axis=0)
    margin = 1e-5 * (high - low)  # not beyond the edges by rounding
    inside = np.clip(points[:, :2], low + margin, high - margin)
    return np.asarray(LinearNDInterpolator(rest[kept, :2], (positions - rest)[kept])(inside))


def square(family: str, cells: tuple[int, int]) -> ms.TriangleMesh:
    """A mesh of the unit square with coordinates from 0 to 1."""
    cells = (columns(family, cells[0]), cells[1])
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
