"""Kernels compiled ahead of need by a second process, on a machine with a core for it.

Numba compiles on one thread of a process. Where the first kernel of a common scene is not in the cache yet, a second
process takes those of the list below from its end, while the first one meets them from its beginning: what is compiled
by either is loaded by the other. It ends with the list, or with the process that began it. It imports the modules of
these kernels alone, and under a command that needs them, on an empty cache, it starts before the other ones are
imported.
"""

from __future__ import annotations

import atexit
import gc
import importlib
import os
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from numba.core import config, types

from modalshell.core.cores import usable_cores
from modalshell.core.interruption import is_command

_LETTERS = {
    types.float64: "d",
    types.float32: "f",
    types.int64: "l",
    types.int32: "i",
    types.uint8: "B",
    types.boolean: "b",
}
"""Letters of the arguments' types. An array has its number of dimensions after it, and r before it if read-only."""

KERNELS = """
render.raster.unit_normals d2 l2 d2 d2
render.raster.seen_faces d2 l2 d2 d1 l1
render.raster.shade l2 d2 b l1 d2 d2 d d3
render.raster.outline l1 l1 b1 d2 l1 b1
render.raster.flatten_one d2 f3 f2 l1 l d2 B3 B3
render.raster.draw_triangles d3 d2 d3 f d2 f3 f2 l1
shell.kernels.split_folds.match_triangles l1 l1 rl2 l1 l1
shell.kernels.split_folds.colour_triangles l2 l1
shell.kernels.split_folds.quadratic_forms d4 d4 d3
shell.kernels.split_folds.fold_angles d2 l2 d1 d1 d2
shell.kernels.split_folds.half_squares d2 rl2 d1 d1
shell.kernels.patterns.find_blocks l2 l2 i1 i1 l l i3
linalg.columns.solve_rows i1 i1 d1 d1 i1 d2 d2
shell.kernels.split_folds.add_fold_forces l2 d2 d1 d2
shell.kernels.split_folds.add_edge_forces d2 rl2 d1 d2
shell.kernels.split_folds.add_bending d2 l2 l2 l3 d2 d3 i3 i3 l1 d1
shell.kernels.split_folds.add_membrane d2 l2 d3 i3 l1 d1
shell.kernels.split_folds.fold_rates d2 l2 d2 d1
shell.kernels.split_folds.half_square_rates d2 d2 rl2 d1
linalg.profile.factorise d1 l1 l1 d2 d1
linalg.profile.solve d1 l1 l1 d2 d1 d1
kernels.rotations.rotate d2 d2 d d2
kernels.rotations.rotated_load_jacobian d2 d2 d3
kernels.rotations.largest_angle d2
kernels.rotations.warp d2 d2 d d2
models.base.distortion_kernels.surface_changes d2 rl2 rd1 l2 d d l d2
shell.kernels.split_folds.add_edge_curvatures rl2 d1 b i3 l1 d1
kernels.rotations.vertex_rotations d2 d2 rl2 d2
integrators.modal.exponential_kernels.correct d2 d d1 d1 d1 d1 d1 d2 d1
integrators.modal.exponential_kernels.predict d2 d1 d1 d1 d2
shell.kernels.split_folds.add_fold_curvatures d2 l2 d1 i3 l1 d1
loads.work.dead_work d2 d2 rd2
kernels.push.push_frame d1 d1 d1 d1 d1 d1
models.reduction.warp_step_kernels.warp_step d1 d1 d1 b d2 d d d d1 d1 d1 d1 d2 d1
kernels.frame.warp_frame d3 d2 d1 d2 d2
"""
"""Kernels of an ``Isotropic`` shell's modes, equilibrium, motion by modal warping and film, with their arguments.

Those of the film stand first, as not every scene is drawn.
"""

_PACKAGE = __name__.partition(".")[0]
_COMMAND = "simulate"
"""The command that needs all kernels of the list."""
_LOCK = "ahead.lock"
_STALE = 60.0
"""Age [s] from which a lock is that of a process that was killed."""
_begun = False


