"""Compilation by numba, cached in the user's cache folder, or a temporary one, or not at all."""

from __future__ import annotations

import functools
import gc
import multiprocessing
import os
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, cast, final

from modalshell.core.errors import ModalShellWarning

_THREADS = "NUMBA_NUM_THREADS"


def _usable_thread_count() -> None:
    """Drop a number of threads that numba would refuse to start with, and say so."""
    try:
        refused = int(os.environ.get(_THREADS, "1")) < 1
    except ValueError:  # numba itself warns of it, and goes on
        return
    if refused:
        given = os.environ.pop(_THREADS)
        message = f"{_THREADS} must be a positive integer (got {given!r}): it is ignored, and all cores may be used"
        warnings.warn(message, ModalShellWarning, stacklevel=2)


_usable_thread_count()  # before numba reads it
import numba  # noqa: E402
from numba.core import event  # noqa: E402

from modalshell.kernels import ahead, quick_options, quick_typing  # noqa: E402
from modalshell.kernels.callees import folder_of, source_digest  # noqa: E402
from modalshell.kernels.linked import LINKED  # noqa: E402
from modalshell.kernels.turns import take_turns  # noqa: E402

_REFERENCE = 14.0, 4.0e-4
"""Seconds that the kernels of a long command take to compile, and this file, by Python, on one machine."""

_OWN = f"{__name__.partition('.')[0]}."
"""How the names of this package's modules begin."""
_BAR, _LINE = 30, 72
"""Characters of the bar of compilation, and of its line."""


@final
class _Notice(event.Listener):
    """Says once a process, on the error stream, that kernels are being compiled; to load them is not worth a word.

    On a terminal a bar shows how far that is, by the time so far over the longest, while a kernel is being compiled.
    """

    def __init__(self) -> None:
        self.due, self._collects = multiprocessing.parent_process() is None, False
        self._most, self._spent, self._begin, self._depth = 0.0, 0.0, 0.0, 0

    def on_start(self, event: Any) -> None:
        """Say it before a kernel of this package is compiled."""
        if not _is_own(event):
            return
        ahead.begin(event.data["dispatcher"], event.data["args"], cache_folder())
        if self.due:
            self.due = False
            self._most = _most_seconds()
            kept = "once" if cache_folder() else "at each start, as no folder can be written to"
            if sys.stderr is not None:
                print(f"modalshell: compiling kernels, {kept}, up to about {self._most:.0f} s", file=sys.stderr)
        self._depth += 1
        if self._depth == 1:
            # The compiler makes objects by the hundred thousand: to look for cycles in them is a tenth of its time.
            self._collects = gc.isenabled()
            gc.disable()
            self._begin = time.perf_counter()
            done = min(_BAR, round(_BAR * self._spent / self._most)) if self._most else 0
            self._draw(f"[{'#' * done}{' ' * (_BAR - done)}] {event.data['dispatcher'].py_func.__name__}")

    def on_end(self, event: Any) -> None:
        """Erase the bar: what the program prints next begins a line."""
        if not _is_own(event) or self._depth == 0:
            return
        self._depth -= 1
        if self._depth == 0:
            if self._collects:
                gc.enable()
            self._spent += time.perf_counter() - self._begin
            self._draw("")

    def _draw(self, text: str) -> None:
        stream = sys.__stderr__
        # Not where somebody else draws, as rich does, nor in processes that have said nothing.
        if self._most and stream is not None and stream is sys.stderr and stream.isatty():
            print(f"\r{text:<{_LINE}}", end="" if text else "\r", file=stream, flush=True)


def _is_own(event: Any) -> bool:
    """Whether a kernel of this package is compiled."""
    module = event.data["dispatcher"].py_func.__module__  # of what was made by exec() there is none
    return module is not None and module.startswith(_OWN)


def _most_seconds() -> float:
    """Time [s] that kernels take to compile at most: a machine is as much faster as Python's own compiler is there."""
    text, times = Path(__file__).read_text(encoding="utf-8"), []
    for _ in range(5):
        start = time.perf_counter()
        compile(text, __file__, "exec")
        times.append(time.perf_counter() - start)
    return max(1.0, _REFERENCE[0] * min(times) / _REFERENCE[1])


