"""Triangulations of a plane rectangle, by mesh family.

The family sets how a hinge shell bends: near-equilateral and Lloyd-relaxed meshes bend the same in every direction,
chessboard diagonals nearly so, and one diagonal throughout twists under a symmetric load.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
from scipy.spatial import QhullError

from modalshell.core.checks import checked_choice, checked_count, checked_number, shown
from modalshell.core.errors import ModalShellWarning, OptionError
from modalshell.core.memory import demand_memory, gigabytes
from modalshell.core.typing import Array, Index
from modalshell.mesh.lloyd import delaunay_faces, relax_in_rectangle, signed_areas

FAMILIES = ("alternating", "equilateral", "union-jack", "lloyd", "delaunay", "right")
_CELL_BYTES, _SHELL_BYTES, _SHELL_SECONDS = 700, 5_000, 2.2e-5
"""Memory per cell [bytes] while a mesh is made, and memory and time [s] of a shell of :class:`Isotropic` on it."""
_SLOW_CELLS = 300_000
"""Cells from which a mesh and a shell on it take more than some five seconds."""
_MOST_CELLS = 20_000_000
"""Of a generated mesh; more do not fit the memory of a common machine."""


def rectangle(length: float, width: float, cells: Sequence[int], family: str) -> tuple[Array, Index]:
    """Triangulate [0, length] x [0, width].

    Parameters
    ----------
    length, width : float
        Side lengths along x and y [m].
    cells : (int, int)
        Cells along x and y.
    family : str
        "right": one diagonal, from (0, 0) to (1, 1) of every cell. "alternating" and "union-jack" are two names of one
        lattice: diagonals alternate like a chessboard, so those of every 2 x 2 block of cells meet in its centre; cell
        (0, 0) has its diagonal from (0, 0) to (1, 1). "equilateral": columns of vertices at x = i length / cells[0],
        odd columns shifted by half a cell, with extra vertices on the sides; equilateral where
        length / cells[0] = sqrt(3) / 2 width / cells[1]. "lloyd": those points, shifted at random (seed 0), after 20
        Lloyd iterations, Delaunay, boundary vertices at the spacing of the cells; nearly all have six neighbours.
        "delaunay": as many points anywhere in the rectangle instead, which end with five to seven, rarely four or
        eight.

    Returns
    -------
    points : (n, 2) float
        Positions [m], column by column: for "right", "alternating" and "union-jack" vertex i (cells[1] + 1) + j.
    faces : (T, 3) int
        Triangles, counter-clockwise.
    """
    across, along = check_size(width, "width"), check_size(length, "length")
    columns, rows = check_cells(cells)
    checked_choice("family", family, FAMILIES)
    if family == "equilateral":
        return _equilateral(along, across, columns, rows)
    if family in ("lloyd", "delaunay"):
        return _lloyd(along, across, columns, rows, anywhere=family == "delaunay")
    return _lattice(along, across, columns, rows, chessboard=family != "right")


def mirrored(points: Array, faces: Index) -> tuple[Array, Index]:
    """Join a triangulation of y >= 0 with its mirror image at y = 0; vertices sorted by x, then y."""
    ridge = points[:, 1] == 0.0
    image = np.where(ridge, np.arange(len(points)), len(points) + np.cumsum(~ridge) - 1)
    joined = np.vstack((points, points[~ridge] * (1.0, -1.0)))
    return sort_by_column(joined, np.vstack((faces, image[faces][:, [0, 2, 1]])))


def sort_by_column(points: Array, faces: Index) -> tuple[Array, Index]:
    """Renumber the vertices by x, then y, which keeps a long strip's matrices banded."""
    order = np.lexsort((points[:, 1], points[:, 0]))
    return points[order], np.argsort(order)[faces].astype(np.int64)


def check_size(value: float, name: str) -> float:
    """Return a positive finite length [m], or raise OptionError."""
    return checked_number(name, value, above=0.0, unit="m")


def check_angle(value: float, name: str, largest: float) -> float:
    """Return an angle [degrees] in (0, largest], or raise OptionError."""
    return checked_number(name, value, above=0.0, at_most=largest, unit="degrees")


