"""Append-only file of a run's frames: a header with the run's identity, then records of equal size with a CRC.

A killed process leaves complete records and at most one truncated one at the end, which the next process removes. Other
processes may read the file meanwhile (:mod:`modalshell.run.frame_reader`).
"""

from __future__ import annotations

import json
import os
import zlib
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modalshell.core.errors import OptionError
from modalshell.files.atomic_io import make_folder
from modalshell.files.lock import acquire_lock

MAGIC = b"modalshell frames 1\n"
ALIGNMENT = 64
"""Bytes to which records are aligned, so that frames can be mapped."""
CHECKSUM_BYTES = 4
"""Bytes of a record's CRC-32."""
CONSTANTS, LINE_CHECKSUM = "constants", "line checksum"
_CHECKSUM = "checksum"


class FrameFile:
    """A file of frames, created if missing, that this process alone holds while it is open.

    OptionError if another process holds the file.

    Attributes
    ----------
    count : int
        Whole records; known after :meth:`begin`.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.count = 0
        self._header = b""
        self._dtype = np.dtype([])
        make_folder(path.parent)
        self._descriptor = acquire_lock(path)

    def __enter__(self) -> FrameFile:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if os.fstat(self._descriptor).st_size == 0:
            self.remove()
        os.close(self._descriptor)

    def begin(
        self,
        identity: dict[str, str],
        fields: list[tuple[Any, ...]],
        restart: bool = False,
        constants: dict[str, NDArray[Any]] | None = None,
    ) -> None:
        """Resume from the records of the same run, or start with none.

        OptionError if the file belongs to another run, or its header is damaged; it is left as it is.

        Parameters
        ----------
        identity : dict of str
            All that decides the frames.
        fields : list
            NumPy fields of a record; a checksum is added to them.
        restart : bool
            Whether to discard existing records.
        constants : dict of ndarray, optional
            What all frames share and a reader needs, such as the mesh; decided by ``identity``.
        """
        self._dtype = record_dtype(fields)
        whole_identity = identity | {"record": json.dumps(fields)}
        self._header = _header(whole_identity, constants or {})
        if restart:
            os.ftruncate(self._descriptor, 0)
        else:
            self.refuse_others(whole_identity)
            self._refuse_damage()
        size = os.fstat(self._descriptor).st_size
        if size < len(self._header):  # new, or killed while the header was written
            os.ftruncate(self._descriptor, 0)
            self._write(0, self._header)
            size = len(self._header)
        self.count = (size - len(self._header)) // self._dtype.itemsize
        whole = self.records()
        self.count = next((index for index in range(self.count) if not is_sound(whole[index].tobytes())), self.count)
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
        """Difference of the frames' identity, as text; "" if there is none, or no frame."""
        with open(self.path, "rb") as file:
            magic, line = file.readline(len(MAGIC)), file.readline()
        if not line.endswith(b"\n"):  # torn, if it is a header at all
            return "" if MAGIC.startswith(magic) else "it is no file of frames, or damaged"
        try:
            other = dict(json.loads(line)) if magic == MAGIC else None
        except (ValueError, TypeError, RecursionError):
            other = None
        if other is None:
            return "it is no file of frames, or damaged"
        names = [name for name in identity if other.get(name) != identity[name]]
        return f"it differs in {', '.join(names)}" if names else ""

    def _refuse_damage(self) -> None:
        """Raise OptionError if there is a complete header that differs from this run's."""
        with open(self.path, "rb") as file:
            found = file.read(len(self._header))
        if len(found) == len(self._header) and found != self._header:
            raise OptionError(f"{self.path} is damaged: pass --restart (restart=True) to drop its frames")

    def append(self, values: dict[str, Any]) -> None:
        """Write one record."""
        record = np.zeros((), self._dtype)
        for name, value in values.items():
            record[name] = value
        record[_CHECKSUM] = zlib.crc32(record.tobytes()[:-CHECKSUM_BYTES])
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

    def _write(self, offset: int, data: bytes) -> None:
        os.lseek(self._descriptor, offset, os.SEEK_SET)
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[os.write(self._descriptor, rest) :]
        except OSError as error:  # a full disk: the system does not say of which file
            raise OSError(error.errno, error.strerror, str(self.path)) from error


def record_dtype(fields: list[tuple[Any, ...]]) -> np.dtype[Any]:
    """A record's fields with its checksum behind them."""
    return np.dtype([*fields, (_CHECKSUM, "<u4")])


def line_checksum(document: dict[str, Any]) -> int:
    """CRC of the contents of a header's line."""
    return zlib.crc32(json.dumps(document, sort_keys=True).encode())


def is_sound(record: bytes) -> bool:
    """Whether a record's checksum is correct."""
    checksum = int.from_bytes(record[-CHECKSUM_BYTES:], "little")
    return zlib.crc32(record[:-CHECKSUM_BYTES]) == checksum


def _header(identity: dict[str, str], constants: dict[str, NDArray[Any]]) -> bytes:
    """Header: magic number, one line of JSON, and the constants' bytes; a missing line end means a truncated header."""
    data = b"".join(array.tobytes() for array in constants.values())
    layout = [[name, array.dtype.str, array.shape] for name, array in constants.items()]
    document: dict[str, Any] = identity | {CONSTANTS: {"arrays": layout, "checksum": zlib.crc32(data)}}
    document[LINE_CHECKSUM] = line_checksum(document)
    text = MAGIC + json.dumps(document, sort_keys=True).encode()
    text += b" " * (-(len(text) + 1) % ALIGNMENT) + b"\n"
    return text + data + b"\0" * (-len(data) % ALIGNMENT)
