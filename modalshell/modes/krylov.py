"""Directions of GMRES, and the combination of them that comes nearest to a right side [saad1986]."""

from __future__ import annotations

from typing import final

import numpy as np

from modalshell.core.typing import Array


@final
class Krylov:
    """Orthonormal directions, the rows (most + 1, N), each of them the next one's image.

    The first one (N,) is the image of a solution, of any ``length`` but zero; ``most`` is the number of images at most.
    """

    def __init__(self, first: Array, length: float, most: int) -> None:
        self.directions = np.empty((most + 1, first.size))
        self.directions[0] = first / length
        self._seen = np.zeros((most + 1, most))

    def nearest(self, k: int, image: Array, size: float) -> tuple[Array, float]:
        """Shares (k + 1,) of the directions whose images come nearest to ``size`` of the first, and by how much not.

        ``image`` (N,) is that of direction k, and is overwritten. The gap is infinite where it is no number.
        """
        seen, known = self._seen, self.directions[: k + 1]
        for _ in range(2):  # twice is enough
            parts = known @ image
            image -= parts @ known
            seen[: k + 1, k] += parts
        seen[k + 1, k] = np.linalg.norm(image)
        goal = np.zeros(k + 2)
        goal[0] = size
        if not np.isfinite(seen[k + 1, k]):
            return goal[:-1], np.inf
        shares = np.asarray(np.linalg.lstsq(seen[: k + 2, : k + 1], goal, rcond=None)[0], dtype=np.float64)
        if seen[k + 1, k] > 0.0:
            self.directions[k + 1] = image / seen[k + 1, k]
        return shares, float(np.linalg.norm(seen[: k + 2, : k + 1] @ shares - goal))
