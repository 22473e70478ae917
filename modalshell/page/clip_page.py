"""Web page that plays a compressed motion: amplitudes of a few shapes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from modalshell.core.typing import Array
from modalshell.core.units import SI, UnitSystem
from modalshell.page.html import Page
from modalshell.page.record import recorded
from modalshell.page.shell_page import Body, shell_page


def clip_page(
    times: Array,
    rest_positions: NDArray[np.floating],
    faces: NDArray[np.integer],
    shapes: Array,
    amplitudes: NDArray[np.floating],
    *,
    title: str,
    units: UnitSystem = SI,
    bodies: Sequence[Body] = (),
    notes: Sequence[str] = (),
) -> Page:
    """A page that plays ``rest + sum_k amplitudes[f, k] shapes[k]`` in a loop.

    Rest positions (n, 3) and ``shapes`` (K, n, 3) are in [m], ``amplitudes`` (F, K) those of the shapes in each frame,
    ``times`` (F,) [s] increase. All numbers are in the ``units``; ``bodies`` are those of :func:`shell_page`, ``notes``
    are shown below. OptionError if there are more shapes than a browser's shader takes.
    """
    return shell_page(
        np.asarray(rest_positions, float),
        faces,
        title=title,
        tip=farthest(shapes, amplitudes),
        record=recorded(times, shapes, amplitudes, label="Recorded motion"),
        units=units,
        bodies=bodies,
        notes=notes,
    )


def farthest(shapes: Array, amplitudes: NDArray[np.floating]) -> int:
    """The vertex that has moved farthest in the last frame."""
    return int(np.linalg.norm(np.tensordot(amplitudes[-1], shapes, 1), axis=1).argmax())
