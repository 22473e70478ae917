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

if sys.platform != "win32":
    pass


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
