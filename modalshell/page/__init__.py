"""Self-contained web pages: a modal model that moves in a browser, without a server, a network or a library."""

from modalshell.page.modal_page import Page, modal_page

__all__ = ["Page", "modal_page"]
