"""Rectangular sheet of springs in motion by Verlet's method, in parallel."""

from __future__ import annotations

from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from modalshell.springs.kernels.grid import WORK, verlet_steps
from modalshell.springs.sheet_grid import SheetGrid
from modalshell.springs.threads import ThreadChoice
from modalshell.springs.verlet_sheet import VerletSheet, Which

_EACH = 8000
"""Masses for which a thread pays."""


@final
class GridVerlet(VerletSheet):
    r"""A :class:`SheetGrid` stepped by Verlet's method, second order in dt, drag taken at mid-step.

    .. math:: x_{n+1} = x_n + \frac{1 - c h / 2}{1 + c h / 2} (x_n - x_{n-1})
              + \frac{h^2}{1 + c h / 2} (f(x_n) / m + g)

    The state lives here as two arrays (3, rows, columns) that change places; a step copies neither. Symplectic without
    drag, and stable below :meth:`SheetGrid.stable_step` whatever the drag.

    Parameters
    ----------
    grid : SheetGrid
        The sheet; without dashpots.
    dtype : {float64, float32}
        Precision of the state and the arithmetic.
    start : array_like, shape (rows * columns, 3), optional
        Positions [m]; by default at rest.
    threads : int, optional
        Number of threads; by default one or all of numba's, whichever is faster. The results do not depend on it.
    velocity : array_like, shape (rows * columns, 3), optional
        Velocities [m/s]; by default zero. Pinned masses do not move.
    allow_unstable_step : bool
        Whether steps may be longer than the stable one.

    Raises
    ------
    OptionError
        For another precision, threads that are no positive integer, or a sheet with dashpots on its springs.
    LoadError
        For positions or velocities of the wrong shape or not finite.

    Examples
    --------
    >>> from modalshell.springs import GridVerlet, SheetGrid
    >>> grid = SheetGrid(shape=(8, 8), spacing=0.1, particle_mass=0.01, structural=50.0, shear=20.0, flexion=8.0)
    >>> sheet = GridVerlet(grid, threads=1)
    >>> sheet.step(100, 1e-4)
    >>> sheet.positions.shape
    (64, 3)
    """

    def __init__(
        self,
        grid: SheetGrid,
        dtype: DTypeLike = np.float64,
        start: ArrayLike | None = None,
        threads: int | None = None,
        *,
        velocity: ArrayLike | None = None,
        allow_unstable_step: bool = False,
    ) -> None:
        self._states: dict[Which, NDArray[Any]] = {}
        super().__init__(grid, dtype, start, velocity, allow_unstable_step)
        self.threads = ThreadChoice(grid.count, _EACH, threads)
        rows, columns = np.nonzero(grid.pinned)
        self._pins = np.searchsorted(rows, np.arange(grid.shape[0] + 1)), np.ascontiguousarray(columns)
        self._work = np.zeros((self.threads.most, WORK), self.dtype)

    def _read(self, which: Which) -> NDArray[Any]:
        return self._states[which]

    def _write(self, which: Which, places: NDArray[Any]) -> None:
        self._states[which] = places

    def _advance(self, count: int, dt: float) -> bool:
        grid, (factor, keep, tiny) = self.grid, self._step_numbers(dt)
        lengths = grid.spacing * np.array([1.0, np.sqrt(2.0), 2.0])
        stiffness = np.array([grid.structural, grid.shear, grid.flexion]) * factor / grid.particle_mass
        pairs = np.column_stack([stiffness, stiffness * lengths])
        coefficients = tuple(pairs.ravel().astype(self.dtype))
        numbers = (grid.gravity * factor).astype(self.dtype), *np.array([keep, tiny], self.dtype), *self._pins
        left = count
        while left:
            now = min(left, self.threads.steps_left)
            with self.threads.steps(now) as threads:
                states = self._states["now"], self._states["before"]
                verlet_steps(now, *states, coefficients, *numbers, self._work[:threads])
            if now % 2:
                self._states = {"now": self._states["before"], "before": self._states["now"]}
            left -= now
        with np.errstate(over="ignore", invalid="ignore"):
            return bool(np.isfinite(self._states["now"].sum()))
