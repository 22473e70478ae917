"""Trajectories as ``.npz``: uncompressed, without pickle, with aligned positions that can be memory-mapped."""

from __future__ import annotations

import os
import struct
import zipfile
from dataclasses import astuple
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from modalshell.core.checks import checked_folder, shortened
from modalshell.core.errors import FileFormatError
from modalshell.core.outcome import Outcome
from modalshell.core.units import UnitSystem
from modalshell.files.atomic_io import read_header, read_member, write_atomically
from modalshell.files.regular import open_regular
from modalshell.motion import Trajectory
from modalshell.shell.fields import FIELDS, TENSORS

_FORMAT = 1
"""Version of the archive."""
_MARK = "modalshell_trajectory"
_ALIGNMENT = 64
"""Bytes to which arrays are aligned, so that they can be mapped."""
_CHUNK = 1 << 24
"""Bytes read at a time while checksums are compared."""
_VERIFIED = 1 << 26
"""Size of the positions [bytes] up to which loading reads them once to verify their checksum."""

_FIELD = "field_"
"""What the names of fields' members begin with."""
_LOCAL_HEADER = 30
"""Bytes of a ZIP member's local header before its name."""
_ZIP64_EXTRA = 20
"""Bytes of the extra field that ZIP64 sizes take."""
_STAMP = (1980, 1, 1, 0, 0, 0)
"""Of every member, so that equal trajectories make equal files."""

_UNITS = {
    "times": "s",
    "positions": "m",
    "rest": "m",
    "energies": "J",
    "constraint_residuals": "m or rad",
    "seconds": "s of wall time",
}
"""Units of the arrays."""
_SYSTEM = "unit_system"
"""Names of the units of length, mass and time."""
_NAMES = {"rest_positions": "rest"}
"""Attributes of a trajectory that are named otherwise in the file."""
_SMALL = ("times", "energies", "constraint_residuals", "faces", "rest_positions")
_SCALARS = ("status", "message", "unconverged_steps", "seconds")


def save_archive(run: Trajectory, path: str | os.PathLike[str]) -> Path:
    """Write a trajectory to an ``.npz`` file: plain arrays that ``numpy.load`` reads too."""
    arrays: dict[str, NDArray[Any]] = {_MARK: np.array(_FORMAT)}
    for name in (*_SMALL, *_SCALARS):
        arrays[_NAMES.get(name, name)] = np.asarray(getattr(run, name))
    arrays |= {f"{_FIELD}{name}": values for name, values in run.fields.items()}
    arrays["units"] = run.units.array(_UNITS | {f"{_FIELD}{name}": FIELDS[name] for name in run.fields})
    arrays[_SYSTEM] = np.array(astuple(run.units))
    return write_atomically(path, lambda file: _write(file, arrays, run.positions))


def _write(file: IO[bytes], arrays: dict[str, NDArray[Any]], positions: NDArray[np.floating]) -> None:
    with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
        for name, array in (*arrays.items(), ("positions", positions)):
            member = zipfile.ZipInfo(f"{name}.npy", _STAMP)
            if name == "positions":
                member.extra = _padding(file.tell() + _LOCAL_HEADER + len(member.filename) + _ZIP64_EXTRA)
            with archive.open(member, "w", force_zip64=True) as out:
                np.lib.format.write_array(out, array, allow_pickle=False)  # copies part by part where not contiguous


def _padding(position: int) -> bytes:
    """An extra field of the zip format that ends at a multiple of the alignment; NumPy's own header keeps it."""
    length = -(position + 4) % _ALIGNMENT
    return struct.pack("<HH", 0xFFFF, length) + bytes(length)


def load_trajectory(path: str | os.PathLike[str], *, verify: bool | None = None) -> Trajectory:
    """Read a trajectory that :func:`save_trajectory` wrote as ``.npz``, without reading its positions into memory.

    Parameters
    ----------
    path : path
        The file.
    verify : bool, optional
        Whether to read the positions once to check them against their checksum. By default up to 64 MiB of them; all
        else is always checked.

    Returns
    -------
    Trajectory
        Its positions mapped, read only: frames come from disk when they are looked at.

    Raises
    ------
    FileFormatError
        If the file is missing, cut off, damaged, or not a saved trajectory.
    """
    file = checked_folder("path", path)
    try:
        with open_regular(file) as whole, zipfile.ZipFile(whole) as archive:
            mark = int(read_member(archive, _MARK))
            if mark != _FORMAT:
                raise ValueError(f"format {mark} (this version reads {_FORMAT})")
            values = {name: read_member(archive, _NAMES.get(name, name)) for name in (*_SMALL, *_SCALARS)}
            fields = {name: read_member(archive, f"{_FIELD}{name}") for name in FIELDS if _holds(archive, name)}
            units = _system(archive)
            positions = _mapped(file, archive, verify)
            checked = positions if _verifies(verify, positions.nbytes) else positions[:0]
        _check_shapes(values, positions)
        _check_numbers(values, checked)
        _check_fields(fields, len(positions), len(values["faces"]))
        outcome, message = Outcome(str(values["status"])), str(values["message"])
        unconverged, seconds = int(values["unconverged_steps"]), float(values["seconds"])
    except Exception as error:  # zip, OS, key, type and value errors all mean the same to the user
        raise FileFormatError(f"cannot read a saved trajectory from {file}: {shortened(str(error))}") from error
    arrays: dict[str, Any] = {name: values[name] for name in _SMALL}
    return Trajectory(
        positions=positions,
        outcome=outcome,
        message=message,
        unconverged_steps=unconverged,
        seconds=seconds,
        fields=fields,
        units=units,
        **arrays,
    )