def entries() -> list[tuple[str, tuple[Any, ...]]]:
    """Names of the kernels in the list, from the package on, and the numba types of their arguments."""
    kinds: dict[str, Any] = {letter: kind for kind, letter in _LETTERS.items()}
    found = []
    for line in KERNELS.split("\n")[1:-1]:
        name, *arguments = line.split()
        own = []
        for text in arguments:
            kind = kinds[text.lstrip("r").rstrip("1234")]
            own.append(types.Array(kind, int(text[-1]), "C", text.startswith("r")) if text[-1].isdigit() else kind)
        found.append((name, tuple(own)))
    return found


def begin_with_command(folder: Path | None) -> None:
    """Start a second process under the command that needs all kernels, where none is in the cache ``folder`` yet.

    Not where no argument is a file: the command is about to refuse.
    """
    given = sys.orig_argv
    needed = is_command(given) and _COMMAND in given and not {"--help", "-h"}.intersection(given)
    if not needed or folder is None:
        return
    with suppress(OSError, ValueError):  # a folder that is not to be listed, an argument that is no path
        if not any(map(os.path.isfile, given[given.index(_COMMAND) :])):
            return
        if not any(folder.iterdir()):
            _start(folder)


def begin(dispatcher: Any, arguments: tuple[Any, ...], folder: Path | None) -> None:
    """Start a second process if a kernel of the list is about to be compiled into the cache ``folder``."""
    if _begun or folder is None:
        return
    function = dispatcher.py_func
    name = f"{function.__module__}.{function.__name__}".removeprefix(f"{_PACKAGE}.")
    if (name, tuple(arguments)) in entries():
        _start(folder)


def _start(folder: Path) -> None:
    """Start it, once a process, and not where this one may use one core only or has no interpreter to start.

    Nor where numba is to compile nothing, nor while another process fills the same folder.
    """
    global _begun
    if not sys.executable or config.DISABLE_JIT or usable_cores() < 2:  # type: ignore[attr-defined]
        return
    _begun = True
    lock = folder / _LOCK
    if not _locked(lock):
        return
    # It looks for modules where this process does, and runs no package's __init__, which would import all of them.
    empty = {name: [str(path)] for name, path in _packages().items()}
    program = f"""import sys, types
sys.path[:] = {sys.path!r}
for name, place in {empty!r}.items():
    sys.modules[name] = types.ModuleType(name)
    sys.modules[name].__path__ = place
from {__name__} import compile_from_end
compile_from_end({str(lock)!r})"""
    command, flags = [sys.executable, "-c", program], getattr(subprocess, "CREATE_NO_WINDOW", 0)
    silent = subprocess.DEVNULL
    try:
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=silent, stderr=silent, creationflags=flags)
    except OSError:
        lock.unlink(missing_ok=True)
    else:
        atexit.register(_end, process)


def _packages() -> dict[str, Path]:
    """Packages that the modules of the list are in, and their folders."""
    top, found = Path(__file__).parents[1], dict[str, Path]()
    for name in {_PACKAGE, *(f"{_PACKAGE}.{name}" for name, _ in entries())}:
        parts = name.split(".")
        found |= {".".join(parts[:k]): top.joinpath(*parts[1:k]) for k in range(1, max(2, len(parts) - 1))}
    return found


def _locked(lock: Path) -> bool:
    """Whether this process got the lock."""
    with suppress(OSError):
        if lock.exists() and time.time() - lock.stat().st_mtime > _STALE:
            lock.unlink()
        lock.touch(exist_ok=False)
        return True
    return False


def _end(process: subprocess.Popen[bytes]) -> None:
    """Close the pipe that the process listens to, upon which it leaves."""
    assert process.stdin is not None
    with suppress(OSError, subprocess.TimeoutExpired):
        process.stdin.close()
        process.wait(timeout=2.0)


def compile_from_end(lock: str) -> None:
    """Compile the list from its end, then remove the ``lock``; leave at once when the process that began it ends."""
    global _begun
    _begun = True
    gc.disable()  # to look for cycles is a twentieth of its time, and it ends soon
    threading.Thread(target=_leave_with_parent, args=(Path(lock),), daemon=True).start()
    try:
        for name, arguments in reversed(entries()):
            module, _, kernel = name.rpartition(".")
            getattr(importlib.import_module(f"{_PACKAGE}.{module}"), kernel).compile(arguments)
    finally:
        Path(lock).unlink(missing_ok=True)


def _leave_with_parent(lock: Path) -> None:
    os.read(sys.stdin.fileno(), 1)
    lock.unlink(missing_ok=True)
    os._exit(0)
