"""Abstract base of rectangular sheets stepped by Verlet's method, on processor or GPU."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from modalshell.core.checks import checked_count, checked_kind, checked_number, checked_precision, checked_vectors
from modalshell.core.errors import OptionError, SolverError
from modalshell.core.typing import Array
from modalshell.shell.elements import ElementSum
from modalshell.springs.sheet_grid import SheetGrid

Which = Literal["now", "before"]


class VerletSheet(ABC):
    """A :class:`SheetGrid` in motion: its positions now and one step earlier, (3, rows, columns) each.

    The parameters are those of :class:`modalshell.springs.GridVerlet`.
    """

    def __init__(
        self,
        grid: SheetGrid,
        dtype: DTypeLike,
        start: ArrayLike | None,
        velocity: ArrayLike | None,
        allow_unstable_step: bool,
    ) -> None:
        self.grid = checked_kind("grid", grid, SheetGrid)
        self.dtype = checked_precision(dtype)
        if grid.spring_damping > 0.0:
            raise OptionError(
                f"the grid's Verlet steps know drag, but no dashpots (got spring_damping={grid.spring_damping:g} "
                "N s/m): set it to 0, or step SpringSheet(..., integrator='verlet')"
            )
        self.allow_unstable_step = allow_unstable_step
        self.count = 0
        first = grid.rest_positions() if start is None else checked_vectors("start", start, (grid.count, 3))
        rates = np.zeros_like(first) if velocity is None else checked_vectors("velocity", velocity, first.shape)
        self._write("now", self._on_grid(first))
        self._write("before", self._on_grid(np.zeros_like(first)))
        self._rates = np.where(grid.pinned.ravel()[:, None], 0.0, rates)
        self._dt = 0.0
        self._springs = ElementSum([grid.springs().element_set()], grid.count)

    @abstractmethod
    def _read(self, which: Which) -> NDArray[Any]:
        """Positions (3, rows, columns), not to be written to."""

    @abstractmethod
    def _write(self, which: Which, places: NDArray[Any]) -> None:
        """Put positions (3, rows, columns) into the state."""

    @abstractmethod
    def _advance(self, count: int, dt: float) -> bool:
        """Take steps; return whether the positions after them are finite."""

    def _on_grid(self, vectors: Array) -> NDArray[Any]:
        return np.ascontiguousarray(vectors.T.reshape(3, *self.grid.shape), dtype=self.dtype)

    @property
    def positions(self) -> NDArray[Any]:
        """Where the masses are (rows * columns, 3) [m]."""
        return np.ascontiguousarray(self._read("now").reshape(3, -1).T)

    @property
    def velocities(self) -> Array:
        """Velocities (rows * columns, 3) [m/s] at the time of the positions: the mean of the steps before and after."""
        if self._dt == 0.0:
            return self._rates.copy()
        last = (self._read("now").astype(np.float64) - self._read("before")).reshape(3, -1).T / self._dt
        mean = (last + 0.5 * self._dt * self._acceleration()) / (1.0 + 0.5 * self._dt * self.grid.drag)
        return np.where(self.grid.pinned.ravel()[:, None], 0.0, mean)

    def _acceleration(self) -> Array:
        """Of springs and gravity (rows * columns, 3) [m/s^2]."""
        _, gradient = self._springs.energy_gradient(self.positions.astype(np.float64))
        return np.asarray(self.grid.gravity - gradient / self.grid.particle_mass)

    def _set_step(self, dt: float) -> None:
        """Set the positions of one step of ``dt`` earlier such that the velocities are unchanged."""
        rates = self.velocities
        pull = np.where(self.grid.pinned.ravel()[:, None], 0.0, self._acceleration() - self.grid.drag * rates)
        self._write("before", self._read("now") - self._on_grid(dt * rates - 0.5 * dt**2 * pull))
        self._dt = dt

    def _step_numbers(self, dt: float) -> tuple[float, float, float]:
        """What a force over the mass moves in a step, the part of the velocity that drag leaves, and a tiny square."""
        half_drag = 0.5 * dt * self.grid.drag
        return dt**2 / (1.0 + half_drag), (1.0 - half_drag) / (1.0 + half_drag), self.grid.tiny

    def step(self, count: int, dt: float) -> None:
        """Take ``count`` steps of ``dt`` [s]; if ``dt`` changes, the velocities are kept.

        Raises
        ------
        OptionError
            For a step above the stable one, unless ``allow_unstable_step``.
        SolverError
            If the masses have left the finite numbers.
        """
        count, dt = checked_count("count", count), checked_number("dt", dt, above=0.0, unit="s")
        if dt != self._dt:
            longest = self.grid.stable_step()
            if not self.allow_unstable_step and dt > longest:
                raise OptionError(
                    f"Verlet needs a step of at most {longest:.3g} s on this sheet (got {dt:.3g} s): "
                    "shorten the step, step ImplicitSprings, or pass allow_unstable_step=True"
                )
            self._set_step(dt)
        finite = self._advance(count, dt)
        self.count += count
        if not finite:
            raise SolverError(
                f"the sheet left the finite numbers within {self.count} steps of {dt:.3g} s; about its rest shape "
                f"steps are stable up to {self.grid.stable_step():.3g} s, less where springs are stretched far"
            )
