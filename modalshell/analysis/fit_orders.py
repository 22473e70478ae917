"""Least squares of sorted numbers have a minimum for each order: a search of the others by what is linear about one.

Natural frequencies are known by their order alone. Where two of them cross as the constants change, a fit can end at a
minimum that takes the one for the other. About that minimum the logarithm of each frequency is linear in the parameters
but for the second order, so that the sums of squares of all orders cost next to nothing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from modalshell.core.typing import Array

_STARTS, _STEPS = 96, 25
_REACH = 2.5
"""Farthest start in parameters, of which moduli and thicknesses are logarithms: these change by a factor of 12."""
_DEEPER = 1.0
"""Norm of the misfit of another order, over that of this one, up to which it is worth a search."""
_APART = 0.02
"""Distance in parameters up to which two minima are one."""


def deeper_minima(logs: Array, slopes: Array, rows: NDArray[np.intp], measured: Array, most: int) -> list[Array]:
    """Steps of the parameters (p,) to other minima with a smaller misfit, the deepest first, at most ``most`` of them.

    ``logs`` (M,) are the logarithms of all frequencies found at the minimum, ``slopes`` (M, p) their derivatives by the
    parameters. ``rows`` (k,) are the places of the measured ones among them, sorted, ``measured`` (k,) the logarithms
    of those measured.
    """

    def misfit(step: Array) -> tuple[Array, NDArray[np.intp]]:
        values = logs + slopes @ step
        order = np.argsort(values, kind="stable")[rows]
        return values[order] - measured, order

    here = float(np.linalg.norm(misfit(np.zeros(slopes.shape[1]))[0]))
    starts = np.random.default_rng(0).uniform(-_REACH, _REACH, (_STARTS, slopes.shape[1]))
    found: list[tuple[float, Array]] = []
    for step in starts:
        seen = None
        for _ in range(_STEPS):
            off, order = misfit(step)
            if seen is not None and np.array_equal(order, seen):
                break
            step, seen = step - np.linalg.lstsq(slopes[order], off, rcond=1e-6)[0], order
        norm = float(np.linalg.norm(misfit(step)[0]))
        near = np.abs(step).max() < 2.0 * _REACH
        if near and norm < _DEEPER * here and all(np.abs(step - one).max() > _APART for _, one in found):
            found.append((norm, step))
    return [step for _, step in sorted(found, key=lambda one: one[0])[:most]]
