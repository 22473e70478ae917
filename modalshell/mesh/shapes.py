"""Parametric meshes: beams, sheets, panels, and a folded paper bird."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from modalshell.core.checks import checked_choice, shown
from modalshell.core.errors import OptionError
from modalshell.core.typing import Array, Index
from modalshell.mesh.leaf_shape import leaf
from modalshell.mesh.triangle_mesh import TriangleMesh
from modalshell.mesh.triangulate import FAMILIES, check_angle, check_cells, check_size, mirrored, rectangle

__all__ = ["cylinder_panel", "flat_beam", "leaf", "paper_bird", "sheet", "v_beam"]

# Outline of a wing at fractions of its length from crease to tip; x over the bird's length, from tail to beak.
_STATIONS = (0.0, 0.3, 1.0)
_TRAILING = (0.0, 0.3, 0.38)
"""Trailing edge at the stations, as shares of the length."""
_LEADING = (1.0, 0.88, 0.64)
"""Leading edge at the stations, as shares of the length."""


def flat_beam(
    *, length: float = 1.0, width: float = 0.2, cells: Sequence[int] = (40, 8), family: str = "alternating"
) -> TriangleMesh:
    """Flat beam in the xy plane: x in [0, length], y in [-width/2, width/2], normals along +z.

    Parameters
    ----------
    length, width : float
        Side lengths [m].
    cells : (int, int)
        Cells along and across.
    family : str
        Mesh family: "alternating", "equilateral", "union-jack", "lloyd", "delaunay" or "right".

    Returns
    -------
    TriangleMesh
        The mesh.
    """
    points, faces = rectangle(length, width, cells, family)
    return TriangleMesh(np.column_stack((points[:, 0], points[:, 1] - 0.5 * width, np.zeros(len(points)))), faces)


def sheet(
    *, length: float = 1.0, width: float = 1.0, cells: Sequence[int] = (20, 20), family: str = "alternating"
) -> TriangleMesh:
    """Flat sheet in the xy plane, square by default.

    Parameters
    ----------
    length, width, cells, family : optional
        As for :func:`flat_beam`.

    Returns
    -------
    TriangleMesh
        The mesh.
    """
    return flat_beam(length=length, width=width, cells=cells, family=family)


def v_beam(
    *,
    length: float = 1.0,
    width: float = 0.2,
    fold: float = 150.0,
    cells: Sequence[int] = (40, 8),
    family: str = "alternating",
) -> TriangleMesh:
    """Beam folded along its middle: the ridge on the x axis from x = 0, two flat flanges below it in -z.

    Parameters
    ----------
    length : float
        Length of the ridge [m].
    width : float
        Developed width over both flanges [m].
    fold : float
        Angle between the flanges [degrees], in (0, 180]; 180 is flat.
    cells : (int, int)
        Cells along, and across both flanges (even, so that the ridge lies on mesh edges).
    family : str
        Mesh family of `flat_beam`. "equilateral", "lloyd" and "delaunay" mesh one flange and mirror it; the others
        are the lattice of the developed sheet.

    Returns
    -------
    TriangleMesh
        The mesh.
    """
    points, faces = developed_halves(length, width, cells, family)
    half_fold = 0.5 * np.radians(check_angle(fold, "fold", 180.0))
    # Exactly flat at 180 degrees: cos(pi / 2) is not 0 in floating point.
    drop = 0.0 if fold == 180.0 else float(np.cos(half_fold))
    y = points[:, 1]
    return TriangleMesh(np.column_stack((points[:, 0], np.sin(half_fold) * y, 0.0 - drop * np.abs(y))), faces)


def cylinder_panel(
    *,
    length: float = 1.0,
    radius: float = 0.6,
    angle: float = 90.0,
    cells: Sequence[int] = (20, 20),
    family: str = "alternating",
) -> TriangleMesh:
    """Panel of a circular cylinder about the x axis, its middle line at the top (z = radius), normals outward.

    Parameters
    ----------
    length, radius : float
        Length along x and radius [m].
    angle : float
        Arc over the panel's width [degrees], in (0, 360); the arc has length radius * angle in radians.
    cells : (int, int)
        Cells along x and along the arc.
    family : str
        Mesh family of the developed sheet, as in `flat_beam`.

    Returns
    -------
    TriangleMesh
        The mesh.
    """
    opening = check_angle(angle, "angle", 360.0)
    if opening == 360.0:
        raise OptionError("angle must be below 360 degrees: a panel's two straight sides must not touch (got 360)")
    arc = np.radians(opening)
    r = check_size(radius, "radius")
    points, faces = rectangle(length, r * arc, cells, family)
    phi = points[:, 1] / r - 0.5 * arc
    return TriangleMesh(np.column_stack((points[:, 0], r * np.sin(phi), r * np.cos(phi))), faces)


def developed_halves(length: float, width: float, cells: Sequence[int], family: str) -> tuple[Array, Index]:
    """Triangulate [0, length] x [-width/2, width/2] with the line y = 0 on edges: points (n, 2) [m], faces (T, 3)."""
    along, across = check_cells(cells)
    if across % 2:
        raise OptionError(f"cells[1] must be even to have a row of edges on the ridge, got {across}; use {across + 1}")
    half = 0.5 * check_size(width, "width")
    if checked_choice("family", family, FAMILIES) in ("equilateral", "lloyd", "delaunay"):
        return mirrored(*rectangle(length, half, (along, across // 2), family))
    points, faces = rectangle(length, width, cells, family)
    side = np.linspace(0.0, half, across // 2 + 1)  # mirrored rather than shifted, so that the ridge is exactly y = 0
    points[:, 1] = np.tile(np.concatenate((-side[:0:-1], side)), along + 1)
    return points, faces


def paper_bird(
    *,
    length: float = 0.2,
    wing: float = 0.18,
    body: float = 0.04,
    opening: float = 40.0,
    dihedral: float = 15.0,
    cells: Sequence[int] = (16, 14),
) -> TriangleMesh:
    """Paper bird that flies along +x, its tail at x = 0, its wings in +-y and above z = 0, its body below.

    Each half is developable: folded from flat paper at the keel and at the crease between body and wing, which lies
    at z = 0. Clamp the body, the vertices with z <= 0.

    Parameters
    ----------
    length : float
        Length of the body from tail to beak [m].
    wing, body : float
        Developed length of a wing from the crease to its tip, and of the body's side from keel to crease [m].
    opening : float
        Angle between the sides of the body at the keel [degrees], in (0, 180].
    dihedral : float
        Rise of the wings above the horizontal [degrees], in (0, 90].
    cells : (int, int)
        Cells along the body, and from keel to wing tip (at least 2), shared out by length.

    Returns
    -------
    TriangleMesh
        The mesh.
    """
    long, side, reach = check_size(length, "length"), check_size(body, "body"), check_size(wing, "wing")
    half_opening = 0.5 * np.radians(check_angle(opening, "opening", 180.0))
    rise = np.radians(check_angle(dihedral, "dihedral", 90.0))
    along, across = check_cells(cells)
    if across < 2:
        raise OptionError(f"a bird needs at least 2 cells from keel to wing tip, got {shown(cells)}")
    below = int(np.clip(round(across * side / (side + reach)), 1, across - 1))
    points, faces = rectangle(1.0, 1.0, (along, across), "alternating")
    # Rows to developed distances from the keel, the crease on one of them.
    row = np.round(points[:, 1] * across)
    part = np.maximum(row - below, 0.0) / (across - below)
    points[:, 1] = side * np.minimum(row / below, 1.0) + reach * part
    points[:, 0] = _along(points[:, 0], part, long)
    points, faces = mirrored(points, faces)
    distance = np.abs(points[:, 1])
    in_body, in_wing = np.minimum(distance, side), np.maximum(distance - side, 0.0)
    y = in_body * np.sin(half_opening) + in_wing * np.cos(rise)
    z = (in_body - side) * np.cos(half_opening) + in_wing * np.sin(rise)
    return TriangleMesh(np.column_stack((points[:, 0], np.copysign(y, points[:, 1]), z)), faces)


def _along(fraction: Array, part: Array, length: float) -> Array:
    """Place x [m] at fractions of the chord, at fractions ``part`` of the wing."""
    trailing, leading = np.interp(part, _STATIONS, _TRAILING), np.interp(part, _STATIONS, _LEADING)
    return length * (trailing + fraction * (leading - trailing))
