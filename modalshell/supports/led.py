"""Vertices that constraints lead, as full models hold them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import final

import numpy as np

from modalshell.core.typing import Array, Index
from modalshell.supports.constraints import Constraint, HeldPatch, PositionConstraint
from modalshell.supports.path import SupportPath

_TELL = 4
"""Vertices of a patch, far from one another, that tell where it is and how it has turned."""


@final
class LedVertices:
    """Where patches lead their vertices, in the frame of the supports.

    Attributes
    ----------
    patches : sequence of HeldPatch
        The patches.
    vertices : ndarray of int, shape (k,)
        Their vertices, one patch after the other.
    """

    def __init__(self, patches: Sequence[HeldPatch], path: SupportPath | None = None) -> None:
        self.patches, self._path = patches, path
        self.vertices: Index = np.concatenate([patch.vertices for patch in patches])
        self._told = [_far_apart(patch.at(0.0)) for patch in patches]

    def at(self, time: float) -> Array:
        """Positions (k, 3) [m] of the vertices at ``time`` [s]."""
        places = np.concatenate([patch.at(time) for patch in self.patches])
        return places if self._path is None else self._path.at(time).to_shell(places)

    def way(self, x: Array, places: Array, there: float) -> Array | None:
        """Displacements (n, 3) [m] from x (n, 3) to places (k, 3) [m]; None where they are put there.

        They are where none is longer than ``there`` [m].
        """
        way = np.zeros_like(x)
        way[self.vertices] = places - x[self.vertices]
        if np.abs(way).max() > there:
            return way
        x[self.vertices] = places
        return None

    def points(self) -> list[PositionConstraint]:
        """Constraints in the world on single vertices that hold the patches nearly as full models do."""
        return [
            PositionConstraint(patch.vertices[k], partial(_place, patch, k))
            for patch, told in zip(self.patches, self._told, strict=True)
            for k in told
        ]

    def still(self, time: float, *, every: bool = False) -> list[PositionConstraint]:
        """The same in the frame of the supports as they are at ``time`` [s], or on every vertex."""
        places, first = self.at(time), 0
        chosen: list[int] = []
        for patch, told in zip(self.patches, self._told, strict=True):
            chosen += range(first, first + patch.vertices.size) if every else [first + k for k in told]
            first += patch.vertices.size
        return [PositionConstraint(self.vertices[k], places[k]) for k in chosen]

    def missed(self, constraints: Sequence[Constraint], residuals: Array) -> Array:
        """What is left to each constraint's target (k,), [m] or [rad], from that of :meth:`points`."""
        place, of_patch = 0, {}
        for patch, told in zip(self.patches, self._told, strict=True):
            left = float(residuals[place : place + len(told)].max())
            places = patch.at(0.0)
            reach = float(np.linalg.norm(places - places.mean(axis=0), axis=1).max())
            of_patch[patch.position.vertices.tobytes()] = {"position": left, "orientation": left / max(reach, 1e-300)}
            place += len(told)
        return np.array([of_patch[one.vertices.tobytes()][one.kind] for one in constraints])


def _place(patch: HeldPatch, k: int, time: float) -> Array:
    return np.asarray(patch.at(time)[k])


def _far_apart(points: Array) -> list[int]:
    """Numbers of up to four of some points (k, 3): that farthest from their mean, then those farthest from these."""
    chosen: list[int] = []
    gaps = np.linalg.norm(points - points.mean(axis=0), axis=1)
    for _ in range(min(_TELL, len(points))):
        chosen.append(int(gaps.argmax()))
        away = np.linalg.norm(points - points[chosen[-1]], axis=1)
        gaps = away if len(chosen) == 1 else np.minimum(gaps, away)
    return chosen
