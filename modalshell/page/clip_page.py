"""The page of a compressed motion: it plays the amplitudes of a few shapes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from modalshell.errors import OptionError
from modalshell.page.html import MOST_SHAPES, Page, encoded, filled_page, halves
from modalshell.typing import Array


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
    count = len(shapes)
    if count > MOST_SHAPES:
        raise OptionError(f"a page takes at most {MOST_SHAPES} shapes (got {count}): allow a larger tolerance")
    rest = np.asarray(rest_positions, float)
    low, high = rest.min(axis=0), rest.max(axis=0)
    half_shapes, scales = halves(np.reshape(shapes, (count, -1)).T)
    largest = np.abs(amplitudes).max(axis=0, initial=0.0)
    data = {
        "vertices": len(rest),
        "modes": count,
        "rest": encoded((rest - 0.5 * (low + high)).astype(np.float32)),
        "faces": encoded(faces.astype(np.uint32)),
        "phi": encoded(half_shapes),
        "phiScales": scales.tolist(),
        "times": np.asarray(times).tolist(),
        "play": encoded(np.asarray(amplitudes, np.float32)),
        "amplitudes": np.where(largest > 0.0, largest, 1.0).tolist(),
        "gravity": [0.0, 0.0, -1.0],
        "tip": int(np.linalg.norm(np.tensordot(amplitudes[-1], shapes, 1), axis=1).argmax()),
        "size": float((high - low).max()),
        "centre": (0.5 * (low + high)).tolist(),
    }
    return filled_page("shell", title, data, rest, faces)
