"""The Verlet step of a sheet of springs in plain NumPy: what the compiled kernels are timed and checked against.

Written as a careful user of NumPy would: coordinates in planes, each spring once for both its ends, every array made
beforehand and every operation in place.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import DTypeLike, NDArray

from modalshell.springs.sheet_grid import FAMILIES, SheetGrid


class NumpyVerlet:
    """The steps of :class:`modalshell.springs.GridVerlet` of one length, from rest, in NumPy.

    Attributes
    ----------
    now, before : ndarray, shape (3, rows, columns)
        Positions [m] at the last two times.
    """

    def __init__(
        self, grid: SheetGrid, dtype: DTypeLike = np.float64, start: NDArray[np.float64] | None = None
    ) -> None:
        rows, columns = grid.shape
        places = grid.rest_positions() if start is None else start
        self.grid = grid
        self.now = np.ascontiguousarray(places.T, dtype).reshape(3, rows, columns)
        self.before = self.now.copy()
        self._sum = np.empty_like(self.now)
        self._offset = np.empty_like(self.now)
        self._squared = np.empty_like(self.now)
        self._length = np.empty((rows, columns), dtype)
        self._free = (~grid.pinned).astype(dtype)
        self._resting = True

    @property
    def positions(self) -> NDArray[np.float64]:
        """Positions (rows * columns, 3) [m]."""
        return self.now.reshape(3, -1).T.astype(np.float64)

    def step(self, count: int, dt: float) -> None:
        """Take ``count`` steps of ``dt`` [s]."""
        grid, kind = self.grid, self.now.dtype.type
        half_drag = 0.5 * dt * grid.drag
        factor = dt**2 / (1.0 + half_drag)
        keep = kind((1.0 - half_drag) / (1.0 + half_drag))
        fall = [kind(value * factor) for value in grid.gravity]
        rows, columns = grid.shape
        for _ in range(count):
            # The sum is what the step adds: drag and inertia, gravity, springs.
            np.subtract(self.now, self.before, out=self._sum)
            self._sum *= keep
            for plane, value in zip(self._sum, fall, strict=True):
                if value != 0.0:
                    plane += value
            for family, offsets in FAMILIES.items():
                stiffness = kind(getattr(grid, family) * factor / grid.particle_mass)
                for down, right in offsets:
                    first = (slice(0, rows - down), slice(max(0, -right), columns - max(0, right)))
                    second = (slice(down, rows), slice(max(0, right), columns - max(0, -right)))
                    box = (slice(0, rows - down), slice(0, columns - abs(right)))
                    offset, squared = self._offset[:, *box], self._squared[:, *box]
                    length = self._length[box]
                    np.subtract(self.now[:, *second], self.now[:, *first], out=offset)
                    np.multiply(offset, offset, out=squared)
                    np.add(squared[0], squared[1], out=length)
                    length += squared[2]
                    np.sqrt(length, out=length)
                    np.divide(kind(-stiffness * kind(grid.spacing * np.hypot(down, right))), length, out=length)
                    length += stiffness
                    offset *= length
                    self._sum[:, *first] += offset
                    self._sum[:, *second] -= offset
            self._sum *= self._free
            if self._resting:
                # From rest the first step is half the acceleration's, without drag.
                self._sum *= kind(0.5 * (1.0 + half_drag))
                self._resting = False
            np.add(self.now, self._sum, out=self.before)
            self.now, self.before = self.before, self.now
