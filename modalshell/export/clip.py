"""Clips: a motion as one small ``.clip`` file that NumPy alone reads.

A clip is an ``.npz`` archive (no pickle) of ``modalshell_clip`` (version), ``times`` (F,) [s], ``rest`` (n, 3) float32
[m], ``faces`` (T, 3) uint32, ``shapes`` (K, n, 3) int16, ``scales`` (K,) [m], ``amplitudes`` (F, K) float32,
``error`` [m], ``units`` (names with their units, JSON) and ``unit_system`` (of length, mass and time). Frame f is
``rest + sum_k amplitudes[f, k] scales[k] shapes[k]``; z is up.
"""

from __future__ import annotations

import os
from dataclasses import astuple
from pathlib import Path

import numpy as np

from modalshell.core.checks import shortened
from modalshell.core.errors import FileFormatError
from modalshell.core.outcome import Outcome
from modalshell.core.units import SI, UnitSystem
from modalshell.export.compression import TOLERANCE, CompressedMotion, compress
from modalshell.export.near_origin import demand_near_origin
from modalshell.files.atomic_io import read_npz, write_npz
from modalshell.motion import Trajectory

_UNITS = {"times": "s", "rest": "m", "scales": "m", "amplitudes": "", "shapes": "", "error": "m"}
"""Units of the arrays."""
_FORMAT = 1
"""Version of the file."""


def save_clip(run: Trajectory, path: Path, tolerance: float = TOLERANCE) -> Path:
    """Write a trajectory as a clip; see :func:`modalshell.export.compression.compress`."""
    demand_near_origin(run.rest_positions, run.units.length, "clips")
    motion = compress(run, tolerance)
    return write_npz(
        path,
        modalshell_clip=np.array(_FORMAT),
        times=motion.times,
        rest=motion.rest_positions,
        faces=motion.faces,
        shapes=motion.shapes,
        scales=motion.scales,
        amplitudes=motion.amplitudes,
        error=np.array(motion.error),
        units=motion.units.array(
            {"times": "s", "rest": "m", "scales": "m", "amplitudes": "", "shapes": "", "error": "m"}
        ),
        unit_system=np.array(astuple(motion.units)),
    )


def read_clip(path: str | os.PathLike[str]) -> CompressedMotion:
    """The shapes and amplitudes of a clip.

    Raises
    ------
    FileFormatError
        If the file is missing, damaged, or not a clip.
    """
    try:
        data = read_npz(path)
        if int(data["modalshell_clip"]) != _FORMAT:
            raise ValueError(f"format {data['modalshell_clip']} (this version reads {_FORMAT})")
        times, rest, faces, shapes = (data[name] for name in ("times", "rest", "faces", "shapes"))
        scales, amplitudes = data["scales"], data["amplitudes"]
        fits = shapes.shape == (scales.size, *rest.shape) and amplitudes.shape == (times.size, scales.size)
        if not fits or rest.shape[1:] != (3,) or faces.shape[1:] != (3,):
            raise ValueError("its arrays do not fit each other")
        if not all(np.isfinite(array).all() for array in (times, rest, scales, amplitudes)):
            raise ValueError("its numbers must be finite")
        if faces.size and faces.max() >= len(rest):
            raise ValueError(f"faces must name vertices 0 to {len(rest) - 1}")
        units = UnitSystem(*map(str, data["unit_system"])) if "unit_system" in data else SI  # not in earlier files
        return CompressedMotion(times, rest, faces, shapes, scales, amplitudes, float(data["error"]), units)
    except Exception as error:  # zip, OS, key, type and value errors all mean the same to the user
        raise FileFormatError(f"cannot read a clip from {Path(path)}: {shortened(str(error))}") from error


def load_clip(path: str | os.PathLike[str]) -> Trajectory:
    """Read a clip as a trajectory: its frames, without energies or residuals.

    Parameters
    ----------
    path : path
        The ``.clip`` file.

    Returns
    -------
    Trajectory
        The decompressed frames.

    Raises
    ------
    FileFormatError
        If the file is missing, damaged, or not a clip.
    """
    motion = read_clip(path)
    return Trajectory(
        times=motion.times,
        positions=motion.positions(),
        outcome=Outcome.COMPLETED,
        message=f"read from a clip, to {motion.error:.2e} {motion.units.length}",
        unconverged_steps=0,
        seconds=0.0,
        energies=np.zeros((len(motion.times), 3)),
        constraint_residuals=np.empty((len(motion.times), 0)),
        faces=motion.faces.astype(np.int64),
        rest_positions=motion.rest_positions.astype(float),
        units=motion.units,
    )
