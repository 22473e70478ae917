"""Self-contained web pages that show a shell moving in the browser, live or as recorded, without a server."""

from modalshell.page.html import Page
from modalshell.page.modal_page import live_model, modal_page
from modalshell.page.shell_page import farthest, recorded, shell_page

__all__ = ["Page", "farthest", "live_model", "modal_page", "recorded", "shell_page"]
