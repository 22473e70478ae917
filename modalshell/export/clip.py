"""Clips: a motion as one small ``.clip`` file that NumPy alone reads.

A clip is an ``.npz`` archive (no pickle) of ``modalshell_clip`` (version), ``times`` (F,) [s], ``rest`` (n, 3) float32
[m], ``faces`` (T, 3) uint32, ``shapes`` (K, n, 3) int16, ``scales`` (K,) [m], ``amplitudes`` (F, K) float32,
``error`` [m], ``units`` (names with their units, JSON) and ``unit_system`` (of length, mass and time). Frame f is
``rest + sum_k amplitudes[f, k] scales[k] shapes[k]``; z is up.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modalshell.core.checks import LARGEST
from modalshell.core.outcome import Outcome
from modalshell.core.units import UnitSystem
from modalshell.export.compression import CompressedMotion, compress
from modalshell.export.near_origin import demand_near_origin
from modalshell.files.archive import UNITS, Archive, Field
from modalshell.files.atomic_io import write_npz
from modalshell.motion import Trajectory

_NAMES = {"rest": "rest_positions"}
"""Attributes of a motion that are named otherwise in the file."""
_CLIP = Archive(
    "a clip",
    "modalshell_clip",
    {
        "times": Field("f", ("F",), "s"),
        "rest": Field("f", ("n", 3), "m"),
        "faces": Field("iu", ("T", 3)),
        "scales": Field("f", ("K",), "m"),
        "shapes": Field("iu", ("K", "n", 3), ""),
        "amplitudes": Field("f", ("F", "K"), ""),
        "error": Field("f", (), "m"),
    },
    most=LARGEST,
)


def save_clip(run: Trajectory, path: Path) -> Path:
    """Write a trajectory as a clip; see :func:`modalshell.export.compression.compress`."""
    demand_near_origin(run.rest_positions, run.units.length, "clips")
    motion = compress(run)
    values = {name: getattr(motion, _NAMES.get(name, name)) for name in _CLIP.fields}
    return write_npz(path, **_CLIP.arrays(values, motion.units))


def read_clip(path: str | os.PathLike[str]) -> CompressedMotion:
    """The shapes and amplitudes of a clip; FileFormatError if the file is missing, damaged, or not a clip."""
    with _CLIP.read(path) as data:
        _check_values(data)
        values: dict[str, Any] = {_NAMES.get(name, name): data[name] for name in _CLIP.fields}
        return CompressedMotion(
            **values | {"error": float(data["error"]), "units": UnitSystem.from_array(data[UNITS[1]])}
        )


def _check_values(data: dict[str, NDArray[Any]]) -> None:
    """ValueError where an array of a clip has values that no motion has."""
    if data["shapes"].dtype != np.int16:
        raise ValueError(f"shapes must be 16-bit whole numbers (got {data['shapes'].dtype})")
    if not len(data["times"]) or (np.diff(data["times"]) <= 0.0).any():
        raise ValueError("times must increase, and be at least one")
    if (data["scales"] <= 0.0).any() or data["error"] < 0.0:
        raise ValueError("scales must be above 0, and error at least 0")
    faces, vertices = data["faces"], len(data["rest"])
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
