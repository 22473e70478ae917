"""Commands that list what scenes may name: cards, sheets with measured constants, and the keys of their files."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter
from rich.markup import escape
from rich.table import Column, Table

import modalshell as ms
from modalshell.commands.terminal import CONSOLE, say
from modalshell.scene.keys import scene_keys
from modalshell.shell.cards import CARDS
from modalshell.shell.energies_of import unit_of_constant


def cards(
    name: Annotated[str | None, Parameter(help="One card, with its constants and measurements.")] = None, /
) -> None:
    """List sheets with measured constants: mass per area, bending length, reference; or one with all that is known.

    The bending length is (B / (rho g))^(1/3): a strip hangs to 41.5 degrees at an overhang of twice as much.

    Example: modalshell cards 11oz-black-denim
    """
    if name is None:
        table = Table(
            Column("card", no_wrap=True), "what", "g/m^2", escape("length [mm]"), Column("source", no_wrap=True)
        )
        for key, card in CARDS.items():
            numbers = f"{1e3 * card.weight:.4g}", f"{1e3 * card.bending_length:.3g}"
            reference = card.source[card.source.index("[") + 1 : card.source.index("]")]
            table.add_row(key, escape(card.what), *numbers, reference)
        CONSOLE.print(table)
        first = next(iter(CARDS))
        say(f'In a scene: [material] kind = "card", name = "{first}"; in Python: ms.card("{first}")')
        return
    ms.card(name)  # which refuses another name
    card = CARDS[name]
    say(f"{name}: {card.what}", f"source: {card.source}", sep="\n")
    for constant, value in card.material.constants.items():
        say(f"  {constant} = {value:.6g} {unit_of_constant(card.material, constant)}".rstrip())
    say("compared with:")
    for one in card.measured:
        fitted = ", to which a constant was fitted" if one.fitted else ""
        say(f"  {one.what}: {one.value:.4g} {one.unit} within {100.0 * one.spread:.3g} %{fitted}")


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
