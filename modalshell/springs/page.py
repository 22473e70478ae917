"""Web page of a sheet of springs, stepped by Verlet's method on the browser's GPU."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from modalshell.core.checks import checked_number
from modalshell.core.errors import OptionError
from modalshell.core.typing import Array
from modalshell.mesh import sheet
from modalshell.page.html import Page, filled_page

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
    tiny: float,
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
    tiny : float
        Squared distance of two masses [m^2], far below which the force between them is none.
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
        "tiny": tiny,
        "most": _MOST_STEPS,
        "size": 2.0 * max(middle),
        "middle": middle,
    }
    picture = sheet(length=2.0 * middle[0], width=2.0 * middle[1], cells=(_PICTURE, _PICTURE))
    return filled_page("sheet", title, data, picture.vertices, picture.faces, __package__)
