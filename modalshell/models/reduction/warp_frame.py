"""Real-time frames of modal warping: positions from modal coordinates by a fused kernel on tiled data."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from modalshell.core.checks import checked_count, checked_kind, checked_output, checked_precision, shown
from modalshell.core.errors import OptionError
from modalshell.core.thread_safety import PerThread
from modalshell.kernels.frame import TILE, WORK, warp_frame, warp_frame_parallel
from modalshell.modes import Basis

_ALIGNMENT = 64
"""Bytes to which the data are aligned: a cache line."""
MOST_THREADS = 1024
"""Largest number of parts of a frame."""


class WarpFrame:
    """Warped positions ``rest_i + Rt(w_i) (Phi q)_i``, ``w = Psi q``, at one q after the other [choi2007, eq. 17].

    Holds its own copy of the modal data, tile by tile (:mod:`modalshell.kernels.frame`), and for each thread a buffer
    that a frame works in.

    Parameters
    ----------
    basis : Basis
        Modes and modal rotations of the shell.
    dtype : {float64, float32}
        Precision of the modal data, the arithmetic and the positions.
    threads : int
        Parts that a frame is cut into, each on a thread of numba's if there are as many. One thread calls a version
        compiled without threads.

    Raises
    ------
    OptionError
        If ``dtype`` or ``threads`` is invalid.

    Examples
    --------
    >>> frame = WarpFrame(basis, dtype=np.float32)  # doctest: +SKIP
    >>> out = np.empty((len(basis.shell.rest_positions), 3), np.float32)  # doctest: +SKIP
    >>> frame.positions(q, out)  # doctest: +SKIP
    """

    def __init__(self, basis: Basis, *, dtype: DTypeLike = np.float64, threads: int = 1) -> None:
        checked_kind("basis", basis, Basis)
        self.dtype = checked_precision(dtype)
        self.threads = checked_count("threads", threads, at_most=MOST_THREADS)
        self.count = basis.count
        points = basis.shell.rest_positions
        self.vertices = len(points)
        tiles = -(-self.vertices // TILE)
        self._modal = aligned_zeros((tiles, self.count, 6 * TILE), self.dtype)
        self._rest = aligned_zeros((tiles, 3 * TILE), self.dtype)
        modal, rest = self._modal.reshape(tiles, self.count, 6, TILE), self._rest.reshape(tiles, 3, TILE)
        modes, rotations = (a.reshape(-1, 3, self.count) for a in (basis.modes, basis.rotations))
        for tile in range(tiles):
            rows = slice(tile * TILE, min((tile + 1) * TILE, self.vertices))
            size = rows.stop - rows.start
            rest[tile, :, :size] = points[rows].T
            modal[tile, :, :3, :size] = modes[rows].transpose(2, 1, 0)
            modal[tile, :, 3:, :size] = rotations[rows].transpose(2, 1, 0)
        self._scratch = PerThread(partial(_scratch, self.count, self.threads, self.dtype))

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        for name in ("_modal", "_rest"):
            stored = state[name]
            aligned = self.__dict__[name] = aligned_zeros(stored.shape, stored.dtype)
            aligned[:] = stored

    @property
    def modal_data(self) -> NDArray[Any]:
        """Modal data in the order of reading (tiles, m, 6 * 128): rows of Phi and Psi, padded with zeros."""
        return self._modal

    @property
    def rest_data(self) -> NDArray[Any]:
        """Positions at rest in the same order (tiles, 3 * 128)."""
        return self._rest

    @property
    def bytes_read(self) -> int:
        """Bytes of modal data (padded to whole tiles) that a frame must read."""
        return self._modal.nbytes

    def positions(self, q: ArrayLike, out: NDArray[Any] | None = None) -> NDArray[Any]:
        """Warped positions (n, 3) [m] at modal coordinates ``q`` (m,).

        Parameters
        ----------
        q : array_like, shape (m,)
            Modal coordinates. They are not checked to be finite: positions are not where they are not.
        out : ndarray, shape (n, 3), optional
            C-ordered array of the frame's precision to write into; avoids an allocation.

        Returns
        -------
        ndarray, shape (n, 3)
            ``out``, or a new array.

        Raises
        ------
        OptionError
            If ``q`` or ``out`` is of the wrong shape or type.
        """
        own, work = self._scratch()
        try:
            coordinates = np.asarray(q)
            if fits := coordinates.shape == own.shape:
                np.copyto(own, coordinates, casting="same_kind")
        except (TypeError, ValueError) as fault:
            raise OptionError(f"q must be {self.count} real numbers (got {shown(q)}: {fault})") from fault
        if not fits:
            raise OptionError(f"q must have shape {own.shape}, one number per mode (got {coordinates.shape})")
        out = checked_output(out, (self.vertices, 3), self.dtype)
        run = warp_frame if self.threads == 1 else warp_frame_parallel
        run(self._modal, self._rest, own, work, out)
        return out


def _scratch(count: int, threads: int, dtype: np.dtype[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    return np.zeros(count, dtype), aligned_zeros((threads, WORK), dtype)


def aligned_zeros(shape: tuple[int, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Zeros that begin at a cache line, so that no packed read touches two."""
    size = int(np.prod(shape)) * dtype.itemsize
    raw = np.zeros(size + _ALIGNMENT, np.uint8)
    start = -raw.ctypes.data % _ALIGNMENT
    return raw[start : start + size].view(dtype).reshape(shape)
