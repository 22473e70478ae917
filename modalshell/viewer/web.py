"""Web viewer: trame serves controls and rendered pictures to browsers on this machine."""

from __future__ import annotations

import asyncio
import importlib
import time
from abc import ABC, abstractmethod
from typing import Any

from modalshell.core.errors import OptionError
from modalshell.models.registry import models
from modalshell.scene import Scene
from modalshell.viewer.guard import guard
from modalshell.viewer.session import FRAME_SECONDS, ViewSession
from modalshell.viewer.stage import Shown, Stage, demand_opengl

HOST = "127.0.0.1"
"""Loopback only, and with the secret of the printed address: whoever has both can drive the session."""

_SHORTEST_PAUSE = 0.005
"""Wall time [s] in which the server hears its browsers between two frames, at least."""
_SETTLING = 0.2
"""Delay [s] before a choice is applied, so that a moving slider does not solve a basis for each value."""
_TRAME = ("trame.app", "trame.ui.vuetify3", "trame.widgets.vuetify3", "trame.widgets.vtk")


class BrowserPage(ABC):
    """A page of a scene's ``name`` with a moving picture, rendered here, and a line of text."""

    def __init__(self, shown: Shown, name: str) -> None:
        app, self._layouts, self._vuetify, self._vtk = _import_trame()
        self._shown = shown
        self._stage = Stage(shown, off_screen=True)
        self._server: Any = app.get_server(f"modalshell {name}", client_type="vue3")
        self._state: Any = self._server.state
        self._state.trame__title = f"modalshell {name}"
        self._note = ""
        self._secret = guard(self._server, HOST)
        self._server.controller.on_server_ready.add_task(self._run)

    def serve(self, port: int) -> None:
        """Serve until interrupted."""
        self._server.controller.on_server_ready.add(self._print_address)
        self._server.start(
            host=HOST, port=port, open_browser=False, show_connection_info=False, disable_logging=True, timeout=0
        )

    def _print_address(self, **_: Any) -> None:
        print(f"http://{HOST}:{self._server.port}/?secret={self._secret} (Ctrl+C ends)", flush=True)

    def _fill_content(self, page: Any) -> None:
        page.title.set_text(self._state.trame__title)
        with page.content:
            self._view = self._vtk.VtkRemoteView(self._stage.plotter.render_window, interactive_ratio=1, id="picture")
        page.footer.clear()
        with page.footer:
            self._vuetify.VLabel("{{ status }}", id="status")

    @abstractmethod
    def _do_frame(self, passed: float) -> None:
        """Move on by the wall time [s] that has passed."""

    def _show_status(self) -> None:
        self._state.status = "; ".join(filter(None, [self._shown.status(), self._note]))

    def _draw(self) -> None:
        self._stage.refresh()
        self._view.update()
        self._show_status()

    async def _run(self, **_: Any) -> None:
        """Frame after frame; a slow frame holds the page up as it would hold up the picture."""
        last = time.perf_counter()
        while True:
            begin = time.perf_counter()
            passed, last = begin - last, begin
            with self._state:
                try:
                    self._do_frame(passed)
                except Exception as error:
                    # Nobody awaits this task: it would end without a word, and the page would stand still.
                    self._fail(f"{type(error).__name__}: {error}")
            await asyncio.sleep(max(_SHORTEST_PAUSE, FRAME_SECONDS - (time.perf_counter() - begin)))

    def _fail(self, message: str) -> None:
        self._note = message
        self._show_status()


