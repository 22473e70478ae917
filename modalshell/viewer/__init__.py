"""Scenes on screen: a session that a window or a browser page drives, and runs of other processes, followed live."""

from modalshell.viewer.attached import attach
from modalshell.viewer.desktop import open_window, take_picture
from modalshell.viewer.session import ViewSession
from modalshell.viewer.web import serve_page

__all__ = ["ViewSession", "attach", "open_window", "serve_page", "take_picture"]
