"""Sheet of springs on a GPU, or by the same source on the processor (Warp)."""

from __future__ import annotations

from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from modalshell.kernels.device import checked_device, device_types, warp
from modalshell.springs.sheet_grid import SheetGrid
from modalshell.springs.verlet_sheet import VerletSheet, Which


@final
class DeviceVerlet(VerletSheet):
    """The steps of :class:`modalshell.springs.GridVerlet` on a device: one thread to a mass.

    A thread works out the 12 springs of its mass, so that a spring is worked out at both ends. The state stays on the
    device: positions and velocities are copied on request, and if ``dt`` changes. OptionError if Warp is not installed
    or the device is missing; for another precision, or dashpots. LoadError for positions or velocities of the wrong
    shape or not finite.

    Parameters
    ----------
    grid, dtype, start, velocity, allow_unstable_step
        As for :class:`modalshell.springs.GridVerlet`.
    device : str, optional
        "cpu", "cuda:0" and so on; by default the first GPU, or "cpu" if there is none.
    """

    def __init__(
        self,
        grid: SheetGrid,
        dtype: DTypeLike = np.float64,
        start: ArrayLike | None = None,
        device: str | None = None,
        *,
        velocity: ArrayLike | None = None,
        allow_unstable_step: bool = False,
    ) -> None:
        self.device = checked_device(device)
        self._warp = warp()
        self._states: dict[Which, Any] = {}
        super().__init__(grid, dtype, start, velocity, allow_unstable_step)
        self._pinned = self._warp.array(grid.pinned, dtype=self._warp.bool, device=self.device)

    def _read(self, which: Which) -> NDArray[Any]:
        return np.ascontiguousarray(np.moveaxis(self._states[which].numpy(), -1, 0))

    def _write(self, which: Which, places: NDArray[Any]) -> None:
        rows = np.ascontiguousarray(np.moveaxis(places, 0, -1))
        self._states[which] = self._warp.array(rows, dtype=device_types(self.dtype)[1], device=self.device)

    def _advance(self, count: int, dt: float) -> bool:
        launches = [self._launch("now", "before", dt), self._launch("before", "now", dt)]
        for turn in range(count):
            launches[turn % 2].launch()
        if count % 2:
            self._states = {"now": self._states["before"], "before": self._states["now"]}
        # The sum is taken on the device, and waits for the steps.
        total = self._warp.utils.array_sum(self._states["now"].flatten())
        return bool(np.isfinite(total).all())

    def _launch(self, now: Which, before: Which, dt: float) -> Any:
        """The recorded launch of a step from one state over the other."""
        from modalshell.springs.kernels.device_verlet import verlet_step

        grid, (real, vector) = self.grid, device_types(self.dtype)
        factor, keep, tiny = self._step_numbers(dt)
        springs = [stiffness * factor / grid.particle_mass for stiffness in (grid.structural, grid.shear, grid.flexion)]
        numbers = [real(number) for number in (grid.spacing, *springs, tiny, keep)]
        inputs = [self._states[now], self._states[before], self._pinned, *numbers, vector(*(factor * grid.gravity))]
        return self._warp.launch(verlet_step, grid.shape, inputs, device=self.device, record_cmd=True)
