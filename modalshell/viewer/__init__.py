"""Scenes on screen: a session that a window or a browser page drives, and the two of them."""

from modalshell.viewer.desktop import open_window, take_picture
from modalshell.viewer.session import ViewSession
from modalshell.viewer.web import serve_page

__all__ = ["ViewSession", "open_window", "serve_page", "take_picture"]
