"""Reading a run's frames while another process writes them."""

from __future__ import annotations

import json
import math
import os
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modalshell.files.lock import is_locked
from modalshell.files.regular import open_regular
from modalshell.run.frame_file import (
    ALIGNMENT,
    CHECKSUM_BYTES,
    CONSTANTS,
    LINE_CHECKSUM,
    MAGIC,
    is_sound,
    line_checksum,
    record_dtype,
)

_LINE_LIMIT = 1 << 20
"""Length [bytes] beyond which no header's line is looked for."""
_LOOK_BACK = 10_000
"""Records, from the end on, among which a sound one is looked for: a killed process leaves one that is not."""
_TRIES = 3
"""Times that a record is read again while it is being written."""


@dataclass(frozen=True, eq=False)
class _Header:
    """A parsed header: records of ``dtype`` begin at byte ``start``."""

    line: bytes
    identity: dict[str, Any]
    constants: dict[str, NDArray[Any]]
    dtype: np.dtype[Any]
    start: int


class FrameReader:
    """Reader of a file of frames that another process may append to, truncate, or rewrite at any time.

    Nothing is locked or memory-mapped: truncation of a mapped file would kill the reading process. FileNotFoundError if
    there is no file.

    Attributes
    ----------
    index : int
        Number of the record last read; -1 before the first.
    record : numpy record or None
        The record last read, its checksum right.
    identity : dict
        What decides that record's frames; see :meth:`FrameFile.begin`.
    constants : dict of ndarray
        What all frames of its run share.
    generation : object
        Changes when a run is restarted.
    """

    def __init__(self, path: Path) -> None:
        with open_regular(path) as file:
            self._descriptor = os.dup(file.fileno())
        self._header: _Header | None = None
        self._seen: object = None
        self.index = -1
        self.record: Any = None
        self.generation: object = None
        self.identity: dict[str, Any] = {}
        self.constants: dict[str, NDArray[Any]] = {}

    def close(self) -> None:
        """Close the file."""
        os.close(self._descriptor)

    def is_held(self) -> bool | None:
        """Whether a process is writing the file; None if the system cannot tell."""
        return is_locked(self._descriptor)

    def is_file(self, path: Path) -> bool:
        """Whether ``path`` is still the open file, not another one of that name."""
        try:
            return os.path.samestat(os.fstat(self._descriptor), os.stat(path))
        except FileNotFoundError:
            return False

    def read_newest(self) -> bool:
        """Read the newest intact record; False, with all attributes unchanged, if there is no newer one."""
        for _ in range(_TRIES):
            status = os.fstat(self._descriptor)
            header, first = self._look()
            seen = (header, first, status.st_size, status.st_mtime_ns)
            if header is None or seen == self._seen:
                return False
            index, data = self._newest_sound(header, (status.st_size - header.start) // header.dtype.itemsize)
            if self._look() != (header, first):  # another run was begun here in the meantime
                continue
            self._seen = seen
            if index < 0 or ((header.line, first), index) == (self.generation, self.index):
                return False
            self.index, self.generation = index, (header.line, first)
            self.record = np.frombuffer(data, header.dtype)[0]
            self.identity, self.constants = header.identity, header.constants
            return True
        return False

    def _look(self) -> tuple[_Header | None, bytes]:
        """The header, None while it is written or if it is damaged, and the first record's checksum.

        The first record contains wall time, so its checksum distinguishes runs of the same scene.
        """
        known = self._header
        if known is None or os.pread(self._descriptor, len(known.line), 0) != known.line:
            known = self._header = self._read_header()
        if known is None:
            return None, b""
        offset = known.start + known.dtype.itemsize - CHECKSUM_BYTES
        return known, os.pread(self._descriptor, CHECKSUM_BYTES, offset)

    def _read_header(self) -> _Header | None:
        text = os.pread(self._descriptor, _LINE_LIMIT, 0)
        line = text[: text.find(b"\n", len(MAGIC)) + 1]
        if not line.startswith(MAGIC):
            return None
        try:
            identity = json.loads(line[len(MAGIC) :])
            if identity.pop(LINE_CHECKSUM) != line_checksum(identity):
                return None
            layout = identity.pop(CONSTANTS)
            arrays = [(name, np.dtype(kind), tuple(shape)) for name, kind, shape in layout["arrays"]]
            sizes = [kind.itemsize * math.prod(shape) for _, kind, shape in arrays]
            if min(sizes, default=0) < 0 or sum(sizes) > os.fstat(self._descriptor).st_size:
                return None
            data = os.pread(self._descriptor, sum(sizes), len(line))
            if len(data) != sum(sizes) or zlib.crc32(data) != layout["checksum"]:
                return None
            fields = [(name, kind, *map(tuple, shape)) for name, kind, *shape in json.loads(identity["record"])]
            dtype = record_dtype(fields)
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError, OverflowError):
            return None
        if any(kind.hasobject or not kind.itemsize for kind in (dtype, *(kind for _, kind, _ in arrays))):
            return None
        constants, offset = {}, 0
        for (name, kind, shape), size in zip(arrays, sizes, strict=True):
            constants[name] = np.frombuffer(data[offset : offset + size], kind).reshape(shape)
            offset += size
        return _Header(line, identity, constants, dtype, len(line) + offset + -offset % ALIGNMENT)

    def _newest_sound(self, header: _Header, count: int) -> tuple[int, bytes]:
        """Number and bytes of the last complete record; (-1, b"") if there is none."""
        length = header.dtype.itemsize
        for index in range(count - 1, max(count - _LOOK_BACK, 0) - 1, -1):
            data = os.pread(self._descriptor, length, header.start + index * length)
            if len(data) == length and is_sound(data):
                return index, data
        return -1, b""
