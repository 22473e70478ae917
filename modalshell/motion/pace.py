"""How fast motions are shown: at real speed, but slowed where they are too brief to be seen."""

from __future__ import annotations

import math

from modalshell.core.typing import Array

_BRIEF, _WATCHED, _LEAST_RATE = 0.5, 2.0, 10.0
"""Seconds below which a motion is slowed, how long it then lasts at most, and its frames a second at least."""


def slowing(times: Array, second: float = 1.0) -> int:
    """How many times slower than real a motion is shown: 1, or 2, 5, 10, 20 and so on for one too brief to be seen.

    Parameters
    ----------
    times : ndarray, shape (F,)
        Of its frames, evenly apart.
    second : float
        The unit of the times [s].
    """
    lasts = second * float(times[-1] - times[0])
    if lasts <= 0.0 or lasts >= _BRIEF * (1.0 - 1e-9):
        return 1
    wanted = min(_WATCHED / lasts, (len(times) - 1) / (lasts * _LEAST_RATE)) * (1.0 + 1e-9)
    if wanted < 1.0:  # few frames are no motion, however long each is seen
        return 1
    power = 10 ** math.floor(math.log10(wanted))
    return max(step * power for step in (1, 2, 5) if step * power <= wanted)
