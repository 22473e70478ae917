"""Point caches, PC2 and MDD: vertex positions frame by frame, as animation programs read them."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import IO

import numpy as np

from modalshell.export.near_origin import demand_near_origin
from modalshell.files.atomic_io import write_atomically
from modalshell.motion import Trajectory


def save_pc2(run: Trajectory, path: Path) -> Path:
    """Write a PC2 file: one sample per frame from frame 0, little-endian float32, z up; the times are not in it."""
    frames, vertices = run.positions.shape[:2]
    return _save(run, path, struct.pack("<12siiffi", b"POINTCACHE2", 1, vertices, 0.0, 1.0, frames), "<f4")


def save_mdd(run: Trajectory, path: Path) -> Path:
    """Write an MDD file: big-endian float32 times [s] and positions, z up."""
    times = np.asarray(run.units.seconds * run.times, dtype=">f4").tobytes()
    return _save(run, path, struct.pack(">ii", *run.positions.shape[:2]) + times, ">f4")


def _save(run: Trajectory, path: Path, header: bytes, numbers: str) -> Path:
    demand_near_origin(run.rest_positions, run.units.length, "point caches")

    def write(file: IO[bytes]) -> None:
        file.write(header)
        for frame in run.positions:
            file.write(np.ascontiguousarray(frame, dtype=numbers).tobytes())

    return write_atomically(path, write)
