"""Processes take turns to compile: what one of them compiles for the cache, the others wait for and load.

Where several begin at once on an empty cache, as those of a sweep or of the tests do, each would compile the same.
"""

from __future__ import annotations

import os
import sys
import threading
import time
import zlib
from contextlib import suppress
from pathlib import Path
from typing import Any

if sys.platform != "win32":
    import fcntl

_LOCK = "turns.lock"
_WAIT, _LONGEST = 0.05, 600.0
"""Seconds from one look to the next at what another process compiles, and after which it is no longer waited for."""
_opened: dict[Path, int] = {}


class _Held(threading.local):
    """Bytes of the lock's file that a thread has locked, the innermost compilation's last."""

    def __init__(self) -> None:
        self.bytes: list[int] = []


_held = _Held()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=lambda: _held.bytes.clear())  # locks stay with the parent


def take_turns(dispatcher: Any, folder: Path) -> None:
    """Let a kernel that is kept in the cache ``folder`` be compiled by one process at a time (not under Windows).

    A byte of one file stands for a kernel with its arguments. The system frees it when the process ends, and a process
    that is forked has none of them.
    """
    if sys.platform == "win32":
        return
    cache, compiled = dispatcher._cache, dispatcher.compile
    load, name = cache.load_overload, f"{dispatcher.py_func.__module__}.{dispatcher.py_func.__qualname__}"

    def load_or_wait(signature: Any, context: Any) -> Any:
        byte, end = zlib.crc32(f"{name} {signature}".encode()), time.monotonic() + _LONGEST
        while (found := load(signature, context)) is None and time.monotonic() < end:
            taken = _locked(folder, byte)
            if taken:
                return load(signature, context)  # by now another process may have saved it
            if taken is None:
                return None
            time.sleep(_WAIT)
        return found

    def compile_in_turn(signature: Any) -> Any:
        outer = len(_held.bytes)
        try:
            return compiled(signature)
        finally:
            while len(_held.bytes) > outer:
                with suppress(OSError):
                    fcntl.lockf(_opened[folder], fcntl.LOCK_UN, 1, _held.bytes.pop())

    cache.load_overload, dispatcher.compile = load_or_wait, compile_in_turn


def _locked(folder: Path, byte: int) -> bool | None:
    """Whether a byte of the folder's file could be locked, or another process has it; None where there is no turn."""
    if byte in _held.bytes:
        return None
    try:
        if folder not in _opened:
            _opened[folder] = os.open(folder / _LOCK, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
        fcntl.lockf(_opened[folder], fcntl.LOCK_EX | fcntl.LOCK_NB, 1, byte)
    except (BlockingIOError, PermissionError):  # as systems say that it is another's
        return False
    except OSError:  # a file system without locks
        return None
    _held.bytes.append(byte)
    return True
