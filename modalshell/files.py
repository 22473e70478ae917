"""Writing files so that a killed run leaves a whole file or none, and holding one against other processes."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import ArrayLike

from modalshell.errors import OptionError

if sys.platform != "win32":
    import fcntl


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary path beside ``path``, with its suffix; what was written there is put in place in one move."""
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = target.with_name(f".{target.stem}.{os.getpid()}.part{target.suffix}")
    try:
        yield temporary
        os.replace(temporary, target)
    finally:
        temporary.unlink(missing_ok=True)


def write_atomically(path: str | os.PathLike[str], write: Callable[[IO[bytes]], None]) -> Path:
    """Write through ``write`` into a temporary file beside ``path``, then put it in place in one move."""
    with replacing(path) as temporary, open(temporary, "wb") as file:
        write(file)
        file.flush()
        os.fsync(file.fileno())
    return Path(path)


def write_npz(path: str | os.PathLike[str], **arrays: ArrayLike) -> Path:
    """Write arrays to a compressed ``.npz`` file (no pickle)."""
    return write_atomically(path, lambda file: np.savez_compressed(file, allow_pickle=False, **arrays))


def write_bytes(path: str | os.PathLike[str], data: bytes) -> Path:
    """Write a file of these bytes."""

    def write(file: IO[bytes]) -> None:
        file.write(data)

    return write_atomically(path, write)


def write_text(path: str | os.PathLike[str], text: str) -> Path:
    """Write a UTF-8 text file."""
    return write_bytes(path, text.encode())


def lock_file(path: Path) -> int:
    """Descriptor of the file, locked until it is closed or the process ends (not under Windows).

    OptionError if another process holds the file.
    """
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_BINARY", 0), 0o644)
        if sys.platform == "win32":
            return descriptor
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(descriptor)
            raise OptionError(
                f"{path} is in use by another process: let it finish, or choose another --out folder"
            ) from error
        try:  # the holder before may have deleted the file between our two calls
            if os.fstat(descriptor).st_ino == os.stat(path).st_ino:
                return descriptor
        except FileNotFoundError:
            pass
        os.close(descriptor)
