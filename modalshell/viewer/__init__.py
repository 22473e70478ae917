"""Viewer: scenes that play in a window or on a web page, and live views of runs of other processes.

Gravity, the model and its number of modes can change while a scene plays; the shape is kept as closely as the new model
can represent it. A live view shows the newest complete frame of a run and skips frames if it is too slow; the run never
waits for it. Live views do not work under Windows; stopped runs are detected under Linux only.
"""

from modalshell.viewer.attached import attach
from modalshell.viewer.desktop import open_window, take_picture
from modalshell.viewer.session import ViewSession
from modalshell.viewer.web import serve_page

__all__ = ["ViewSession", "attach", "open_window", "serve_page", "take_picture"]
