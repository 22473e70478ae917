"""Append-only file of a run's frames: a header that says whose they are, then records of one size, each with its CRC.

A killed process leaves whole records and at most one torn one, at the end, which the next process cuts off.
"""

from __future__ import annotations

import json
import os
import sys
import zlib
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modalshell.errors import OptionError
from modalshell.files import make_folder

if sys.platform != "win32":
    import fcntl

_MAGIC = b"modalshell frames 1\n"
_ALIGNMENT = 64
_CHECKSUM = "checksum"


class FrameFile:
    """A file of frames that this process alone holds while it is open.

    Parameters
    ----------
    path : Path
        The file; made, empty, where there is none.

    Attributes
    ----------
    count : int
        Whole records; known after :meth:`begin`.

    Raises
    ------
    OptionError
        If another process holds the file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.count = 0
        self._header = b""
        self._dtype = np.dtype([])
        make_folder(path.parent)
        self._descriptor = _lock(path)

    def __enter__(self) -> FrameFile:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if os.fstat(self._descriptor).st_size == 0:
            self.remove()
        os.close(self._descriptor)

    def begin(self, identity: dict[str, str], fields: list[tuple[Any, ...]], restart: bool = False) -> None:
        """Take up the records of the same run, or start anew.

        Parameters
        ----------
        identity : dict of str
            All that decides the frames.
        fields : list
            NumPy fields of a record; a checksum is added to them.
        restart : bool
            Whether to drop what is there.

        Raises
        ------
        OptionError
            If the file belongs to another run; it is left as it is.
        """
        self._dtype = np.dtype([*fields, (_CHECKSUM, "<u4")])
        whole_identity = identity | {"record": repr(fields)}
        self._header = _header(whole_identity)
        if restart:
            os.ftruncate(self._descriptor, 0)
        else:
            self.refuse_others(whole_identity)
        size = os.fstat(self._descriptor).st_size
        if size < len(self._header):  # new, or killed while the header was written
            os.ftruncate(self._descriptor, 0)
            self._write(0, self._header)
            size = len(self._header)
        self.count = (size - len(self._header)) // self._dtype.itemsize
        whole = self.records()
        self.count = next((index for index in range(self.count) if not _sound(whole[index])), self.count)
        del whole  # a mapped file cannot be cut everywhere
        os.ftruncate(self._descriptor, self._end())

    def refuse_others(self, identity: dict[str, str]) -> None:
        """Raise OptionError if the file holds frames of a run of another ``identity`` than this one."""
        if reason := self.difference(identity):
            raise OptionError(
                f"{self.path} holds frames of another run ({reason}): pass --restart (restart=True) to drop them, or "
                "choose another --out folder"
            )

    def difference(self, identity: dict[str, str]) -> str:
        """In what the frames' own identity differs, in words; "" if in nothing, or if there are none."""
        with open(self.path, "rb") as file:
            magic, line = file.readline(len(_MAGIC)), file.readline()
        if not line.endswith(b"\n"):  # torn, if it is a header at all
            return "" if _MAGIC.startswith(magic) else "it is no file of frames, or damaged"
        try:
            other = dict(json.loads(line)) if magic == _MAGIC else None
        except (ValueError, TypeError, RecursionError):
            other = None
        if other is None:
            return "it is no file of frames, or damaged"
        names = [name for name in identity if other.get(name) != identity[name]]
        return f"it differs in {', '.join(names)}" if names else ""

    def append(self, values: dict[str, Any]) -> None:
        """Write one record."""
        record = np.zeros((), self._dtype)
        for name, value in values.items():
            record[name] = value
        record[_CHECKSUM] = zlib.crc32(record.tobytes()[:-4])
        self._write(self._end(), record.tobytes())
        self.count += 1

    def records(self) -> NDArray[Any]:
        """All records, mapped and read only."""
        if self.count == 0:
            return np.empty(0, self._dtype)
        return np.memmap(self.path, self._dtype, "r", len(self._header), (self.count,))

    def remove(self) -> None:
        """Delete the file; its results are elsewhere."""
        self.path.unlink(missing_ok=True)

    def _end(self) -> int:
        return len(self._header) + self.count * self._dtype.itemsize

    def _write(self, place: int, data: bytes) -> None:
        os.lseek(self._descriptor, place, os.SEEK_SET)
        left = memoryview(data)
        while left:
            left = left[os.write(self._descriptor, left) :]


def _header(identity: dict[str, str]) -> bytes:
    """Magic and one line of JSON; the line's end tells a whole header from a torn one."""
    text = _MAGIC + json.dumps(identity, sort_keys=True).encode()
    text += b" " * (-(len(text) + 1) % _ALIGNMENT) + b"\n"
    return text


def _sound(record: Any) -> bool:
    return bool(zlib.crc32(record.tobytes()[:-4]) == record[_CHECKSUM])


def _lock(path: Path) -> int:
    """Descriptor of the file, locked until it is closed or the process ends (not under Windows)."""
    while True:
        try:
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_BINARY", 0), 0o644)
        except OSError as error:
            raise OptionError(f"{path}: cannot be written ({error.strerror}); choose another --out folder") from error
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
