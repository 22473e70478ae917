"""Vertices that constraints lead, as full models hold them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np

from modalshell.core.typing import Array, Index
from modalshell.supports.constraints import HeldPatch
from modalshell.supports.path import SupportPath


@final
class LedVertices:
    """Where patches lead their vertices, in the frame of the supports.

    Attributes
    ----------
    vertices : ndarray of int, shape (k,)
        Vertices of the patches, one after the other.
    """

    def __init__(self, patches: Sequence[HeldPatch], path: SupportPath | None = None) -> None:
        self._patches, self._path = patches, path
        self.vertices: Index = np.concatenate([patch.vertices for patch in patches])

    def at(self, time: float) -> Array:
        """Positions (k, 3) [m] of the vertices at ``time`` [s]."""
        places = np.concatenate([patch.at(time) for patch in self._patches])
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
