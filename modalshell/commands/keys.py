"""The command on the keys of scene files."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter
from rich.markup import escape

from modalshell.commands.terminal import CONSOLE
from modalshell.scene.keys import scene_keys


def keys(
    table: Annotated[str | None, Parameter(help="One table, such as contacts, material, supports or loads.")] = None, /
) -> None:
    """List the tables of a scene file with their keys: what each takes, its default and its unit.

    Example: modalshell keys contacts
    """
    for one in scene_keys(table):
        CONSOLE.print(f"[bold]{escape(one.heading)}[/bold]")
        if one.about:
            CONSOLE.print(f"  {escape(one.about)}")
        for key in one.keys:
            default = f" = {key.default}" if key.default not in ("", "required") else ""
            needed = ", required" if key.default == "required" else ""
            about = f": {key.about}" if key.about else ""
            CONSOLE.print(escape(f"    {key.name}{default} ({key.takes}{needed}){about}"), highlight=False)
        CONSOLE.print()
