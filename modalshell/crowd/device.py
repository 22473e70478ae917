"""Flocks and crowds on a GPU, or by the same source on the processor (Warp)."""

from __future__ import annotations

from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from modalshell.core.checks import checked_precision
from modalshell.core.typing import Array
from modalshell.crowd.free_instances import FreeInstances
from modalshell.crowd.kernels.flock import SUMS
from modalshell.crowd.neighbours import Neighbourhood, NeighbourSearch, sorted_cells, split_sums, view_cosine
from modalshell.crowd.shell_crowd import ShellCrowd
from modalshell.kernels.device import checked_device, device_types, warp
from modalshell.modes import Basis


@final
class DeviceSearch(NeighbourSearch):
    """Sums over neighbours on a device, one thread of it to a boid; for :class:`modalshell.Flock`.

    The processor sorts the boids into cells, in float64. So the boids go to the device at every step, and the sums come
    back. OptionError where Warp is not installed or the device is not here.

    Parameters
    ----------
    dtype : {float64, float32}
        Precision of the device's arithmetic. In float32 positions are rounded before they are compared: boids in one
        place to rounding are no neighbours.
    device : str, optional
        "cpu", "cuda:0" and so on; by default the first GPU, or "cpu" if there is none.
    """

    def __init__(self, dtype: DTypeLike = np.float64, device: str | None = None) -> None:
        self.dtype, self.device = checked_precision(dtype), checked_device(device)

    def gather(self, positions: Array, directions: Array, distance: float, field_of_view: float) -> Neighbourhood:
        """What the kernels of the processor sum, to rounding."""
        from modalshell.crowd.kernels.device_flock import gather_places

        library, (real, vector) = warp(), device_types(self.dtype)
        cells = sorted_cells(positions, distance)
        integers = [library.array(a, dtype=int, device=self.device) for a in cells[1:]]
        boids = [
            library.array(a[cells.order].astype(self.dtype), dtype=vector, device=self.device)
            for a in (positions, directions)
        ]
        numbers = real(distance), real(view_cosine(field_of_view))
        sums = library.empty((len(positions), SUMS), dtype=real, device=self.device)
        inputs = [cells.bits, *integers, *boids, *numbers, sums]
        library.launch(gather_places, len(positions), inputs, device=self.device)
        return split_sums(sums.numpy().astype(np.float64))


