"""Desktop window of the viewer: PyVista's sliders and keys around a session."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Any

from modalshell.core.checks import checked_count
from modalshell.core.errors import OptionError
from modalshell.models.registry import models
from modalshell.render.backend import opens_windows
from modalshell.render.content import checked_path
from modalshell.scene import Scene
from modalshell.viewer.session import FRAME_SECONDS, ViewSession
from modalshell.viewer.stage import Shown, Stage, demand_opengl

_HELP = "space: play or pause   m: next model   n: restart from rest   q: quit"


class ShellWindow(ABC):
    """A stage with a line of text, redrawn by a timer.

    ``name`` is the scene's, and ``keys`` says what the keys do. With ``off_screen`` it is drawn into memory, for
    pictures of the window.
    """

    def __init__(self, shown: Shown, name: str, keys: str, *, off_screen: bool) -> None:
        self._shown, self._name = shown, name
        self._stage = Stage(shown, off_screen=off_screen)
        self._status: Any = self._stage.plotter.add_text(shown.status(), position="upper_left", font_size=10)
        self._stage.plotter.add_text(keys, position="lower_left", font_size=8, color="#404040")

    def draw(self) -> None:
        """Draw it as it is now."""
        self._stage.refresh()
        self._status.set_text("upper_left", self._shown.status())
        self._stage.plotter.render()

    @abstractmethod
    def _advance(self) -> bool:
        """Bring what is shown up to date; whether there is anything new."""

    def _on_timer(self, *_: object) -> None:
        if self._advance():
            self.draw()

    def show(self) -> None:
        """Open the window; returns when the user closes it."""
        plotter = self._stage.plotter
        plotter.show(interactive=False, auto_close=False, title=f"modalshell {self._name}")
        plotter.iren.add_observer("TimerEvent", self._on_timer)
        plotter.iren.create_timer(round(1e3 * FRAME_SECONDS))
        plotter.iren.start()
        self._stage.close()

    def save_picture(self, path: Path) -> None:
        """Write the window's picture to a PNG file, and close."""
        self._stage.save_picture(path)


class DesktopViewer(ShellWindow):
    """A session under sliders, keys and a timer; with ``off_screen`` it is drawn into memory, for pictures."""

    def __init__(self, session: ViewSession, *, off_screen: bool = False) -> None:
        super().__init__(session, session.scene.name, _HELP, off_screen=off_screen)
        self._session = session
        self._last = time.perf_counter()
        plotter = self._stage.plotter
        self._names = list(models())
        limit, unit = session.gravity_limit, session.units.of("m/s^2")
        for axis, letter in enumerate("xyz"):
            value = float(session.gravity[axis])
            self._slider(self._pull(axis), (-limit, limit), value, f"gravity {letter} [{unit}]", axis, "%.3g")
        span = (1.0, float(session.mode_limit))
        self._modes_slider = self._slider(
            lambda value: self._switch(session.name, round(value)), span, session.modes, "modes", 3, "%.0f", event="end"
        )
        keys = {spec.name: key for key, spec in models().items()}
        self._model_slider = plotter.add_text_slider_widget(
            lambda label: self._switch(keys[label], session.modes),
            list(keys),
            value=self._names.index(session.name),
            pointa=(0.83, 0.12),
            pointb=(0.98, 0.12),
            interaction_event="end",
            style="modern",
        )
        plotter.add_key_event("space", session.toggle)
        plotter.add_key_event("m", self._next_model)
        plotter.add_key_event("n", session.reset)

    def _slider(
        self,
        callback: Callable[[float], None],
        span: tuple[float, float],
        value: float,
        title: str,
        row: int,
        digits: str,
        event: str = "always",
    ) -> Any:
        height = 0.84 - 0.14 * row
        return self._stage.plotter.add_slider_widget(
            callback,
            span,
            value=value,
            title=title,
            pointa=(0.83, height),
            pointb=(0.98, height),
            interaction_event=event,
            fmt=digits,
            title_height=0.02,
            style="modern",
        )

    def _pull(self, axis: int) -> Callable[[float], None]:
        def pull(value: float) -> None:
            gravity = self._session.gravity.copy()
            gravity[axis] = value
            self._session.set_gravity(gravity)

        return pull

    def _next_model(self) -> None:
        following = (self._names.index(self._session.name) + 1) % len(self._names)
        self._switch(self._names[following], self._session.modes)

    def _switch(self, name: str, modes: int) -> None:
        session = self._session
        if not session.choose(name, modes):
            return  # sliders call back when they are made, too
        # A key moves no slider, and a refused choice leaves one where it must not stay.
        self._modes_slider.GetRepresentation().SetValue(session.modes)
        chosen = self._model_slider.GetRepresentation()
        chosen.SetValue(self._names.index(session.name))
        chosen.SetTitleText(session.name.upper())

    def _advance(self) -> bool:
        now = time.perf_counter()
        passed, self._last = now - self._last, now
        self._session.keep_pace(passed)
        return True

    def show(self) -> None:
        """Play in a window; returns when the user closes it."""
        self._session.play()
        super().show()


def demand_window() -> None:
    """Raise OptionError where no window can be opened."""
    if not opens_windows():
        raise OptionError(
            "no window opens here: there is no display, or no OpenGL on it; take --web for a page in a browser, or "
            "--screenshot FILE.png for a picture"
        )


def open_window(scene: Scene) -> None:
    """Show a scene until the user closes the window; OptionError where no window can be opened."""
    demand_window()
    DesktopViewer(ViewSession(scene)).show()


def take_picture(scene: Scene, frames: int, path: Path) -> Path:
    """Play ``frames`` off-screen, each of 1/30 s of simulated time, and save the window as a PNG file."""
    checked_count("frames", frames)
    target = checked_path(path, ".png")
    demand_opengl()
    session = ViewSession(scene)
    viewer = DesktopViewer(session, off_screen=True)
    session.play()
    for _ in range(frames):
        session.advance(FRAME_SECONDS)
    viewer.draw()
    viewer.save_picture(target)
    return target
