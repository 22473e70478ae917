"""The page of a sheet of masses and springs, stepped by Verlet's method on the browser's GPU."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from modalshell.checks import checked_number
from modalshell.errors import OptionError
from modalshell.page.html import Page, filled_page
from modalshell.typing import Array

_COINCIDENT = 1e-12
"""Distance of two masses over the spacing, far below which the force between them is none."""
_MOST_STEPS = 40
"""Steps a frame at most."""
_PICTURE = 48
"""Cells along each side of the picture of the sheet at rest."""


def sheet_page(
    *,
    shape: tuple[int, int],
    spacing: float,
    accelerations: list[float],
    drag: float,
    pinned: NDArray[np.bool_],
    gravity: Array,
    dt: float,
    stable_step: float,
    title: str,
) -> Page:
    """A page that steps a sheet as :class:`modalshell.springs.GridVerlet` does in single precision.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns of masses.
    spacing : float
        Of neighbours at rest [m].
    accelerations : list of 3 floats
        Stiffness over mass of structural, shear and flexion springs [1/s^2].
    drag : float
        Deceleration over velocity [1/s].
    pinned : ndarray of bool, shape (rows, columns)
        Masses that do not move.
    gravity : ndarray, shape (3,)
        [m/s^2].
    dt : float
        Time step [s].
    stable_step : float
        Longest stable step [s].
    title : str
        Headline of the page.

    Raises
    ------
    OptionError
        For a step above the stable one.
    """
    if checked_number("dt", dt, above=0.0, unit="s") > stable_step:
        raise OptionError(f"Verlet needs a step of at most {stable_step:.3g} s on this sheet (got {dt:.3g} s)")
    rows, columns = shape
    middle = [0.5 * spacing * (columns - 1), 0.5 * spacing * (rows - 1)]
    data = {
        "rows": rows,
        "columns": columns,
        "spacing": spacing,
        "stiffness": accelerations,
        "drag": drag,
        "pinned": np.flatnonzero(pinned).tolist(),
        "gravity": gravity.tolist(),
        "dt": dt,
        "tiny": (_COINCIDENT * spacing) ** 2,
        "most": _MOST_STEPS,
        "size": 2.0 * max(middle),
        "middle": middle,
    }
    cells = np.arange(_PICTURE**2)
    corner = cells + cells // _PICTURE
    row = _PICTURE + 1
    faces = np.concatenate(
        [
            np.column_stack([corner, corner + 1, corner + row]),
            np.column_stack([corner + 1, corner + row + 1, corner + row]),
        ]
    )
    across, along = np.meshgrid(np.linspace(0.0, 2.0 * middle[0], row), np.linspace(0.0, 2.0 * middle[1], row))
    points = np.column_stack([across.ravel(), along.ravel(), np.zeros(row**2)])
    return filled_page("sheet", title, data, points, faces)
