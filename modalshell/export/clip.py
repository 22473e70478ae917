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
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modalshell.core.checks import LARGEST, checked_folder, shortened
from modalshell.core.errors import FileFormatError
from modalshell.core.outcome import Outcome
from modalshell.core.units import UnitSystem
from modalshell.export.compression import CompressedMotion, compress
from modalshell.export.near_origin import demand_near_origin
from modalshell.files.atomic_io import read_npz, write_npz
from modalshell.motion import Trajectory

_UNITS = {"times": "s", "rest": "m", "scales": "m", "amplitudes": "", "shapes": "", "error": "m"}
"""Units of the arrays."""
_FORMAT = 1
"""Version of the file."""


def save_clip(run: Trajectory, path: Path) -> Path:
    """Write a trajectory as a clip; see :func:`modalshell.export.compression.compress`."""
    demand_near_origin(run.rest_positions, run.units.length, "clips")
    motion = compress(run)
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
        units=motion.units.array(_UNITS),
        unit_system=np.array(astuple(motion.units)),
    )


def read_clip(path: str | os.PathLike[str]) -> CompressedMotion:
    """The shapes and amplitudes of a clip.

    Raises
    ------
    FileFormatError
        If the file is missing, damaged, or not a clip.
    """
    file = checked_folder("path", path)
    try:
        data = read_npz(file)
        if int(data["modalshell_clip"]) != _FORMAT:
            raise ValueError(f"format {data['modalshell_clip']} (this version reads {_FORMAT})")
        _check_arrays(data)
        units = UnitSystem.from_array(data["unit_system"])
        if str(data["units"]) != str(units.array(_UNITS)):
            raise ValueError(f"units are not those of {units.length}, {units.mass}, {units.time}")
        times, rest, faces, shapes = (data[name] for name in ("times", "rest", "faces", "shapes"))
        scales, amplitudes = data["scales"], data["amplitudes"]
        return CompressedMotion(times, rest, faces, shapes, scales, amplitudes, float(data["error"]), units)
    except Exception as error:  # zip, OS, key, type and value errors all mean the same to the user
        raise FileFormatError(f"cannot read a clip from {file}: {shortened(str(error))}") from error


def _check_arrays(data: dict[str, NDArray[Any]]) -> None:
    """ValueError where an array of a clip has another type or shape than its format, or values that no motion has."""
    frames, vertices, shapes = (len(data[name]) for name in ("times", "rest", "scales"))
    expected = {
        "times": ("f", (frames,)),
        "rest": ("f", (vertices, 3)),
        "faces": ("iu", (len(data["faces"]), 3)),
        "shapes": ("i", (shapes, vertices, 3)),
        "scales": ("f", (shapes,)),
        "amplitudes": ("f", (frames, shapes)),
        "error": ("f", ()),
    }
    for name, (kinds, shape) in expected.items():
        array = data[name]
        if array.dtype.kind not in kinds or array.shape != shape or array.dtype.itemsize > 8:
            kind = "real" if kinds == "f" else "whole"
            raise ValueError(f"{name} must be {kind} numbers {shape} (got {array.dtype} {array.shape})")
        if kinds == "f" and not (np.abs(array.astype(np.float64)) <= LARGEST).all():
            raise ValueError(f"{name} must be finite numbers of at most {LARGEST:g}")
    if data["shapes"].dtype != np.int16:
        raise ValueError(f"shapes must be 16-bit whole numbers (got {data['shapes'].dtype})")
    if not frames or (np.diff(data["times"]) <= 0.0).any():
        raise ValueError("times must increase, and be at least one")
    if (data["scales"] <= 0.0).any() or data["error"] < 0.0:
        raise ValueError("scales must be above 0, and error at least 0")
    faces = data["faces"]
    if not faces.size or faces.min() < 0 or faces.max() >= vertices:
        raise ValueError(f"faces must name vertices 0 to {vertices - 1}, and be at least one")
    reach = np.abs(data["amplitudes"]).max(axis=0, initial=0.0).astype(float) * data["scales"].astype(float)
    if not (reach * np.iinfo(np.int16).max <= LARGEST).all():
        raise ValueError(f"displacements must be at most {LARGEST:g}")


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
