"""Web page of one shell: a stored motion or answer, live models, or both."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modalshell.core.errors import OptionError
from modalshell.core.typing import Array
from modalshell.core.units import SI, UnitSystem
from modalshell.motion.bars import Bars
from modalshell.motion.colouring import Colouring
from modalshell.motion.pace import slowing
from modalshell.page.html import MOST_SHAPES, Page, encoded, encoded_columns, filled_page

_SHORT = 65536
"""Vertices up to which the triangles' indices take two bytes."""


Body = tuple[Array, NDArray[np.integer], Array, Array]
"""Vertices (k, 3) [m] and triangles (T, 3) of a rigid body, and its rotations (F, 3, 3) and ways (F, 3) [m]."""
_STOPS = 33
"""Colours of a colour map on a page; between them it is linear."""
_TONE_ERROR = 0.01
"""Largest error of a colouring field on a page, as a share of its range."""


def recorded(
    times: Array,
    shapes: Array,
    amplitudes: NDArray[np.floating],
    *,
    label: str,
    tones: Colouring | None = None,
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
    tones : Colouring, optional
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


def _toned(tones: Colouring) -> dict[str, Any]:
    """A field as a sum of few columns, by singular values, and its colours."""
    from matplotlib import colormaps

    left, sizes, right = np.linalg.svd(np.asarray(tones.values, dtype=float), full_matrices=False)
    low, high = tones.spread()
    allowed = _TONE_ERROR * max(high - low, 1e-300)
    count, most = 1, min(len(sizes), MOST_SHAPES)
    while count < most and np.abs((left[:, :count] * sizes[:count]) @ right[:count] - tones.values).max() > allowed:
        count += 1
    colours = colormaps[tones.colormap](np.linspace(0.0, 1.0, _STOPS))[:, :3]
    return {
        "values": encoded_columns(right[:count].T),
        "amounts": encoded((left[:, :count] * sizes[:count]).astype(np.float32)),
        "range": [low, high],
        "label": tones.label,
        "ramp": encoded(np.rint(255.0 * colours).astype(np.uint8)),
    }


def farthest(shapes: Array, amplitudes: NDArray[np.floating]) -> int:
    """The vertex that has moved farthest in the last frame."""
    return int(np.linalg.norm(np.tensordot(amplitudes[-1], shapes, 1), axis=1).argmax())


def shell_page(
    rest: Array,
    faces: NDArray[np.integer],
    *,
    title: str,
    tip: int,
    live: Mapping[str, Any] | None = None,
    record: Mapping[str, Any] | None = None,
    bodies: Sequence[Body] = (),
    gravity: Sequence[float] = (0.0, 0.0, -1.0),
    notes: Sequence[str] = (),
    units: UnitSystem = SI,
) -> Page:
    """A page that plays what is recorded, lets live models move, or offers both.

    Parameters
    ----------
    rest : ndarray, shape (n, 3)
        Vertices at rest [m].
    faces : ndarray of int, shape (T, 3)
        Triangles.
    title : str
        Headline.
    tip : int
        The vertex whose drop is shown.
    live : mapping, optional
        What :func:`modalshell.page.live_model` gives.
    record : mapping, optional
        What :func:`modalshell.page.recorded` gives; the page begins with it.
    bodies : sequence of tuple
        What the recorded shell touches: vertices (k, 3) [m] and triangles (T, 3) of each, and rotations (F, 3, 3) and
        ways (F, 3) [m] that move them in the frames of the record, or in all of them.
    gravity : sequence of 3 floats
        Acceleration [m/s^2] with which live models start, along which the tip's drop is measured.
    notes : sequence of str
        Sentences below the title: what is shown, and what is left out.
    units : UnitSystem
        Of all numbers.

    Raises
    ------
    OptionError
        If there is neither a record nor a live model.
    """
    if live is None and record is None:
        raise OptionError("a page of a shell needs a record or a live model (got neither)")
    low, high = rest.min(axis=0), rest.max(axis=0)
    centre = 0.5 * (low + high)
    data = {
        "vertices": len(rest),
        "rest": encoded((rest - centre).astype(np.float32)),  # centred before it is rounded to single precision
        "faces": encoded(faces.astype(np.uint16 if len(rest) <= _SHORT else np.uint32)),
        "gravity": list(gravity),
        "earth": units.earth,
        "tip": tip,
        "size": float((high - low).max()),
        "centre": centre.tolist(),
        "units": {"length": units.length, "time": units.time, "frequency": units.of("1/s").replace("1/s", "Hz")},
        "second": 1.0 / units.seconds,
        "live": live,
        "record": record,
    }
    words = {"acceleration": units.of("m/s^2").replace("^2", "²"), "rate": units.of("1/s")}
    slowed = 1 if record is None else slowing(np.asarray(record["times"]), units.seconds)
    if slowed > 1:  # a page at real speed is as it was
        data["slowed"] = slowed
    if bodies:  # a page without any is as it was
        data["bodies"] = [_encoded(*about(body, centre)) for body in bodies]
    if live is not None and "frames" in live:
        data["scripts"] = ["free_parts.js"]
    return filled_page("shell", title, data, rest, faces, notes=notes, words=words)


def about(body: Body, centre: Array) -> Body:
    """The same body with its vertices and its ways about a centre (3,) [m]."""
    vertices, triangles, turns, ways = body
    return vertices - centre, triangles, turns, ways + turns @ centre - centre


def _encoded(vertices: Array, triangles: NDArray[np.integer], turns: Array, ways: Array) -> dict[str, str]:
    """A body as the page reads it."""
    poses = np.concatenate([turns.reshape(-1, 9), ways], axis=1)
    return {
        "rest": encoded(vertices.astype(np.float32)),
        "faces": encoded(triangles.astype(np.uint32)),
        "poses": encoded(poses.astype(np.float32)),
    }
