"""Web page that plays a compressed motion: amplitudes of a few shapes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from modalshell.core.typing import Array
from modalshell.page.html import Page, encoded, filled_page, modal_data


def clip_page(
    times: Array,
    rest_positions: NDArray[np.floating],
    faces: NDArray[np.integer],
    shapes: Array,
    amplitudes: NDArray[np.floating],
    *,
    title: str,
) -> Page:
    """A page that plays ``rest + sum_k amplitudes[f, k] shapes[k]`` in a loop.

    Parameters
    ----------
    times : ndarray, shape (F,)
        [s], increasing.
    rest_positions : ndarray, shape (n, 3)
        [m].
    faces : ndarray of int, shape (T, 3)
        Triangles.
    shapes : ndarray, shape (K, n, 3)
        Displacements [m].
    amplitudes : ndarray, shape (F, K)
        Of the shapes in each frame.
    title : str
        Headline of the page.

    Raises
    ------
    OptionError
        If there are more shapes than a browser's shader takes.
    """
    rest = np.asarray(rest_positions, float)
    low, high = rest.min(axis=0), rest.max(axis=0)
    largest = np.abs(amplitudes).max(axis=0, initial=0.0)
    data = {
        **modal_data(rest - 0.5 * (low + high), faces, np.reshape(shapes, (len(shapes), -1)).T),
        "times": np.asarray(times).tolist(),
        "play": encoded(np.asarray(amplitudes, np.float32)),
        "amplitudes": np.where(largest > 0.0, largest, 1.0).tolist(),
        "gravity": [0.0, 0.0, -1.0],
        "tip": int(np.linalg.norm(np.tensordot(amplitudes[-1], shapes, 1), axis=1).argmax()),
        "size": float((high - low).max()),
        "centre": (0.5 * (low + high)).tolist(),
    }
    return filled_page("shell", title, data, rest, faces)
