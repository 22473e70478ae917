"""View of a run of another process: in a window, on a web page, as a picture or as text."""

from __future__ import annotations

import os
import time
from pathlib import Path

from modalshell.core.checks import printable
from modalshell.core.errors import OptionError
from modalshell.render.content import checked_path
from modalshell.run import RunFollower
from modalshell.viewer.desktop import ShellWindow, demand_window
from modalshell.viewer.session import FRAME_SECONDS
from modalshell.viewer.stage import demand_opengl
from modalshell.viewer.web import BrowserPage, check_page


class AttachedWindow(ShellWindow):
    """A run's newest frame, with a line of text.

    Parameters
    ----------
    run : RunFollower
        The run, which has at least one frame.
    off_screen : bool
        Draw into memory, for pictures of the window.
    """

    def __init__(self, run: RunFollower, *, off_screen: bool = False) -> None:
        super().__init__(run, run.name, "q: quit", off_screen=off_screen)
        self._run = run

    def _advance(self) -> bool:
        return self._run.poll()


class AttachedPage(BrowserPage):
    """A run's newest frame behind a page.

    Parameters
    ----------
    run : RunFollower
        The run, which has at least one frame.
    """

    def __init__(self, run: RunFollower) -> None:
        super().__init__(run, run.name)
        self._followed = run
        self._show_status()
        with self._layouts.SinglePageLayout(self._server) as page:
            page.icon.hide()  # there is no drawer
            self._fill_content(page)

    def _do_frame(self, passed: float) -> None:  # noqa: ARG002 (time is the run's own)
        if self._followed.poll():
            self._note = ""
            self._draw()


def attach(
    run: str | os.PathLike[str],
    *,
    wait: float,
    web: bool = False,
    port: int = 0,
    screenshot: Path | None = None,
    follow: bool = False,
) -> None:
    """Show a run live, from whatever it stores, until the user has enough; it does not notice.

    OptionError if ``run`` is not a run, has no frame in time, or cannot be shown as requested.

    Parameters
    ----------
    run : path
        See :class:`~modalshell.run.RunFollower`.
    wait : float
        Longest time [s] to wait for its first frame.
    web, port
        Show it on a page at this port of this machine.
    screenshot : Path, optional
        Write a PNG file with the newest frame, and return.
    follow : bool
        Print a line for each frame and change of state instead; return when the run is finished.
    """
    if web + (screenshot is not None) + follow > 1:
        raise OptionError("--web, --screenshot and --follow are three ways to show a run: choose one")
    if web:
        check_page(port)
    elif screenshot is not None:
        screenshot = checked_path(screenshot, ".png")
        demand_opengl()
    elif not follow:
        demand_window()
    follower = RunFollower(run)
    try:
        follower.wait(wait)
        if follow:
            _print_frames(follower)
        elif web:
            AttachedPage(follower).serve(port)
        elif screenshot is None:
            AttachedWindow(follower).show()
        else:
            AttachedWindow(follower, off_screen=True).save_picture(screenshot)
            print(printable(str(screenshot)))
    finally:
        follower.close()


def _print_frames(run: RunFollower) -> None:
    print(printable(run.status()), flush=True)
    while run.state != "finished":
        time.sleep(FRAME_SECONDS)
        if run.poll():
            print(printable(run.status()), flush=True)
