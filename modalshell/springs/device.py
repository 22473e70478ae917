"""A sheet of masses and springs stepped on a GPU, or by the same source on the processor (Warp)."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from modalshell.checks import checked_count, checked_number, checked_vectors
from modalshell.errors import OptionError
from modalshell.springs.sheet_grid import SheetGrid


def warp() -> ModuleType:
    """The Warp library, started without its banner; OptionError where it is not installed."""
    try:
        import warp as library
    except ImportError as error:
        raise OptionError(f"devices need Warp: pip install 'modalshell[gpu]' ({error})") from error
    library.config.log_level = max(library.config.log_level, library.LOG_WARNING)
    library.init()
    return library


def devices() -> list[str]:
    """Names that :class:`DeviceVerlet` takes: "cpu", and "cuda:0" and so on for every GPU that is here."""
    return [device.alias for device in warp().get_devices()]


def checked_device(name: str | None) -> str:
    """Return ``name``, or for None the first GPU and else "cpu"; OptionError for what is not here."""
    known = devices()
    if name is None:
        return next((device for device in known if device.startswith("cuda")), "cpu")
    if name not in known:
        gpus = any(device.startswith("cuda") for device in known)
        fault = "there is no such device" if gpus or not str(name).startswith("cuda") else "no GPU is here"
        raise OptionError(f"{fault}: device must be one of {', '.join(known)} (got {name!r})")
    return name


class DeviceVerlet:
    """Explicit steps of a sheet whose state stays on a device: x(t + dt) = 2 x(t) - x(t - dt) + a(t) dt^2 (Verlet).

    The same steps as :class:`modalshell.springs.verlet.GridVerlet` takes, one thread of the device to a mass, each of
    which reads its 12 neighbours. Positions are copied from the device only when they are asked for.

    Parameters
    ----------
    grid : SheetGrid
        Masses and springs.
    dtype : numpy.float64 or numpy.float32
        Of the state and of the arithmetic.
    start : array_like, shape (rows * columns, 3), optional
        Places [m] from which the sheet starts at rest; without it the places at rest.
    device : str, optional
        "cpu" or "cuda:0" and so on; without it the first GPU, and where there is none "cpu".

    Raises
    ------
    OptionError
        Where Warp is not installed, the device is not here, or the dtype is another.
    LoadError
        For ``start`` of the wrong shape, or not finite.
    """

    def __init__(
        self,
        grid: SheetGrid,
        dtype: DTypeLike = np.float64,
        start: ArrayLike | None = None,
        device: str | None = None,
    ) -> None:
        self.grid = grid
        self.dtype = np.dtype(dtype)
        if self.dtype not in (np.float64, np.float32):
            raise OptionError(f"dtype must be float64 or float32 (got {self.dtype})")
        self.device = checked_device(device)
        self._warp = warp()
        self._real = self._warp.float64 if self.dtype == np.float64 else self._warp.float32
        self._vector = self._warp.types.vector(3, self._real)
        places = grid.rest_positions() if start is None else checked_vectors("start", start, (grid.count, 3))
        # Damped springs read the neighbours' last places, so that the new ones cannot be written over them.
        self._states = [self._array(places) for _ in range(3 if grid.spring_damping > 0.0 else 2)]
        self._pinned = self._warp.array(grid.pinned, dtype=self._warp.bool, device=self.device)
        self._taken = 0

    def _array(self, places: NDArray[np.float64]) -> Any:
        values = places.reshape(*self.grid.shape, 3).astype(self.dtype)
        return self._warp.array(values, dtype=self._vector, device=self.device)

    @property
    def positions(self) -> NDArray[Any]:
        """Positions [m], shape (rows * columns, 3), copied from the device."""
        latest = self._states[(self._taken + 1) % len(self._states)]
        return np.array(latest.numpy().reshape(-1, 3))

    def step(self, count: int, dt: float) -> None:
        """Take ``count`` steps of ``dt`` [s]."""
        count, dt = checked_count("count", count), checked_number("dt", dt, above=0.0, unit="s")
        launches = [self._launch(turn, dt) for turn in range(len(self._states))]
        for _ in range(count):
            launches[self._taken % len(launches)].launch()
            self._taken += 1
        self._warp.synchronize_device(self.device)

    def _launch(self, turn: int, dt: float) -> Any:
        """The recorded launch that reads the states ``turn`` and ``turn + 1`` and writes the next."""
        from modalshell.kernels.device_verlet import verlet_step

        grid, real = self.grid, self._real
        before, now, after = (self._states[(turn + k) % len(self._states)] for k in range(3))
        scale = dt**2 / grid.particle_mass
        numbers = [grid.spacing, scale * grid.structural, scale * grid.shear, scale * grid.flexion]
        numbers += [grid.spring_damping * dt / grid.particle_mass, 1.0 - grid.drag * dt]
        inputs = [before, now, after, self._pinned, *map(real, numbers), self._vector(*(dt**2 * grid.gravity))]
        return self._warp.launch(verlet_step, grid.shape, inputs, device=self.device, record_cmd=True)
