"""Mesh of a folded paper bird: a narrow body, open at the top, with two folded wings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from modalshell.core.checks import shown
from modalshell.core.errors import OptionError
from modalshell.mesh.topology import FloatArray
from modalshell.mesh.triangle_mesh import TriangleMesh
from modalshell.mesh.triangulate import check_angle, check_cells, check_size, mirrored, rectangle

# Outline of a wing at fractions of its length from crease to tip; x over the bird's length, from tail to beak.
_STATIONS = (0.0, 0.3, 1.0)
_TRAILING = (0.0, 0.3, 0.38)
"""Trailing edge at the stations, as shares of the length."""
_LEADING = (1.0, 0.88, 0.64)
"""Leading edge at the stations, as shares of the length."""


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


def _along(fraction: FloatArray, part: FloatArray, length: float) -> FloatArray:
    """Place x [m] at fractions of the chord, at fractions ``part`` of the wing."""
    trailing, leading = np.interp(part, _STATIONS, _TRAILING), np.interp(part, _STATIONS, _LEADING)
    return length * (trailing + fraction * (leading - trailing))