class WebViewer(BrowserPage):
    """A session behind a page; all browsers that open it share the session."""

    def __init__(self, session: ViewSession) -> None:
        super().__init__(session, session.scene.name)
        self._session = session
        self._fill_state()
        self._build_page()
        self._state.change("gravity_x", "gravity_y", "gravity_z")(self._take_gravity)
        self._chosen: float | None = None
        self._state.change("model", "modes")(self._note_choice)
        self._begun = False
        self._server.controller.on_client_connected.add(self._begin)

    def _begin(self, **_: Any) -> None:
        """Play from the moment at which the first browser looks."""
        if not self._begun:
            self._begun = True
            self._session.play()
            with self._state:
                self._show_status()

    def _fill_state(self) -> None:
        session = self._session
        self._state.model, self._state.modes = session.name, session.modes
        for letter, value in zip("xyz", session.gravity.tolist(), strict=True):
            self._state[f"gravity_{letter}"] = value
        self._show_status()

    def _show_status(self) -> None:
        self._state.playing = self._session.playing
        super()._show_status()

    def _build_page(self) -> None:
        session, limit, vuetify = self._session, self._session.gravity_limit, self._vuetify
        unit = session.units.of("m/s^2").replace("^2", "²")
        with self._layouts.SinglePageWithDrawerLayout(self._server) as page:
            with page.drawer as drawer:
                drawer.width = 280
                with vuetify.VContainer():
                    with vuetify.VRow(classes="ma-1"):
                        vuetify.VBtn("{{ playing ? 'Pause' : 'Play' }}", click=self._toggle, id="play", color="primary")
                        vuetify.VSpacer()
                        vuetify.VBtn("Reset", click=self._reset, id="reset")
                    items = ("models", [{"title": spec.name, "value": key} for key, spec in models().items()])
                    vuetify.VSelect(label="Model", v_model=("model",), items=items, id="model", classes="mt-4")
                    vuetify.VLabel("Modes: {{ modes }}")
                    vuetify.VSlider(v_model=("modes",), min=1, max=session.mode_limit, step=1, id="modes")
                    for letter in "xyz":
                        name = f"gravity_{letter}"
                        vuetify.VLabel(f"Gravity {letter}: {{{{ +{name}.toPrecision(3) }}}} {unit}")
                        vuetify.VSlider(v_model=(name,), min=-limit, max=limit, step=limit / 200.0, id=name)
            self._fill_content(page)

    def _toggle(self) -> None:
        self._note = ""
        self._session.toggle()
        self._show_status()

    def _reset(self) -> None:
        self._note = ""
        self._session.reset()
        self._draw()

    def _take_gravity(self, gravity_x: float, gravity_y: float, gravity_z: float, **_: Any) -> None:
        self._session.set_gravity([float(gravity_x), float(gravity_y), float(gravity_z)])
        self._draw()

    def _note_choice(self, **_: Any) -> None:
        self._chosen = time.perf_counter()

    def _take_choice(self) -> None:
        """Apply the model and modes chosen on the page."""
        session = self._session
        if session.choose(self._state.model, round(self._state.modes)):
            self._note = ""
            self._state.model, self._state.modes = session.name, session.modes
            self._draw()

    def _fail(self, message: str) -> None:
        self._session.pause()
        super()._fail(message)

    def _do_frame(self, passed: float) -> None:
        if self._chosen is not None and time.perf_counter() - self._chosen > _SETTLING:
            self._chosen = None
            self._take_choice()
        if self._session.playing:
            self._session.keep_pace(passed)
            self._draw()


def _import_trame() -> list[Any]:
    """The parts of trame that the page uses."""
    try:
        return [importlib.import_module(name) for name in _TRAME]
    except ImportError as error:
        raise OptionError(
            f"the page needs trame, which is not installed ({error}): pip install 'modalshell[web]'"
        ) from error


def check_page(port: int) -> None:
    """Raise OptionError where no page can be served, before anything is built for it."""
    if not 0 <= port < 65536:
        raise OptionError(f"port must be from 0 to 65535 (got {port})")
    _import_trame()
    demand_opengl()


def serve_page(scene: Scene, port: int) -> None:
    """Serve a scene on this machine's own address until interrupted; port 0 takes a free one."""
    check_page(port)
    WebViewer(ViewSession(scene)).serve(port)
