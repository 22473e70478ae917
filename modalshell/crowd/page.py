"""Web page of a flock: boids, modes and warp are computed on the browser's GPU."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modalshell.core.errors import OptionError
from modalshell.core.typing import Array
from modalshell.page.html import Page, encoded, filled_page, modal_data

MOST_BIRDS = 20_000
"""Birds of a page: each looks at all the others."""


def flock_page(
    *,
    rest_positions: Array,
    faces: NDArray[np.integer],
    modes: Array,
    rotations: Array,
    positions: Array,
    directions: Array,
    own: Array,
    numbers: Mapping[str, Any],
    camera: tuple[Array, Array],
    title: str,
) -> Page:
    """A page that flies a flock as :class:`modalshell.Flock` and :class:`modalshell.Crowd` do, in single precision.

    Modal forces are those of LMA, ``Phi^T f`` in each bird's frame; positions are those of MWTS.

    Parameters
    ----------
    rest_positions : ndarray, shape (n, 3)
        Of the shell of a bird [m].
    faces : ndarray of int, shape (T, 3)
        Triangles.
    modes, rotations : ndarray, shape (3n, m)
        Phi and Psi.
    positions, directions : ndarray, shape (N, 3)
        Where the boids start [m], and head.
    own : ndarray, shape (N, 2)
        Place of each boid in the noise of the speed, and phase of its wing beat [rad].
    numbers : mapping
        Rules, noise, flap and modes, by the names that ``flock.js`` reads.
    camera : (ndarray, ndarray)
        Position and target of the camera [m].
    title : str
        Headline of the page.

    Raises
    ------
    OptionError
        For more birds or modes than a browser takes.
    """
    if len(positions) > MOST_BIRDS:
        raise OptionError(f"a page takes at most {MOST_BIRDS:,} birds (got {len(positions):,})")
    eye, target = camera
    back = eye - target
    distance = float(np.linalg.norm(back))
    data = {
        "birds": len(positions),
        **modal_data(rest_positions, faces, modes, rotations),
        "positions": encoded(positions.astype(np.float32)),
        "directions": encoded(directions.astype(np.float32)),
        "own": encoded(own.astype(np.float32)),
        "size": distance,
        "distance": distance,
        "centre": target.tolist(),
        "azimuth": float(np.arctan2(back[1], back[0])),
        "elevation": float(np.arcsin(back[2] / distance)),
        **numbers,
    }
    return filled_page("flock", title, data, rest_positions, faces, __package__)
