"""States of a modal rung that checks have found right, and when the next check is due.

The bar of a modal rung under d'Alembert's load is a function of what its equations take: its coordinates, their rates
and the load. A check that leaves room below what the error may be so vouches for states some way further than its own;
one that leaves little, for states like its own; and one that leaves less takes away what is as large, so that smaller
states stay known. Errors of a warp are taken to grow with the third power of the state, so that their shares of its
displacement grow with the square, as stresses do: of 103 answers of drawn plates, arches, hypars and twisted strips
shares grew with a power of 0.8 to 1.8, of 1.0 in the median.
What is vouched for is an ellipsoid about rest, which grows by states checked, each times a factor that its bar and its
margin leave; and in every component no more than the least and the largest of those: an ellipsoid about two points of a
plane goes beyond both, and a fold that is right bent one way may be wrong bent the other. What modes lack of a load is
looked at apart.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence
from typing import NamedTuple, final

import numpy as np

from modalshell.core.typing import Array
from modalshell.statics.error_bar import LEAST_MARGIN

EVERY = 5
"""Steps from one check to the next where states are new."""
SELDOM, RARER = 8 * EVERY, 2.0
"""Steps after which a known state is checked all the same, and the factor on that each time it holds."""
_WIDEST = 2.0
"""Factor by which the state of a check may grow at most."""
ROOMY = 1.25
"""Such a factor of a check from which it vouches for larger states, too."""
SPACIOUS = 1.5
"""Such a factor from which a known state that is checked all the same is checked rarer still: by that factor twice."""
TIGHT = 1.06
"""Such a factor from which it vouches for states like its own: what is nearly wrong is looked at each time. The noise
lets errors grow by half, and a rung is left at half of what they may be."""
_NOISE, _FASTER = 0.1, 4.0
"""What any component of a known state may have, a share of the largest displacement or of a load's largest factor that
was checked; and that of a rate, over it, as what it does grows with its square."""
_LEAST = 1e-9
"""Such a share of a load that has not acted yet."""
_TINY = 1e-100
"""Displacement [kg^(1/2) m] up to which nothing is known: inverses of its square overflow."""
_THIN = 1e-3
"""Width of an ellipsoid, in noise, in directions of which no check has seen anything."""
_SUDDEN = 1.5
"""Factor of a load on what checks have seen of it, from which it is checked at once."""


def room(bar: float, margin: float, allowed: float, moved: float | None = None) -> float:
    """Factor by which a state may grow until a bar and what stresses take are as large as they may be.

    The bar is a share of the largest displacement, ``moved`` that of the state of a motion. Without that the state is
    one of rest, which is to vouch for vibrations that no check has seen: its errors are taken to grow faster.
    """
    taken = max(1.0 - margin, 0.0)
    wide = bar <= _WIDEST**-4 * allowed, _WIDEST**2 * taken <= 1.0 - LEAST_MARGIN
    if wide[0]:
        by_bar = _WIDEST
    elif moved is None:
        by_bar = (allowed / bar) ** 0.25
    else:
        by_bar = (allowed / bar) ** (1.0 / 3.0)
        if by_bar * moved > 1.0:  # the largest displacement grows with the state
            by_bar = (allowed * moved / bar) ** 0.5
        by_bar = min(by_bar, _WIDEST)
    by_margin = _WIDEST if wide[1] else ((1.0 - LEAST_MARGIN) / taken) ** 0.5
    return min(by_bar, by_margin)


class _Looked(NamedTuple):
    """What is known, whether anything is, bounds of components, loads that are sudden, and the inverse (k, k)."""

    known: Array
    any: bool
    lowest: list[float]
    highest: list[float]
    loads: list[float]
    inverse: Array


@final
class KnownStates:
    """The states z (k,) in the ellipsoid ``z . A^-1 z <= 1`` that no component of is too large.

    A state is made of coordinates and rates, both [kg^(1/2) m], and, last, some ``factors`` of loads. What is known are
    rows (2k + 3, k): the matrix A, the inverse by which it is looked up, the least and the largest components checked,
    not above and below rest, and the noise that they may have beyond.
    """

    def __init__(self, factors: int) -> None:
        self._factors = factors
        self._kept: _Looked | None = None

    @staticmethod
    def nothing(size: int) -> Array:
        """What is known where nothing is."""
        return np.zeros((2 * size + 3, size))

    def grown(self, known: Array, z: Array, wider: float, largest: float) -> Array:
        """The same with ``wider`` times a state in it; ``largest`` is the largest displacement."""
        return self._with(known, (wider * z,), largest)

    def swinging(self, known: Array, z: Array, wider: float, largest: float) -> Array:
        """The same with ``wider`` times a state of rest in it, and what is on the way there or about it.

        Those are its load on the shape at rest, which it has not bent yet, and its coordinates as rates, either way: of
        a vibration as large, as what rates do to a shape grows with their square as what coordinates do does.
        """
        modes = (z.size - self._factors) // 2
        loaded, rates = np.zeros_like(z), np.zeros_like(z)
        loaded[2 * modes :], rates[modes : 2 * modes] = z[2 * modes :], z[:modes]
        return self._with(known, [wider * point for point in (z, loaded, rates, -rates)], largest)

    def _with(self, known: Array, points: Sequence[Array], largest: float) -> Array:
        """The same with some points (k,) in it, one after the other."""
        size, modes = known.shape[1], (known.shape[1] - self._factors) // 2
        matrix, (least, most, noise) = known[:size], known[-3:]
        for point in points:
            low, high = np.minimum(least, point), np.maximum(most, point)
            wide = np.maximum(_NOISE * (high - low), _LEAST)
            wide[: 2 * modes] = _NOISE * largest
            wide[modes : 2 * modes] *= _FASTER
            if not wide.min() > _TINY:
                continue
            least, most, noise = low, high, wide
            beyond = float(point @ np.linalg.solve(matrix + np.diag((_THIN * noise) ** 2), point))
            if beyond > 1.0:
                matrix = matrix + (1.0 - 1.0 / beyond) * np.outer(point, point)
        if not noise.min() > _TINY:  # nothing is known yet, nor from these
            return known
        return np.vstack([matrix, np.linalg.inv(matrix + np.diag(noise**2)), least, most, noise])

    def shrunk(self, known: Array, z: Array, wider: float) -> Array:
        """The same without a state, of little room: all smaller, by as much as leaves that just out of it.

        Factors as large as its own have been seen then, and are not sudden.
        """
        size, first, point = z.size, z.size - self._factors, wider / TIGHT * z
        rows = np.ones((len(known), size))
        if self.holds(known, point):
            least, most, noise = known[-3:, :first]
            along = point[:first]
            widest = max(0.0, *(along / np.where(along < 0.0, least - noise, most + noise)).tolist())
            share = max(float(point @ known[size : 2 * size] @ point), widest**2)
            if not share > _TINY:
                return self.nothing(size)
            rows[:size], rows[size : 2 * size], rows[2 * size :, :first] = share, 1.0 / share, math.sqrt(share)
        known = rows * known
        if known[-1, 0] > 0.0:
            known[-3, first:] = np.minimum(known[-3, first:], z[first:])
            known[-2, first:] = np.maximum(known[-2, first:], z[first:])
        return known

    def holds(self, known: Array, z: Array) -> bool:
        """Whether a state is known, or near to that by the noise of the last check."""
        kept = self._looked_up(known)
        if not kept.any:
            return False
        parts = z.tolist()  # of some twenty numbers lists are quicker than arrays; NaN is beyond both
        if not (all(map(operator.le, kept.lowest, parts)) and all(map(operator.le, parts, kept.highest))):
            return False
        return bool(z.dot(kept.inverse.dot(z)) <= 1.0)

    def is_sudden(self, known: Array, factors: list[float]) -> bool:
        """Whether loads have grown far beyond what checks have seen."""
        kept = self._looked_up(known)
        return kept.any and any(map(operator.gt, map(abs, factors), kept.loads))

    def _looked_up(self, known: Array) -> _Looked:
        """What the last question was about, kept: arrays of what is known are replaced, never written into."""
        kept = self._kept
        if kept is None or kept.known is not known:
            least, most, noise = known[-3:]
            size, first = known.shape[1], known.shape[1] - self._factors
            loads = _SUDDEN * np.maximum(most[first:], -least[first:])
            lowest, highest = (least - noise).tolist(), (most + noise).tolist()
            inverse = known[size : 2 * size]
            kept = self._kept = _Looked(known, bool(noise[0] > 0.0), lowest, highest, loads.tolist(), inverse)
        return kept
