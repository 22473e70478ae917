"""The rectangular sheet of masses and springs in motion by Verlet's method, fast and in parallel."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from modalshell.checks import checked_count, checked_kind, checked_number, checked_precision, checked_vectors
from modalshell.errors import OptionError, SolverError
from modalshell.kernels.spring_grid import WORK, verlet_steps
from modalshell.shell.elements import energy_gradient
from modalshell.springs.sheet_grid import SheetGrid
from modalshell.springs.threads import ThreadChoice
from modalshell.typing import Array

_EACH = 8000
"""Masses for which a thread pays."""
_COINCIDENT = 1e-12
"""Distance of two masses over the spacing, far below which the force between them is none."""


class GridVerlet:
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
    start, velocity : array_like, shape (rows * columns, 3), optional
        Positions [m], at rest without them, and velocities [m/s], none without them. Pinned masses stay put.
    threads : int, optional
        So many; one or all of numba's without it, as its own steps show to be faster. The results do not depend on it.
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
    >>> sheet = GridVerlet(grid, dtype=np.float32)  # doctest: +SKIP
    >>> sheet.step(100, 1e-4)  # doctest: +SKIP
    >>> sheet.positions  # doctest: +SKIP
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
        self.grid = checked_kind("grid", grid, SheetGrid)
        self.dtype = checked_precision(dtype)
        if grid.spring_damping > 0.0:
            raise OptionError(
                f"the grid's Verlet steps know drag, but no dashpots (got spring_damping={grid.spring_damping:g} "
                "N s/m): set it to 0, or step SpringSheet(..., integrator='verlet')"
            )
        self.allow_unstable_step = allow_unstable_step
        self.threads = ThreadChoice(grid.count, _EACH, threads)
        self.count = 0
        first = grid.rest_positions() if start is None else checked_vectors("start", start, (grid.count, 3))
        rates = np.zeros_like(first) if velocity is None else checked_vectors("velocity", velocity, first.shape)
        self._now = self._on_grid(first)
        self._before = np.empty_like(self._now)
        self._rates = np.where(grid.pinned.ravel()[:, None], 0.0, rates)
        self._dt = 0.0
        rows, columns = np.nonzero(grid.pinned)
        self._pins = np.searchsorted(rows, np.arange(grid.shape[0] + 1)), columns
        self._work = np.zeros((self.threads.most, WORK), self.dtype)
        self._springs = grid.springs().element_set()

    def _on_grid(self, vectors: Array) -> NDArray[Any]:
        return np.ascontiguousarray(vectors.T.reshape(3, *self.grid.shape), dtype=self.dtype)

    @property
    def positions(self) -> NDArray[Any]:
        """Where the masses are (rows * columns, 3) [m]."""
        return np.ascontiguousarray(self._now.reshape(3, -1).T)

    @property
    def velocities(self) -> Array:
        """Velocities (rows * columns, 3) [m/s] at the time of the positions: the mean of the steps before and after."""
        if self._dt == 0.0:
            return self._rates.copy()
        last = (self._now.astype(np.float64) - self._before).reshape(3, -1).T / self._dt
        mean = (last + 0.5 * self._dt * self._acceleration()) / (1.0 + 0.5 * self._dt * self.grid.drag)
        return np.where(self.grid.pinned.ravel()[:, None], 0.0, mean)

    def _acceleration(self) -> Array:
        """Of springs and gravity (rows * columns, 3) [m/s^2]."""
        _, gradient = energy_gradient([self._springs], self.positions.astype(np.float64))
        return self.grid.gravity - gradient / self.grid.particle_mass

    def _set_step(self, dt: float) -> None:
        """Choose the positions a step of ``dt`` ago so that the velocities stay what they are."""
        rates = self.velocities
        pull = np.where(self.grid.pinned.ravel()[:, None], 0.0, self._acceleration() - self.grid.drag * rates)
        self._before = self._now - self._on_grid(dt * rates - 0.5 * dt**2 * pull)
        self._dt = dt

    def _prepare(self, count: int, dt: float) -> tuple[int, float]:
        """Check the steps asked for, and get the state ready for those of another length than before."""
        count, dt = checked_count("count", count), checked_number("dt", dt, above=0.0, unit="s")
        if dt != self._dt:
            longest = self.grid.stable_step()
            if not self.allow_unstable_step and dt > longest:
                raise OptionError(
                    f"Verlet needs a step of at most {longest:.3g} s on this sheet (got {dt:.3g} s): "
                    "shorten the step, step ImplicitSprings, or pass allow_unstable_step=True"
                )
            self._set_step(dt)
        return count, dt

    def _step_numbers(self, dt: float) -> tuple[float, float, float]:
        """What a force over the mass moves in a step, the part of the velocity that drag leaves, and a tiny square."""
        half_drag = 0.5 * dt * self.grid.drag
        return dt**2 / (1.0 + half_drag), (1.0 - half_drag) / (1.0 + half_drag), (_COINCIDENT * self.grid.spacing) ** 2

    def _finish(self, count: int, dt: float, finite: bool) -> None:
        """Count the steps taken, or refuse them."""
        self.count += count
        if not finite:
            raise SolverError(
                f"the sheet left the finite numbers within {self.count} steps of {dt:.3g} s; about its rest shape "
                f"steps are stable up to {self.grid.stable_step():.3g} s, less where springs are stretched far"
            )

    def step(self, count: int, dt: float) -> None:
        """Take ``count`` steps of ``dt`` [s]; another ``dt`` than before goes on from the same velocities.

        Raises
        ------
        OptionError
            For a step above the stable one, unless ``allow_unstable_step``.
        SolverError
            If the masses have left the finite numbers.
        """
        count, dt = self._prepare(count, dt)
        grid, (factor, keep, tiny) = self.grid, self._step_numbers(dt)
        lengths = grid.spacing * np.array([1.0, np.sqrt(2.0), 2.0])
        stiffness = np.array([grid.structural, grid.shear, grid.flexion]) * factor / grid.particle_mass
        pairs = np.column_stack([stiffness, stiffness * lengths])
        coefficients = tuple(pairs.ravel().astype(self.dtype))
        keep, tiny = np.array([keep, tiny], self.dtype)
        left = count
        while left:
            now = min(left, self.threads.steps_left)
            with self.threads.steps(now) as threads:
                verlet_steps(
                    now,
                    self._now,
                    self._before,
                    coefficients,
                    (grid.gravity * factor).astype(self.dtype),
                    keep,
                    tiny,
                    *self._pins,
                    self._work[:threads],
                )
            if now % 2:
                self._now, self._before = self._before, self._now
            left -= now
        with np.errstate(over="ignore", invalid="ignore"):
            finite = bool(np.isfinite(self._now.sum()))
        self._finish(count, dt, finite)
