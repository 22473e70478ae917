"""How the vertices of a modal shell turn with its coordinates."""

from __future__ import annotations

from collections.abc import Callable
from typing import final

import numpy as np

from modalshell.core.typing import Array, Index

_NONE = np.empty((0, 3))


@final
class Turning:
    """Rotation vectors of vertices at coordinates (m,); what was asked for last is kept.

    Vertices turn with the modal ``rotations`` (3n, m), or not, or ``turns`` gives their rotation vectors (n, 3) [rad].
    ``spin`` (m, 3n) are the turns of all in each mode; (0, 3n) where they do not turn by these.
    """

    def __init__(self, turns: bool | Callable[[Array], Array], rotations: Array) -> None:
        self._turns, self.spin = turns, np.empty((0, len(rotations)))
        if turns is True:
            self.spin = np.ascontiguousarray(rotations.T)
        self._last: tuple[Array, Array] | None = None
        self._chosen = b"", np.empty((len(self.spin), 0))

    def vectors(self, q: Array) -> Array:
        """Rotation vectors (n, 3) [rad] of all vertices at q; (0, 3) where they do not turn."""
        if not self._turns:
            return _NONE
        last = self._last
        if last is not None and last[0] is q:
            return last[1]
        vectors = self._turns(q) if callable(self._turns) else np.asarray(q @ self.spin).reshape(-1, 3)
        self._last = q, vectors
        return vectors

    def unspun(self, q: Array) -> Array:
        """Rotation vectors (n, 3) of all vertices where these do not turn by :attr:`spin`, else (0, 3)."""
        return self.vectors(q) if callable(self._turns) else _NONE

    def of(self, q: Array, vertices: Index) -> Array:
        """Rotation vectors (k, 3) [rad] of some vertices; (0, 3) where they do not turn."""
        by_modes, vectors = self.parts(q, vertices)
        return np.asarray(q @ by_modes).reshape(-1, 3) if len(by_modes) else vectors

    def parts(self, q: Array, vertices: Index) -> tuple[Array, Array]:
        """Turns (m, 3k) of some vertices in each mode, whatever q; or, without modes, their vectors (k, 3) at q."""
        (known, by_modes), key = self._chosen, vertices.tobytes()
        if not len(self.spin):
            return by_modes, self.vectors(q)[vertices] if self._turns else _NONE
        if known != key:
            by_modes = self.spin.reshape(q.size, -1, 3)[:, vertices].reshape(q.size, 3 * vertices.size)
            self._chosen = key, by_modes
        return by_modes, _NONE