@final
class DeviceCrowd(ShellCrowd):
    """A :class:`modalshell.Crowd` whose positions and forces a device makes, a thread to each vertex of an instance.

    The modal data stay on the device; coordinates, levels and poses go there for every frame. Forces come back, in
    float64, to step the coordinates on the processor. An angle counts as it is rounded, so that forces differ from a
    crowd's by about 1e-16 for every radian of the largest angle. OptionError where Warp is not installed or the device
    is not here, and as a crowd does.

    Parameters
    ----------
    basis, count, damping
        As a crowd's.
    dtype : {float64, float32}
        Precision of the positions and of their arithmetic.
    device : str, optional
        "cpu", "cuda:0" and so on; by default the first GPU, or "cpu" if there is none.
    """

    def __init__(
        self,
        basis: Basis,
        count: int,
        *,
        damping: tuple[float, float] = (0.0, 0.0),
        dtype: DTypeLike = np.float64,
        device: str | None = None,
    ) -> None:
        self.device = checked_device(device)
        super().__init__(basis, count, damping, dtype)
        shapes = [a.reshape(-1, 3, basis.count).transpose(2, 0, 1) for a in (basis.modes, basis.rotations)]
        shapes.append(basis.shell.rest_positions)
        self._doubles = [self._numbers(a, np.float64, vectors=True) for a in shapes]
        self._singles = [] if self.dtype == np.float64 else [self._numbers(a, self.dtype, vectors=True) for a in shapes]
        self._masses = self._numbers(basis.shell.mass, np.float64)

    def device_positions(self, rotations: ArrayLike | None = None, translations: ArrayLike | None = None) -> Any:
        """Vertex positions as :meth:`positions` gives them, left on the device.

        Returns
        -------
        warp.array, shape (B, n)
            Vectors of three [m], of the crowd's precision. Work on the device may not have ended when this returns.
        """
        self._check_state()
        poses = self._poses(rotations, translations)
        if self.free is None:
            return self._launched(self.coordinates, self.levels, poses, self.dtype)
        return self._flown(self.free, poses)

    def _flown(self, free: FreeInstances, poses: tuple[Array, Array] | None) -> Any:
        """Positions on the device of instances whose parts are in their frames."""
        from modalshell.crowd.kernels.device_flock import part_means, place_parts

        library, count = warp(), len(free.parts)
        places = self._launched(free.frames.elastic(self.coordinates), self.levels, None, self.dtype)
        labels, shares = np.where(free.frames.labels < 0, count, free.frames.labels), np.zeros(self.vertices)
        for part in free.parts:
            shares[part.vertices] = part.mass / part.total
        numbers = library.array(labels, dtype=int, device=self.device)
        means = library.empty((self.count, count), dtype=device_types(self.dtype)[1], device=self.device)
        inputs = [numbers, self._numbers(shares, self.dtype), places, means]
        library.launch(part_means, means.shape, inputs, device=self.device)
        turns, moves = (self._numbers(a, self.dtype, vectors=True) for a in free.placed(self.coordinates, poses))
        library.launch(place_parts, places.shape, [numbers, means, turns, moves, places], device=self.device)
        return places

    def _fly(self, free: FreeInstances, poses: tuple[Array, Array] | None, out: NDArray[Any]) -> None:
        out[:] = self._flown(free, poses).numpy()

    def _numbers(self, values: NDArray[Any], dtype: DTypeLike, *, vectors: bool = False) -> Any:
        """Copy of an array on the device; of one (..., 3) as ``vectors``."""
        kind = device_types(dtype)[vectors]
        return warp().array(np.ascontiguousarray(values, dtype=dtype), dtype=kind, device=self.device)

    def _launched(
        self, coordinates: Array, levels: NDArray[np.int8], poses: tuple[Array, Array] | None, dtype: np.dtype[Any]
    ) -> Any:
        """Positions on the device, of a precision, without frames."""
        from modalshell.crowd.kernels.device_flock import crowd_positions

        library, shape = warp(), (len(coordinates), self.vertices)
        turns, moves = (np.tile(np.eye(3).ravel(), (shape[0], 1)), np.zeros((shape[0], 3))) if poses is None else poses
        out = library.empty(shape, dtype=device_types(dtype)[1], device=self.device)
        inputs = [
            library.array(levels, dtype=int, device=self.device),
            *(self._doubles if dtype == np.float64 else self._singles),
            self._numbers(coordinates, dtype),
            self._numbers(turns.reshape(-1, 3, 3), dtype, vectors=True),
            self._numbers(moves, dtype, vectors=True),
            out,
        ]
        library.launch(crowd_positions, shape, inputs, device=self.device)
        return out

    def _modal_forces(self, coordinates: Array, felt: Array, levels: NDArray[np.int8]) -> Array:
        from modalshell.crowd.kernels.device_flock import modal_forces, turned_back

        library, (real, vector) = warp(), device_types(np.float64)
        modes, rotations, _ = self._doubles
        forces = library.empty((len(coordinates), self.vertices), dtype=vector, device=self.device)
        inputs = [
            library.array(levels, dtype=int, device=self.device),
            rotations,
            self._masses,
            self._numbers(coordinates, np.float64),
            self._numbers(felt.reshape(len(felt), -1, 3), np.float64, vectors=True),
            forces,
        ]
        library.launch(turned_back, forces.shape, inputs, device=self.device)
        out = library.empty(coordinates.shape, dtype=real, device=self.device)
        library.launch(modal_forces, out.shape, [modes, forces, out], device=self.device)
        return np.array(out.numpy())

    def _reconstruct(
        self, coordinates: Array, levels: NDArray[np.int8], poses: tuple[Array, Array] | None, out: NDArray[Any]
    ) -> None:
        out[:] = self._launched(coordinates, levels, poses, out.dtype).numpy()
