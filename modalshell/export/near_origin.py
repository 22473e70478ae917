"""Single precision keeps about seven digits: shells far from the origin are centred, or refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from modalshell.core.errors import OptionError
from modalshell.core.single_precision import lost_in_single_precision, reach_and_size
from modalshell.core.typing import Array
from modalshell.motion import Trajectory

_FAR = 100.0
"""Distance from the origin over the shell's size beyond which files keep a centre apart from the shape."""


def centre_of(rest: Array) -> Array:
    """The middle (3,) of a shell far from the origin, a number of single precision; zeros near it."""
    reach, size = reach_and_size(rest)
    if reach <= _FAR * size:
        return np.zeros(3)
    return (0.5 * (rest.min(axis=0) + rest.max(axis=0))).astype(np.float32).astype(np.float64)


def centred(run: Trajectory) -> tuple[Trajectory, Array]:
    """The trajectory about :func:`centre_of` of its rest shape, and that centre; the trajectory itself near the origin.

    OptionError if its positions were stored in single precision, in which the shape is lost.
    """
    if run.positions.dtype == np.float32:
        demand_near_origin(run.rest_positions, run.units.length, 'positions stored in single precision ("float32")')
    centre = centre_of(run.rest_positions)
    if not centre.any():
        return run, centre
    return replace(run, positions=run.positions - centre, rest_positions=run.rest_positions - centre), centre


def demand_near_origin(rest: NDArray[np.floating], unit: str, kind: str) -> None:
    """OptionError where single precision loses the shape of a shell; ``kind`` names what is to be stored so."""
    held = lost_in_single_precision(rest, unit)
    if held:
        raise OptionError(
            f"{kind} hold {held}: move the mesh near the origin, or write npz (float64), vtkhdf, pvd, usd or gltf"
        )
