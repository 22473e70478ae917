"""Self-contained web pages: a shell that moves in a browser, without a server, a network or a library."""

from modalshell.page.clip_page import clip_page
from modalshell.page.html import Page
from modalshell.page.modal_page import modal_page

__all__ = ["Page", "clip_page", "modal_page"]
