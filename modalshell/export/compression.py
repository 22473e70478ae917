"""Compression of a motion into a few shapes and amplitudes, by proper orthogonal decomposition of its frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from modalshell.core.checks import checked_number
from modalshell.core.errors import OptionError
from modalshell.core.thread_safety import ReadOnlyArrays, read_only_copy
from modalshell.core.typing import Array
from modalshell.core.units import SI, UnitSystem
from modalshell.motion import Trajectory

TOLERANCE = 2e-4
"""Largest error of a vertex in a frame, as a share of the shell's size, unless another is asked for."""
_OF_SMALL = 0.05
"""Largest error as a share of how far a vertex moves, of motions for which that is less than the tolerance."""
_FLOOR = 1e-7
"""Share of the shell's size that single precision keeps of positions."""
_LEVELS = 32767
"""Largest of the 16-bit whole numbers that the shapes are rounded to."""


@final
@dataclass(frozen=True)
class CompressedMotion(ReadOnlyArrays):
    """Frames ``rest + sum_k amplitudes[f, k] shapes[k]``, whatever model made them and however its supports moved."""

    times: Array
    """[s]; shape (F,)."""
    rest_positions: NDArray[np.float32]
    """[m]; shape (n, 3)."""
    faces: NDArray[np.uint32]
    """Triangles; shape (T, 3)."""
    shapes: NDArray[np.int16]
    """Displacements of the shapes in units of ``scales``; shape (K, n, 3)."""
    scales: Array
    """[m]; shape (K,)."""
    amplitudes: NDArray[np.float32]
    """Of the shapes in each frame; shape (F, K)."""
    error: float
    """Largest distance of a vertex from its place in the motion that was compressed [m]."""
    units: UnitSystem = SI
    """Units of the motion."""

    def __post_init__(self) -> None:
        for name in ("times", "rest_positions", "faces", "shapes", "scales", "amplitudes"):
            object.__setattr__(self, name, read_only_copy(getattr(self, name)))

    def displacements(self) -> Array:
        """The shapes (K, n, 3) [m]."""
        return self.shapes * self.scales[:, None, None]

    def positions(self) -> Array:
        """Positions (F, n, 3) [m] of all frames."""
        return self.rest_positions.astype(float) + np.tensordot(self.amplitudes.astype(float), self.displacements(), 1)


def compress(run: Trajectory, tolerance: float = TOLERANCE) -> CompressedMotion:
    """The fewest shapes that keep every vertex of every frame within ``tolerance`` times the shell's size.

    Of small motions they keep a vertex within a twentieth of the largest displacement.

    The shapes are the leading left singular vectors of the displacements [sirovich1987, method of snapshots], rounded
    to 16 bits. OptionError if the trajectory has no faces, or the tolerance is below what 16 bits keep.
    """
    tolerance = checked_number("tolerance", tolerance, at_least=1e-5, at_most=0.1)
    if len(run.faces) == 0:
        raise OptionError("a compressed motion needs the triangles: give the trajectory its faces (simulate does)")
    rest = run.rest_positions.astype(np.float32)
    frames = (run.positions - rest.astype(float)).reshape(len(run.times), -1)
    size = float(np.linalg.norm(np.ptp(run.rest_positions, axis=0)))
    moved = max(float(np.linalg.norm(frame - run.rest_positions, axis=1).max()) for frame in run.positions)
    allowed = max(min(tolerance * size, _OF_SMALL * moved), _FLOOR * size)
    values, vectors = scipy.linalg.eigh(frames @ frames.T)
    order = np.argsort(values)[::-1]
    order = order[values[order] > 1e-14 * max(values.max(), 1e-300)]
    count, shapes, scales, amplitudes = 0, *_rounded(frames, vectors[:, order[:0]])
    error = _error(frames, shapes, scales, amplitudes)
    while error > allowed:
        if count >= len(order):
            raise OptionError(
                f"16 bits keep {error / size:.1e} of the size (tolerance {allowed / size:.1e}): allow more"
            )
        count = min(max(count + 1, count + count // 8), len(order))
        shapes, scales, amplitudes = _rounded(frames, vectors[:, order[:count]])
        error = _error(frames, shapes, scales, amplitudes)
    faces = run.faces.astype(np.uint32)
    return CompressedMotion(
        run.times, rest, faces, shapes.reshape(count, *rest.shape), scales, amplitudes, error, run.units
    )


def _rounded(frames: Array, vectors: Array) -> tuple[NDArray[np.int16], Array, NDArray[np.float32]]:
    """Shapes (K, 3n) in 16 bits, their units (K,), and amplitudes (F, K) with which their sum is nearest to frames."""
    shapes = vectors.T @ frames
    scales = np.abs(shapes).max(axis=1, initial=0.0) / _LEVELS
    levels = np.rint(shapes / scales[:, None])
    fitted = np.linalg.solve(levels @ levels.T, levels @ frames.T).T / scales
    return levels.astype(np.int16), scales, fitted.astype(np.float32)


def _error(frames: Array, shapes: NDArray[np.int16], scales: Array, amplitudes: NDArray[np.float32]) -> float:
    """Largest distance of a vertex from its place [m]."""
    errors = frames - amplitudes.astype(float) @ (shapes * scales[:, None])
    return float(np.linalg.norm(errors.reshape(len(frames), -1, 3), axis=2).max())
