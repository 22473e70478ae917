"""Trajectories as ``.npz``: uncompressed, without pickle, with aligned positions that can be memory-mapped."""

from __future__ import annotations

import os
import struct
import zipfile
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from modalshell.core.checks import checked_folder
from modalshell.core.outcome import Outcome
from modalshell.files.archive import UNITS, Archive, Field, readable
from modalshell.files.atomic_io import read_header, read_member, write_atomically
from modalshell.files.regular import open_regular
from modalshell.motion import Trajectory
from modalshell.motion.bars import Bars
from modalshell.shell.fields import FIELDS, TENSORS

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

_NAMES = {"rest": "rest_positions"}
"""Attributes of a trajectory that are named otherwise in the file."""
_TRAJECTORY = Archive(
    "a saved trajectory",
    "modalshell_trajectory",
    {
        "times": Field("fiu", ("F",), "s"),
        "energies": Field("fiu", ("F", 3), "J"),
        "constraint_residuals": Field("fiu", ("F", "k"), "m or rad"),
        "faces": Field("iu", ("T", 3)),
        "rest": Field("fiu", ("n", 3), "m"),
        "status": Field("U"),
        "message": Field("U"),
        "unconverged_steps": Field("iu"),
        "seconds": Field("fiu", (), "s of wall time"),
        "step_error": Field("f", ("known",)),
        "damping_error": Field("f", ("known too",)),
    },
)
_PERHAPS = "step_error", "damping_error"
"""Numbers that are not always known: arrays of one, or of none."""
_BAR = "bar_"
_BARS = {
    "bar_times": Field("f", ("B",), "s"),
    "bar_displacement": Field("f", ("B",), ""),
    "bar_margin": Field("f", ("B",), ""),
    "bar_valid": Field("b", ("B",)),
}
"""Error bars, of trajectories that have them."""
_BARS_ON = "bar_on"
"""Where they were found, if not on the shell itself."""
_UNJUDGED = {"bar_unjudged": Field("U", ("B",))}
"""Why frames with contacts have none."""
_LEVELS = {"levels": Field("U", ("F",))}
"""Models of the frames, of trajectories of a model that switches itself."""
_CREASES = {"crease_angles": Field("f", ("F", "C"), "rad"), "crease_heat": Field("f", ("F",), "J")}
"""What creases keep, of trajectories of shells that have them."""
_CONTACTS = {
    "contact_forces": Field("f", ("F", "n", 3), "N"),
    "in_contact": Field("b", ("F", "n")),
    "deepest": Field("f", ("F",), "m"),
}
"""What touches, of trajectories with contacts."""
_SELF_CONTACT = {"self_contact": Field("f", ("F",), "m")}
_REACTIONS = {"reactions": Field("f", ("F", "n", 3), "N")}
_FURTHER = _REACTIONS | _BARS | {_BARS_ON: Field("U", ())} | _UNJUDGED | _LEVELS | _CREASES | _CONTACTS | _SELF_CONTACT
_POSITIONS = {"positions": Field("f", ("F", "n", 3), "m")}
_PARTS = {"von_mises_faces": (2,)} | dict.fromkeys(TENSORS, (3,))
_TRIANGLES = {f"{_FIELD}{name}": Field("f", ("F", "T", *_PARTS.get(name, ())), unit) for name, unit in FIELDS.items()}
"""Fields of the triangles."""


def save_archive(run: Trajectory, path: str | os.PathLike[str]) -> Path:
    """Write a trajectory to an ``.npz`` file: plain arrays that ``numpy.load`` reads too."""
    values = {name: getattr(run, _NAMES.get(name, name)) for name in (*_TRAJECTORY.fields, *_POSITIONS)}
    values |= {name: np.array([] if values[name] is None else [values[name]], dtype=float) for name in _PERHAPS}
    values |= {f"{_FIELD}{name}": field for name, field in run.fields.items()}
    if run.bars is not None:
        values |= {name: getattr(run.bars, name.removeprefix(_BAR)) for name in _BARS}
        values |= {} if run.bars.on == "shell" else {_BARS_ON: np.array(run.bars.on)}
        values |= {name: np.array(run.bars.unjudged) for name in _UNJUDGED if run.bars.unjudged}
    if run.levels:
        values["levels"] = np.array(run.levels)
    if run.crease_angles.size:
        values |= {name: getattr(run, name) for name in _CREASES}
    if run.deepest.size:
        values |= {name: getattr(run, name) for name in _CONTACTS}
    if run.reactions.size:
        values["reactions"] = run.reactions
    if run.self_contact.size:
        values["self_contact"] = run.self_contact
    arrays = _TRAJECTORY.arrays(values, run.units, _POSITIONS | _TRIANGLES | _FURTHER)
    positions = arrays.pop("positions")
    return write_atomically(path, lambda file: _write(file, arrays, positions))


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
    with readable(_TRAJECTORY.kind, file):
        with open_regular(file) as whole, zipfile.ZipFile(whole) as archive:
            stored = [name.removesuffix(".npy") for name in archive.namelist()]
            _TRAJECTORY.check_mark(stored)
            _refuse_parts(stored)
            further = {name: field for name, field in (_TRIANGLES | _FURTHER).items() if name in stored}
            names = (_TRAJECTORY.mark, *_TRAJECTORY.fields, *further, *UNITS)
            data = {name: read_member(archive, name) for name in names}
            positions = _mapped(file, archive, verify)
        if _verifies(verify, positions.nbytes) and not np.isfinite(positions).all():
            raise ValueError("positions must be finite numbers")
        units = _TRAJECTORY.check(data, further, F=len(positions), n=positions.shape[1])
        if (np.diff(data["times"]) <= 0.0).any():
            raise ValueError("times must increase")
        faces, vertices = data["faces"], positions.shape[1]
        if faces.size and (faces.min() < 0 or faces.max() >= vertices):
            raise ValueError(f"faces must name vertices 0 to {vertices - 1}")
        values: dict[str, Any] = {_NAMES.get(name, name): data[name] for name in _TRAJECTORY.fields}
        values["outcome"], values["message"] = Outcome(str(values.pop("status"))), str(values["message"])
        for name, number in (("unconverged_steps", int), ("seconds", float)):
            values[name] = number(values[name])
        for name in _PERHAPS:
            values[name] = float(values[name][0]) if values[name].size else None
        fields = {name.removeprefix(_FIELD): data[name] for name in further if name in _TRIANGLES}
        if _BARS.keys() & further.keys():
            on = str(data[_BARS_ON]) if _BARS_ON in further else "shell"
            unjudged = tuple(str(reason) for name in _UNJUDGED if name in further for reason in data[name])
            values["bars"] = Bars(**{name.removeprefix(_BAR): data[name] for name in _BARS}, on=on, unjudged=unjudged)
        values |= {name: data[name] for name in _CONTACTS | _SELF_CONTACT | _REACTIONS if name in further}
        if "levels" in further:
            values["levels"] = tuple(str(name) for name in data["levels"])
        values |= {name: data[name] for name in _CREASES if name in further}
        return Trajectory(positions=positions, fields=fields, units=units, **values)


def _refuse_parts(stored: list[str]) -> None:
    """ValueError where of arrays that are written together some are missing."""
    for group in (_BARS, _CREASES, _CONTACTS):
        missing = [name for name in group if name not in stored]
        if 0 < len(missing) < len(group):
            there = next(name for name in group if name in stored)
            raise ValueError(f"{there} is there without {', '.join(missing)}, which go with it: save the run again")


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