COUNTED: dict[str, Any] = {"_nrt": True}
UNCOUNTED: dict[str, Any] = {"_nrt": False}
"""Options: whether a kernel counts the references to its arrays, as it must where it makes or returns one.

Of records of many arrays to count takes a quarter of the time to compile; a kernel that only writes needs no count.
Said outright, or a kernel would be compiled as whichever caller came first.
"""

quick_options.apply()
quick_typing.apply()
notice = _Notice()
event.register("numba:compile", notice)  # type: ignore[no-untyped-call]


def _user_folder() -> Path:
    base = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA")
    return (
        Path(base or os.path.expanduser("~/Library/Caches" if sys.platform == "darwin" else "~/.cache")) / "modalshell"
    )


def _temporary_folder() -> Path:
    return Path(tempfile.gettempdir()) / f"modalshell-{os.getuid() if hasattr(os, 'getuid') else 'kernels'}"


def _own(folder: Path) -> Path:
    """``folder`` if it is this user's and nobody else may write to it, for code is loaded from there; else OSError."""
    folder = _writable(folder)
    status = folder.stat()
    if hasattr(os, "getuid") and (status.st_uid != os.getuid() or status.st_mode & 0o022):
        raise PermissionError(f"{folder} can be written to by others")
    return folder


def _writable(folder: Path) -> Path:
    """``folder``, created if missing; OSError if it is not writable."""
    if not folder.is_absolute():
        raise FileNotFoundError(f"{folder} is no absolute path")
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    tempfile.TemporaryFile(dir=folder).close()
    return folder


@functools.cache
def cache_folder() -> Path | None:
    """Where compiled kernels are kept; None where nothing can be written, and every process compiles again.

    Numba's own variable ``NUMBA_CACHE_DIR`` goes first, then the user's cache folder, then a temporary one.
    """
    asked = numba.config.CACHE_DIR  # type: ignore[attr-defined]
    with suppress(OSError, ValueError):
        if asked:
            return _writable(Path(asked).absolute())
    for folder in (_user_folder, _temporary_folder):
        with suppress(OSError, ValueError):  # ValueError: a null character in the name
            return _own(folder())
    return None


def njit(function: Callable[..., Any] | None = None, entry: bool | None = None, **options: Any) -> Any:
    """``numba.njit`` with the package's cache, and without the entry point that C code would call.

    Kernels of this package are kept by what they are made of, so that its copies share them; those of others by their
    path, too. Those that are not an ``entry`` cannot be called by Python: they are linked into kernels and kept with
    them, which is less to compile. By default they are the ones of this package whose name begins with an underscore.
    """
    if function is None:
        return functools.partial(njit, entry=entry, **options)
    if entry is None:
        inner = function.__name__.startswith("_") and function.__module__.startswith(_OWN)
        entry = not inner or bool(options.get("parallel"))
    options = {"no_cfunc_wrapper": True} | COUNTED | ({} if entry else LINKED) | options
    folder, before = cache_folder(), numba.config.CACHE_DIR  # type: ignore[attr-defined]
    numba.config.CACHE_DIR = str(folder or "")  # type: ignore[attr-defined]
    try:
        made = numba.njit(cache=entry and folder is not None, **options)(function)
    finally:
        numba.config.CACHE_DIR = before  # type: ignore[attr-defined]
    cache: Any = getattr(made, "_cache", None)
    if hasattr(cache, "_cache_file"):
        own = folder if function.__module__.startswith(_OWN) else None
        cache._cache_file._load_index = functools.partial(
            _known_index, cache, cache._cache_file._source_stamp, function.__module__, own
        )
        take_turns(made, cast(Path, folder))
    return made


def _known_index(cache: Any, stamp: Any, module: str, folder: Path | None) -> dict[Any, Any]:
    """Numba's index of a kernel's compiled forms, which are of today's sources; none that names lost classes."""
    kept, digest = cache._cache_file, source_digest(module, __name__)
    kept._source_stamp = digest if folder else (stamp, digest)
    if folder:
        place = str(folder_of(folder, module, digest))
        cache._cache_path = cache._impl.locator._cache_path = kept._cache_path = place
        kept._index_path = os.path.join(place, kept._index_name)
    try:
        return cast("dict[Any, Any]", type(kept)._load_index(kept))
    except (AttributeError, ImportError):
        return {}


ahead.begin_with_command(cache_folder())
