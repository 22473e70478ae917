"""Advisory file lock: one process holds it; others can test it without acquiring it."""

from __future__ import annotations

import errno
import os
import stat
import struct
import sys
from pathlib import Path

from modalshell.core.errors import OptionError

if sys.platform != "win32":
    import fcntl

_FLAGS = getattr(os, "O_BINARY", 0) | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
_FLOCK = "@hhqqi"
"""The C struct of a record lock: kind, origin, start and length (0: all of the file), process."""
_OWN_LOCKS = sys.platform == "linux"
"""Whether open-file-description locks exist here, which unlike ``flock`` can be tested without acquiring them."""


def acquire_lock(path: Path) -> int:
    """Open a file, create it if missing, and lock it until it is closed or the process ends (no lock under Windows).

    OptionError if another process has locked the file, or it cannot be written.
    """
    while True:
        try:
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | _FLAGS, 0o644)
        except OSError as error:
            reason = "it is a link, whose target is not ours" if error.errno == errno.ELOOP else error.strerror
            raise OptionError(f"{path}: cannot be written ({reason}); choose another --out folder") from error
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            os.close(descriptor)
            raise OptionError(f"{path}: cannot be written (it is no regular file); choose another --out folder")
        if sys.platform == "win32":
            return descriptor
        try:
            if _OWN_LOCKS:
                fcntl.fcntl(descriptor, fcntl.F_OFD_SETLK, struct.pack(_FLOCK, fcntl.F_WRLCK, os.SEEK_SET, 0, 0, 0))
            else:
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


def is_locked(descriptor: int) -> bool | None:
    """Whether a process has locked the open file; None if the system cannot tell. Acquires no lock."""
    if not _OWN_LOCKS:
        return None
    asked = struct.pack(_FLOCK, fcntl.F_WRLCK, os.SEEK_SET, 0, 0, 0)
    answer = fcntl.fcntl(descriptor, fcntl.F_OFD_GETLK, asked)
    return bool(struct.unpack(_FLOCK, answer)[0] != fcntl.F_UNLCK)
