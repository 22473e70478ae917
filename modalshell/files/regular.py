"""Reading of files: only regular files that fit into memory, checked before a byte is read."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO

from modalshell.core.memory import available_memory, gigabytes

_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}
DOCUMENT = 100 * 2**20
"""Largest size [bytes] of a file of tables, such as a scene or a record."""


def open_regular(path: str | os.PathLike[str], most: int | None = None) -> BinaryIO:
    """Open a regular file for reading; pipes and devices are refused without waiting for them.

    OSError if there is no such file, it cannot be read, is no regular file, or is too large: ``strerror`` says which.

    Parameters
    ----------
    path : path
        The file; links are followed.
    most : int, optional
        Size [bytes] above which it is refused; no limit if omitted.
    """
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0) | getattr(os, "O_CLOEXEC", 0)
    try:
        descriptor = os.open(path, flags)
    except OSError as error:
        if error.errno == errno.ENXIO:  # a socket
            raise OSError(errno.EINVAL, "it is a socket or a device, not a regular file", str(path)) from error
        raise
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            kind = _KINDS.get(stat.S_IFMT(status.st_mode), "something else")
            number = errno.EISDIR if stat.S_ISDIR(status.st_mode) else errno.EINVAL
            raise OSError(number, f"it is {kind}, not a regular file", str(path))
        if most is not None and status.st_size > most:
            reason = f"it has {gigabytes(status.st_size)}, above the {gigabytes(most)} that are read"
            raise OSError(errno.EFBIG, reason, str(path))
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def read_regular(path: str | os.PathLike[str], most: int | None = None) -> bytes:
    """Contents of a regular file, at most a fourth of the free memory; see :func:`open_regular`."""
    fits = available_memory() // 4
    with open_regular(path, fits if most is None else min(most, fits)) as file:
        return file.read()


def read_text(path: str | os.PathLike[str]) -> str:
    """Contents of a regular file as UTF-8 text without a byte order mark; UnicodeDecodeError if it is other text.

    See :func:`read_regular`.
    """
    return read_regular(Path(path), DOCUMENT).decode("utf-8").removeprefix("\ufeff")
