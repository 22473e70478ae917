"""Self-contained web pages that simulate a shell in the browser, without a server or a network."""

from modalshell.page.clip_page import clip_page
from modalshell.page.html import Page
from modalshell.page.modal_page import modal_page

__all__ = ["Page", "clip_page", "modal_page"]
