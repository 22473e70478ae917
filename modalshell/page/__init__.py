"""Self-contained web pages: a shell that moves in a browser, without a server, a network or a library."""

from modalshell.page.clip_page import clip_page
from modalshell.page.flock_page import flock_page
from modalshell.page.html import Page
from modalshell.page.modal_page import ReducedWarp, modal_page
from modalshell.page.sheet_page import sheet_page

__all__ = ["Page", "ReducedWarp", "clip_page", "flock_page", "modal_page", "sheet_page"]
