"""Choice of the renderer, tried once in a child process because VTK crashes without OpenGL."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import threading
import warnings
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Literal, cast, get_args

from modalshell.core.cores import usable_cores
from modalshell.core.errors import ModalShellWarning, OptionError
from modalshell.core.memory import demand_memory
from modalshell.render.painter import Painter

Backend = Literal["pyvista", "built-in"]

RENDERER_VARIABLE = "MODALSHELL_RENDERER"
WINDOW_VARIABLE = "VTK_DEFAULT_OPENGL_WINDOW"
APT_LINE = "apt-get install libegl1 libgl1-mesa-dri"
INSTALL_LINE = "pip install 'modalshell[vtk]'"
PROBE_SECONDS = 60.0
"""Longest wait for a probe [s]."""

_PROBE = """
try:
    import resource
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
except (ImportError, OSError, ValueError):
    pass
import pyvista
plotter = pyvista.Plotter(off_screen=True, window_size=(64, 64))
plotter.add_mesh(pyvista.Sphere())
image = plotter.screenshot(None, return_img=True)
plotter.close()
print("modalshell-probe", "ok" if image.max() > image.min() and image.std() > 1.0 else "blank")
"""
PROBE_COMMAND: tuple[str, ...] = (sys.executable, "-c", _PROBE)
"""Prints ``modalshell-probe ok`` where PyVista renders."""
_WINDOW_PROBE = """
import pyvista
plotter = pyvista.Plotter(window_size=(64, 64))
plotter.show(interactive=False, auto_close=False)
# Without a display that answers VTK turns to a window that nobody sees.
shown = not plotter.render_window.GetClassName().startswith(("vtkEGL", "vtkOSOpenGL"))
plotter.close()
print("modalshell-probe", "ok" if shown else "unseen")
"""
_GRAPHICS_DEVICES = ("dri/renderD*", "nvidia[0-9]*", "dxg")
"""Files under /dev of devices that run OpenGL: kernel drivers, NVIDIA's own, Windows' under WSL."""
_lock = threading.Lock()
_warned_of: set[tuple[str, ...]] = set()
"""Probes whose failure was warned of."""


def choose_backend() -> Backend:
    """Name what draws on this machine; the answer is found once a process.

    The environment variable ``MODALSHELL_RENDERER`` (``pyvista`` or ``built-in``) skips the probe. Where only one kind
    of off-screen window works, ``VTK_DEFAULT_OPENGL_WINDOW`` is set to it, because VTK reads it there. Returns
    ``"pyvista"``, or ``"built-in"`` for the built-in rasteriser.
    """
    named = os.environ.get(RENDERER_VARIABLE, "")
    if named:
        if named not in get_args(Backend):
            raise OptionError(
                f"{RENDERER_VARIABLE} must be 'pyvista' or 'built-in' (got {named!r}); unset it to let "
                "modalshell find out which of them draws here"
            )
        return cast(Backend, named)
    if not vtk_installed():
        return "built-in"
    with _lock:
        renders, window = _probe(PROBE_COMMAND, PROBE_SECONDS)
        first = PROBE_COMMAND not in _warned_of
        _warned_of.add(PROBE_COMMAND)
    if renders:
        if window is not None:
            os.environ[WINDOW_VARIABLE] = window
        return "pyvista"
    if first:
        warnings.warn(
            "PyVista renders nothing on this machine (no OpenGL), so the built-in rasteriser draws: slower and "
            f"plainer. On Debian or Ubuntu this helps: {APT_LINE}",
            ModalShellWarning,
            stacklevel=2,
        )
    return "built-in"


def draws_faster() -> bool:
    """Tell whether the built-in rasteriser is the faster one: nothing but the processor would run OpenGL.

    The environment variable ``MODALSHELL_RENDERER`` has its way.
    """
    if os.environ.get(RENDERER_VARIABLE) or not sys.platform.startswith("linux"):
        return False
    return not any(next(Path("/dev").glob(pattern), None) for pattern in _GRAPHICS_DEVICES)


@cache
def _probe(command: tuple[str, ...], timeout: float) -> tuple[bool, str | None]:
    """Whether PyVista renders, and the off-screen window that it needs; None leaves that to VTK."""
    if not os.environ.get(WINDOW_VARIABLE, "unset"):
        # VTK takes an empty value for the name of a window, finds none and crashes.
        del os.environ[WINDOW_VARIABLE]
    for window in _window_candidates():
        if _renders(command, window, timeout):
            return True, window
    return False, None


def vtk_installed() -> bool:
    """Tell whether PyVista, and with it VTK, is installed (extra ``vtk``)."""
    return importlib.util.find_spec("pyvista") is not None


def drawing_hint() -> str:
    """Return the command that would let PyVista draw here."""
    return APT_LINE if vtk_installed() else INSTALL_LINE


def opens_windows() -> bool:
    """Tell whether a window can be shown to the user; asked in a child process, as VTK without a display crashes."""
    if sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
        return False
    return _renders((sys.executable, "-c", _WINDOW_PROBE), None, PROBE_SECONDS)


def _window_candidates() -> list[str | None]:
    """List the off-screen windows to try in order; None leaves the environment as the user set it."""
    if not sys.platform.startswith("linux"):
        return [None]
    named = os.environ.get(WINDOW_VARIABLE)
    if not named and not os.environ.get("DISPLAY"):
        # VTK would find EGL by itself here, but with a line about the missing X server for every window.
        return ["vtkEGLRenderWindow", None, "vtkOSOpenGLRenderWindow"]
    return [None, *(name for name in ("vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow") if name != named)]


def _renders(command: Sequence[str], window: str | None, timeout: float) -> bool:
    """Tell whether the probe draws a picture; a crash, a failed import, a blank picture and a hang all say no."""
    environment = dict(os.environ)
    if window is not None:
        environment[WINDOW_VARIABLE] = window
    try:
        child = subprocess.run(
            list(command), env=environment, stdin=subprocess.DEVNULL, capture_output=True, timeout=timeout, check=False
        )
    except (subprocess.TimeoutExpired, OSError):
        return False
    return child.returncode == 0 and b"modalshell-probe ok" in child.stdout


_PIXEL_BYTES = 200
"""For each pixel of an image, drawn twice as large each way and averaged."""


def open_painter(size: tuple[int, int], *, film: bool = False) -> Painter:
    """Open the back end that draws here, for images of `size` (width, height) in pixels; refused without the memory.

    A film of opaque surfaces is drawn by the built-in rasteriser where OpenGL would run on the processor: the pictures
    are the same but for lines' edges, in a third of the time.
    """
    what, needed = f"a picture of {size[0]} x {size[1]} pixels", _PIXEL_BYTES * size[0] * size[1]
    demand_memory(what, needed, "make it smaller")
    if not (film and draws_faster()) and choose_backend() == "pyvista":
        from modalshell.render.pyvista_painter import PyvistaPainter

        return PyvistaPainter(size)
    from modalshell.render.rasteriser_painter import RasteriserPainter

    return RasteriserPainter(size)


def open_painters(size: tuple[int, int], most: int, *, film: bool = False) -> list[Painter]:
    """Open up to `most` painters that draw at the same time, as many as cores and memory allow; one under OpenGL."""
    painters = [open_painter(size, film=film)]
    if painters[0].threaded:
        with suppress(OptionError):  # the memory does for fewer
            while len(painters) < min(most, usable_cores()):
                painters.append(open_painter(size, film=film))
    return painters
