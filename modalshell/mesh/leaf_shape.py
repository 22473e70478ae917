"""Mesh of a leaf: a stalk to clamp, a blade with a pointed tip, a folded midrib and slight rest curvature."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from modalshell.core.checks import checked_choice, checked_number, shown
from modalshell.core.errors import OptionError
from modalshell.core.typing import Array, Index
from modalshell.mesh.lloyd import delaunay_faces, signed_areas
from modalshell.mesh.triangle_mesh import TriangleMesh
from modalshell.mesh.triangulate import FAMILIES, check_angle, check_cells, check_size, mirrored, shifted_column

STALK_LENGTH = 0.08  # of the leaf's length
STALK_WIDTH = 0.2  # of the leaf's width


def leaf(
    *,
    length: float = 1.0,
    width: float = 0.4,
    fold: float = 160.0,
    camber: float = 0.1,
    curl: float = 20.0,
    cells: Sequence[int] = (32, 12),
    family: str = "equilateral",
) -> TriangleMesh:
    """Leaf with its midrib from the origin along x, its halves below it in -z and its tip drooping.

    The stalk, of a fifth of the width, runs over the first 8 % of the length: clamp its first two columns of vertices.

    Parameters
    ----------
    length, width : float
        Length of the midrib and developed width of the blade at its widest [m].
    fold : float
        Angle between the halves at the midrib [degrees], in (0, 180]; 180 is unfolded.
    camber : float
        Drop of the margin below the straight flange, over half the width, growing quadratically from the midrib.
    curl : float
        Angle by which the midrib turns downwards from stalk to tip, along a circular arc [degrees], in [0, 180].
    cells : (int, int)
        Cells along the midrib (at least 4) and across the widest part (even); fewer across where the leaf is narrower.
    family : str
        Mesh family, as in `flat_beam`; a narrowing leaf keeps its lattice only where neighbouring columns are equal.

    Returns
    -------
    TriangleMesh
        The mesh.
    """
    check_size(length, "length")
    half_fold = 0.5 * np.radians(check_angle(fold, "fold", 180.0))
    camber = checked_number("camber", camber, at_least=0.0, at_most=1.0)
    curl = checked_number("curl", curl, at_least=0.0, at_most=180.0)
    along, across = check_cells(cells)
    if across % 2 or along < 4:
        raise OptionError(f"a leaf needs at least 4 cells along and an even number across, got {shown(cells)}")
    half_width = 0.5 * check_size(width, "width")
    points, faces = mirrored(
        *_half_blade(length, half_width, along, across // 2, checked_choice("family", family, FAMILIES))
    )
    s, t = points[:, 0], np.abs(points[:, 1])
    y = np.sin(half_fold) * points[:, 1]
    drop = 0.0 if fold == 180.0 else float(np.cos(half_fold))
    z = 0.0 - drop * t - camber * t**2 / half_width
    if curl == 0.0:
        return TriangleMesh(np.column_stack((s, y, z)), faces)
    # The midrib bends to an arc of radius `bend`; material above it would be stretched, below it compressed.
    bend = length / np.radians(curl)
    turn = s / bend
    x = (bend + z) * np.sin(turn)
    return TriangleMesh(np.column_stack((x, y, (bend + z) * np.cos(turn) - bend)), faces)


def half_outline(s: Array) -> Array:
    """Half-width over its maximum at fractions `s` of the length, both shape (k,): stalk, then a blade to the tip."""
    b = STALK_WIDTH
    # (1 - u)(b + 4 a u) with a chosen so that its maximum over the blade is 1.
    a = (16.0 - 8.0 * b + np.sqrt((16.0 - 8.0 * b) ** 2 - 64.0 * b**2)) / 32.0
    u = np.clip((s - STALK_LENGTH) / (1.0 - STALK_LENGTH), 0.0, 1.0)
    return (1.0 - u) * (b + 4.0 * a * u)


def _half_blade(length: float, half_width: float, along: int, rows: int, family: str) -> tuple[Array, Index]:
    """Triangulate the half y >= 0 of the outline: points (n, 2) [m] and counter-clockwise faces (T, 3)."""
    s = np.linspace(0.0, 1.0, along + 1)
    outline = half_outline(s)
    cells = np.maximum(1, np.round(rows * outline)).astype(int)
    shifts = family in ("equilateral", "lloyd", "delaunay")
    columns = [shifted_column(c) if shifts and i % 2 else np.linspace(0.0, 1.0, c + 1) for i, c in enumerate(cells)]
    columns[-1] = np.zeros(1)
    points = np.vstack(
        [np.column_stack((np.full(len(h), length * s[i]), half_width * outline[i] * h)) for i, h in enumerate(columns)]
    )
    start = np.cumsum([0] + [len(h) for h in columns])
    heights = np.split(points[:, 1], start[1:-1])
    faces = [
        face
        for i in range(along)
        for face in _zip(heights[i], heights[i + 1], start[i], start[i + 1], i, chessboard=family != "right")
    ]
    triangles = np.array(faces, dtype=np.int64)
    if family in ("lloyd", "delaunay"):
        margin = np.column_stack((length * s, half_width * outline))
        return _relaxed(points, triangles, margin, anywhere=family == "delaunay")
    return points, triangles


def _zip(
    left: Array, right: Array, first: int, second: int, column: int, *, chessboard: bool
) -> list[tuple[int, int, int]]:
    """Triangulate the strip between two columns of ascending heights [m], whose vertices start at `first`, `second`."""
    faces = []
    tie_below = 1e-9 * max(left[-1], right[-1])
    i = j = 0
    while i + 1 < len(left) or j + 1 < len(right):
        a, b = first + i, second + j
        if i + 1 == len(left):
            up_right = True
        elif j + 1 == len(right):
            up_right = False
        else:  # the shorter diagonal; a tie is a cell, where the family sets it
            gap = abs(right[j + 1] - left[i]) - abs(left[i + 1] - right[j])
            tie = abs(gap) < tie_below
            up_right = bool((not chessboard or (column + i) % 2 == 0) if tie else gap < 0)
        faces.append((a, b, b + 1) if up_right else (a, b, a + 1))
        i, j = (i, j + 1) if up_right else (i + 1, j)
    return faces


def _relaxed(points: Array, faces: Index, margin: Array, *, anywhere: bool) -> tuple[Array, Index]:
    """Move the interior points to the centroids of the triangles around them, 20 times, with Delaunay in between."""
    area = signed_areas(points, faces)
    edge = np.interp(points[:, 0], margin[:, 0], margin[:, 1])
    interior = (points[:, 1] > 0.0) & (points[:, 1] < edge * (1.0 - 1e-9)) & (points[:, 0] > 0.0)
    rng = np.random.default_rng(0)
    moved = points.copy()
    if anywhere:
        chosen = rng.choice(len(faces), int(interior.sum()), p=area / area.sum())
        moved[interior] = np.einsum("ck,cki->ci", rng.dirichlet((1.0, 1.0, 1.0), chosen.size), points[faces[chosen]])
    else:
        moved[interior] += rng.uniform(-0.2, 0.2, (int(interior.sum()), 2)) * np.sqrt(area.mean())
    for _ in range(20):
        faces = _delaunay_inside(moved, margin, area)
        part = signed_areas(moved, faces)
        centroid = moved[faces].mean(axis=1)
        weight = np.bincount(faces.ravel(), np.repeat(part, 3), len(moved))
        for axis in (0, 1):
            moment = np.bincount(faces.ravel(), np.repeat(part * centroid[:, axis], 3), len(moved))
            moved[interior, axis] = moment[interior] / weight[interior]
    faces = _delaunay_inside(moved, margin, area)
    if not np.isclose(signed_areas(moved, faces).sum(), area.sum(), rtol=1e-9):
        raise OptionError(
            "no Lloyd mesh fills this leaf's outline; choose cells that are closer to square, or family='equilateral'"
        )
    return moved, faces


def _delaunay_inside(points: Array, margin: Array, area: Array) -> Index:
    faces = delaunay_faces(points, sliver=1e-9 * float(area.mean()))
    centre = points[faces].mean(axis=1)
    inside: Index = faces[centre[:, 1] < np.interp(centre[:, 0], margin[:, 0], margin[:, 1])]
    return inside
