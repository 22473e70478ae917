"""Stored cases of a sweep: one atomic file each, named by the case's digest."""

from __future__ import annotations

import hashlib
import os
import re
from pathlib import Path
from types import TracebackType

import msgspec
from msgspec import Struct

from modalshell.files.atomic_io import make_folder, write_bytes
from modalshell.files.lock import acquire_lock
from modalshell.files.regular import read_regular
from modalshell.sweep.case import CaseResult


class _Stored(Struct, frozen=True):
    """A case's file: JSON, with the SHA-256 of the result as it is written there."""

    checksum: str
    result: msgspec.Raw


class CaseFolder:
    """A folder of case files that this process alone holds while it is open.

    OptionError if another process holds it. What a killed process had begun to write is deleted.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        make_folder(folder)
        self._descriptor = acquire_lock(folder / "lock")
        for leftover in folder.glob(".*.part.json"):  # what killed processes had begun to write
            if re.fullmatch(r"\.[0-9a-f]{64}\.\d+\.part\.json", leftover.name):
                leftover.unlink()

    def __enter__(self) -> CaseFolder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        os.close(self._descriptor)

    def read(self, digest: str) -> CaseResult | None:
        """The result of a case; None where it is missing or damaged."""
        try:
            stored = msgspec.json.decode(read_regular(self._path(digest)), type=_Stored)
            result = msgspec.json.decode(stored.result, type=CaseResult)
        except (OSError, msgspec.DecodeError, UnicodeDecodeError):
            return None
        sound = _checksum(bytes(stored.result)) == stored.checksum and result.digest == digest
        return result if sound else None

    def write(self, result: CaseResult) -> None:
        """Store a result: once this returns it outlives the process."""
        text = msgspec.json.encode(result)
        data = msgspec.json.encode(_Stored(_checksum(text), msgspec.Raw(text))) + b"\n"
        write_bytes(self._path(result.digest), data)

    def _path(self, digest: str) -> Path:
        return self.folder / f"{digest}.json"


def _checksum(text: bytes) -> str:
    return hashlib.sha256(text).hexdigest()
