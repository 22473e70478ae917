"""Atomic writes, and checksummed reads of NPZ and JSON files."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modalshell.core.checks import shortened, shown
from modalshell.core.errors import FileFormatError
from modalshell.core.memory import available_memory, gigabytes
from modalshell.files.regular import open_regular, read_text

_DIGEST = "sha256"
"""Name of the digest over all other members of an NPZ or JSON file, which detects members of another file."""


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path in the folder of ``path``, with its suffix; on success rename it to ``path``.

    FileFormatError if nothing can be written.
    """
    target = Path(path)
    make_folder(target.parent)
    temporary = target.with_name(f".{target.stem}.{os.getpid()}.part{target.suffix}")
    try:
        yield temporary
        os.replace(temporary, target)
    except OSError as error:
        name, reason = shortened(str(target)), error.strerror or shortened(str(error))
        raise FileFormatError(f"{name}: cannot be written ({reason}); give another path or folder") from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def make_folder(folder: Path) -> None:
    """Make a folder for results and its parents; FileFormatError if that fails, or nothing can be written into it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        reason = error.strerror if isinstance(error, OSError) else error
        raise FileFormatError(f"{shown(str(folder))}: no folder for results ({reason}); give another one") from error


def write_atomically(path: str | os.PathLike[str], write: Callable[[IO[bytes]], None]) -> Path:
    """Call ``write`` on a temporary file in the same folder, then rename it to ``path``."""
    with replacing(path) as temporary, open(temporary, "wb") as file:
        write(file)
        file.flush()
        os.fsync(file.fileno())
    return Path(path)


def write_npz(path: str | os.PathLike[str], **arrays: ArrayLike) -> Path:
    """Write arrays and a digest of them to a compressed ``.npz`` file, without pickle."""
    given: dict[str, Any] = {name: np.asarray(array) for name, array in arrays.items()}
    if objects := [name for name, array in given.items() if array.dtype.hasobject]:
        raise ValueError(f"{objects[0]} holds Python objects, which are not written")
    given[_DIGEST] = np.array(digest(given))
    return write_atomically(path, lambda file: np.savez_compressed(file, **given))  # all versions of NumPy take these


def read_npz(path: str | os.PathLike[str]) -> dict[str, NDArray[Any]]:
    """Read all arrays of an ``.npz`` file; exceptions of zip, NumPy or the system if one is damaged.

    For files without a digest, as NumPy writes them, only the members' checksums are verified.
    """
    with open_regular(path) as file, zipfile.ZipFile(file) as archive:
        names = [name.removesuffix(".npy") for name in archive.namelist()]
        if len(set(names)) < len(names):
            raise ValueError("two of its arrays have the same name")
        arrays = {name: read_member(archive, name) for name in names}
    stored = arrays.pop(_DIGEST, None)
    if stored is not None and str(stored) != digest(arrays):
        raise ValueError("its arrays are not those that were written together: the digest differs")
    return arrays


def read_member(archive: zipfile.ZipFile, name: str) -> NDArray[Any]:
    """Read one array of an ``.npz`` file and verify its checksum; truncated ones are refused before allocation."""
    info = archive.getinfo(f"{name}.npy")
    with archive.open(info) as member:
        shape, _, dtype = read_header(member)
        if dtype.hasobject:
            raise ValueError(f"{name} holds Python objects, which are not read")
        if member.tell() + dtype.itemsize * int(np.prod(shape, dtype=object)) != info.file_size:
            raise ValueError(f"{name} is not as long as its header says")
        if info.file_size > available_memory():
            raise ValueError(f"{name} needs {gigabytes(info.file_size)}, {gigabytes(available_memory())} are free")
    with archive.open(info) as member:
        array: NDArray[Any] = np.lib.format.read_array(member, allow_pickle=False)
        member.read(1)  # the checksum is compared at the end only
    return array


def read_header(member: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, Fortran order and dtype of a ``.npy`` file, read up to its data."""
    major = np.lib.format.read_magic(member)
    read = np.lib.format.read_array_header_1_0 if major == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran, dtype = read(member)
    return shape, fortran, dtype


def digest(arrays: dict[str, NDArray[Any]]) -> str:
    """SHA-256 over the names, types, shapes and bytes of ``arrays``, in any order."""
    whole = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        whole.update(f"{name} {array.dtype.str} {arrays[name].shape}\n".encode())
        whole.update(array.tobytes())
    return whole.hexdigest()


def write_record(path: str | os.PathLike[str], document: dict[str, Any]) -> Path:
    """Write a JSON file with a digest over all of it."""
    return write_text(path, json.dumps(document | {_DIGEST: _document_digest(document)}, indent=1) + "\n")


def read_record(path: str | os.PathLike[str]) -> dict[str, Any] | None:
    """Read what :func:`write_record` wrote; None if the file is missing, damaged or of another kind."""
    try:
        return checked_record(path)
    except (OSError, ValueError, TypeError, AttributeError, RecursionError):
        return None


def checked_record(path: str | os.PathLike[str]) -> dict[str, Any]:
    """As :func:`read_record`, but raise what JSON or the system raises."""
    document: dict[str, Any] = json.loads(read_text(path))
    if document.pop(_DIGEST, None) != _document_digest(document):
        raise ValueError("it is not as it was written: the digest differs")
    return document


def _document_digest(document: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()


def write_bytes(path: str | os.PathLike[str], data: bytes) -> Path:
    """Write a file of these bytes."""

    def write(file: IO[bytes]) -> None:
        file.write(data)

    return write_atomically(path, write)


def write_text(path: str | os.PathLike[str], text: str) -> Path:
    """Write a UTF-8 text file."""
    return write_bytes(path, text.encode())