def _holds(archive: zipfile.ZipFile, name: str) -> bool:
    return f"{_FIELD}{name}.npy" in archive.namelist()


def _system(archive: zipfile.ZipFile) -> UnitSystem:
    """The units of an archive."""
    read_member(archive, "units")  # damaged ones are refused
    return UnitSystem.from_array(read_member(archive, _SYSTEM))


def _check_fields(fields: dict[str, NDArray[Any]], frames: int, triangles: int) -> None:
    """ValueError where a field holds no real, finite numbers, or not one entry a frame and triangle."""
    for name, values in fields.items():
        parts = {"von_mises_faces": (2,)} | dict.fromkeys(TENSORS, (3,))
        expected = (frames, triangles, *parts.get(name, ()))
        if values.dtype.kind != "f" or values.shape != expected or not np.isfinite(values).all():
            raise ValueError(f"field {name} must be finite numbers {expected} (got {values.dtype} {values.shape})")


def _mapped(file: Path, archive: zipfile.ZipFile, verify: bool | None) -> NDArray[np.floating]:
    info = archive.getinfo("positions.npy")
    if info.compress_type != zipfile.ZIP_STORED:
        raise ValueError("positions are compressed, so they cannot be mapped; save them with save_trajectory")
    with archive.open(info) as member:
        shape, fortran, dtype = read_header(member)
        header = member.tell()
        if _verifies(verify, info.file_size):
            while member.read(_CHUNK):
                pass
    if fortran or len(shape) != 3 or shape[2] != 3 or dtype not in (np.dtype("<f8"), np.dtype("<f4")):
        raise ValueError(f"positions must be float64 or float32 (F, n, 3) (got {dtype} {shape})")
    if header + dtype.itemsize * int(np.prod(shape)) != info.file_size:
        raise ValueError("positions are not as long as their header says")
    with open(file, "rb") as raw:
        raw.seek(info.header_offset + 26)
        name_length, extra_length = struct.unpack("<HH", raw.read(4))
    offset = info.header_offset + _LOCAL_HEADER + name_length + extra_length + header
    if offset + info.file_size - header > file.stat().st_size:
        raise ValueError("positions are cut off")
    return np.memmap(file, dtype, "r", offset, shape)


def _verifies(verify: bool | None, size: int) -> bool:
    """Whether positions of ``size`` bytes are read once to be checked."""
    return size <= _VERIFIED if verify is None else verify


def _check_numbers(values: dict[str, NDArray[Any]], positions: NDArray[np.floating]) -> None:
    """ValueError where an array holds no real, finite numbers, or a triangle names no vertex."""
    numbers = [(name, values[name]) for name in (*_SMALL, "seconds", "unconverged_steps")]
    for name, array in (*numbers, ("positions", positions)):
        if array.dtype.kind not in "iuf" or not np.isfinite(array).all():
            raise ValueError(f"{name} must be finite numbers (dtype {array.dtype})")
    faces = values["faces"]
    if faces.size and (faces.dtype.kind == "f" or faces.min() < 0 or faces.max() >= len(values["rest_positions"])):
        raise ValueError(f"faces must name vertices 0 to {len(values['rest_positions']) - 1}")


def _check_shapes(values: dict[str, NDArray[Any]], positions: NDArray[np.floating]) -> None:
    frames, vertices = positions.shape[:2]
    expected: dict[str, tuple[int | None, ...]] = {
        "times": (frames,),
        "energies": (frames, 3),
        "constraint_residuals": (frames, None),
        "faces": (None, 3),
        "rest_positions": (vertices, 3),
        "status": (),
        "message": (),
        "unconverged_steps": (),
        "seconds": (),
    }
    for name in values:
        shape = expected[name]
        got = values[name].shape
        fits = len(got) == len(shape) and all(want in (None, size) for size, want in zip(got, shape, strict=True))
        if not fits:
            raise ValueError(f"{name} has shape {got}, which does not fit positions {positions.shape}")