def check_cells(cells: Sequence[int]) -> tuple[int, int]:
    """Return `cells` as two whole numbers >= 1, or raise OptionError."""
    try:
        pair = tuple(cells)
    except TypeError:
        pair = ()
    if len(pair) != 2:
        raise OptionError(f"cells must be two numbers, along x and across, such as (40, 8) (got {shown(cells)})")
    along, across = (checked_count(f"cells[{k}]", count) for k, count in enumerate(pair))
    if along * across > _MOST_CELLS:
        raise OptionError(f"cells must be at most {_MOST_CELLS:,} in all (got {along} x {across})")
    what = f"a mesh of {along} x {across} cells"
    demand_memory(what, _CELL_BYTES * along * across, "take fewer cells")
    if along * across > _SLOW_CELLS:
        warnings.warn(
            f"{what} and a shell on it take about {_SHELL_SECONDS * along * across:.0f} s and "
            f"{gigabytes(_SHELL_BYTES * along * across)}; take fewer cells to be faster",
            ModalShellWarning,
            stacklevel=4,
        )
    return along, across


def _lattice(length: float, width: float, columns: int, rows: int, *, chessboard: bool) -> tuple[Array, Index]:
    x, y = np.linspace(0.0, length, columns + 1), np.linspace(0.0, width, rows + 1)
    points = np.column_stack((np.repeat(x, rows + 1), np.tile(y, columns + 1)))
    i, j = (index.ravel() for index in np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij"))
    a = i * (rows + 1) + j
    b, c, d = a + rows + 1, a + rows + 2, a + 1  # counter-clockwise round the cell
    rising = np.stack((np.stack((a, b, c), 1), np.stack((a, c, d), 1)), 1)
    falling = np.stack((np.stack((a, b, d), 1), np.stack((b, c, d), 1)), 1)
    odd = ((i + j) % 2 == 1) & chessboard
    return points, np.where(odd[:, None, None], falling, rising).reshape(-1, 3).astype(np.int64)


def shifted_column(cells: int) -> Array:
    """Heights over [0, 1] of a column shifted by half a cell, with its two ends: shape (cells + 2,)."""
    return np.concatenate(([0.0], (np.arange(cells) + 0.5) / cells, [1.0]))


def _equilateral(length: float, width: float, columns: int, rows: int) -> tuple[Array, Index]:
    straight, shifted = np.linspace(0.0, 1.0, rows + 1), shifted_column(rows)
    x = np.linspace(0.0, length, columns + 1)
    heights = [straight if i % 2 == 0 else shifted for i in range(columns + 1)]
    points = np.vstack([np.column_stack((np.full(len(h), x[i]), width * h)) for i, h in enumerate(heights)])
    start = np.cumsum([0] + [len(h) for h in heights])
    k = np.arange(rows)
    strips = []
    for i in range(columns):
        even, odd = (start[i], start[i + 1]) if i % 2 == 0 else (start[i + 1], start[i])
        # Triangles with their base on the straight column, then those with it on the shifted one (two half ones).
        bases = np.column_stack((even + k, odd + k + 1, even + k + 1))
        tips = np.column_stack((even + np.arange(rows + 1), odd + np.arange(rows + 1), odd + np.arange(1, rows + 2)))
        strip = np.vstack((bases, tips))
        strips.append(strip if i % 2 == 0 else strip[:, [0, 2, 1]])
    return points, np.vstack(strips).astype(np.int64)


def _lloyd(length: float, width: float, columns: int, rows: int, *, anywhere: bool) -> tuple[Array, Index]:
    lattice, _ = _equilateral(length, width, columns, rows)
    inside = (lattice > 0.0).all(axis=1) & (lattice < (length, width)).all(axis=1)
    spacing = np.array((length / columns, width / rows))
    random = np.random.default_rng(0)
    if anywhere:
        first = random.uniform(size=(int(inside.sum()), 2)) * (length, width)
    else:
        first = lattice[inside] + random.uniform(-0.25, 0.25, (int(inside.sum()), 2)) * spacing
    x, y = np.linspace(0.0, length, columns + 1), np.linspace(0.0, width, rows + 1)
    sides = [np.column_stack((x, np.full_like(x, at))) for at in (0.0, width)]
    sides += [np.column_stack((np.full(rows - 1, at), y[1:-1])) for at in (0.0, length)]
    fixed = np.vstack(sides)
    refusal = OptionError(
        f"no Lloyd mesh fills the rectangle with cells=({columns}, {rows}) of {spacing[0]:g} x {spacing[1]:g} m; "
        "choose cells that are closer to square"
    )
    try:
        interior = relax_in_rectangle(first, fixed, length, width)
        points = np.vstack((fixed, interior))
        faces = delaunay_faces(points, sliver=1e-9 * spacing[0] * spacing[1])
    except QhullError as error:
        raise refusal from error
    if not np.isclose(signed_areas(points, faces).sum(), length * width, rtol=1e-9):
        raise refusal
    return sort_by_column(points, faces)
