"""What a page plays: a stored motion or answer, and the field that colours it, as sums of a few shapes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from modalshell.core.errors import OptionError
from modalshell.core.typing import Array
from modalshell.motion.bars import Bars
from modalshell.page.html import MOST_SHAPES, encoded, encoded_columns

_STOPS = 33
"""Colours of a colour map on a page; between them it is linear."""
_TONE_ERROR = 0.01
"""Largest error of a colouring field on a page, as a share of its range."""


@final
@dataclass(frozen=True)
class Tones:
    """The field that colours a motion."""

    values: Array
    """At the vertices, in each frame; shape (F, n)."""
    label: str
    """Its name with its unit."""
    range: tuple[float, float]
    """Values at the ends of the colour map."""
    colormap: str
    """Matplotlib's name of the colour map."""


def recorded(
    times: Array,
    shapes: Array,
    amplitudes: NDArray[np.floating],
    *,
    label: str,
    tones: Tones | None = None,
    bars: Bars | None = None,
) -> dict[str, Any]:
    """The frames ``rest + sum_k amplitudes[f, k] shapes[k]`` as a page reads them.

    OptionError if there are more shapes than a browser's shader takes.

    Parameters
    ----------
    times : ndarray, shape (F,)
        [s], increasing; a single one is an answer that stands still.
    shapes : ndarray, shape (K, n, 3)
        Displacements [m].
    amplitudes : ndarray, shape (F, K)
        Of the shapes in each frame.
    label : str
        What the page calls them.
    tones : Tones, optional
        Field that colours the shell.
    bars : Bars, optional
        Error bars that the page shows next to the time, each from its check on.
    """
    if len(shapes) > MOST_SHAPES:
        raise OptionError(f"a page takes at most {MOST_SHAPES} shapes (got {len(shapes)}): store fewer frames")
    if len(shapes) == 0:  # nothing moves
        shapes, amplitudes = np.zeros((1, *shapes.shape[1:])), np.zeros((len(times), 1))
    record: dict[str, Any] = {
        "times": np.asarray(times, dtype=float).tolist(),
        "label": label,
        "shapes": encoded_columns(np.reshape(shapes, (len(shapes), -1)).T),
        "amounts": encoded(np.asarray(amplitudes, np.float32)),
        "tones": None if tones is None else _toned(tones),
    }
    if bars is not None:  # a page without any is as it was
        record["bars"] = {"times": bars.times.tolist(), "texts": bars.texts()}
    return record


def _toned(tones: Tones) -> dict[str, Any]:
    """A field as a sum of few columns, by singular values, and its colours."""
    from matplotlib import colormaps

    left, sizes, right = np.linalg.svd(np.asarray(tones.values, dtype=float), full_matrices=False)
    allowed = _TONE_ERROR * max(tones.range[1] - tones.range[0], 1e-300)
    count, most = 1, min(len(sizes), MOST_SHAPES)
    while count < most and np.abs((left[:, :count] * sizes[:count]) @ right[:count] - tones.values).max() > allowed:
        count += 1
    colours = colormaps[tones.colormap](np.linspace(0.0, 1.0, _STOPS))[:, :3]
    return {
        "values": encoded_columns(right[:count].T),
        "amounts": encoded((left[:, :count] * sizes[:count]).astype(np.float32)),
        "range": list(tones.range),
        "label": tones.label,
        "ramp": encoded(np.rint(255.0 * colours).astype(np.uint8)),
    }


def farthest(shapes: Array, amplitudes: NDArray[np.floating]) -> int:
    """The vertex that has moved farthest in the last frame."""
    return int(np.linalg.norm(np.tensordot(amplitudes[-1], shapes, 1), axis=1).argmax())
