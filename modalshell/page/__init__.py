"""Self-contained web pages that simulate a shell in the browser, without a server or a network."""

from modalshell.page.clip_page import clip_page
from modalshell.page.flock_page import flock_page
from modalshell.page.html import Page
from modalshell.page.modal_page import modal_page
from modalshell.page.sheet_page import sheet_page

__all__ = ["Page", "clip_page", "flock_page", "modal_page", "sheet_page"]
