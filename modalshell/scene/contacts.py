"""``[[contacts]]`` of a scene: a collider by its kind, the vertices that may touch it, and its path."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from modalshell.contact import COLLIDERS, Contact, SelfContact
from modalshell.core.errors import OptionError, SceneError
from modalshell.scene import tables
from modalshell.scene.read import checked_table, chosen
from modalshell.scene.signatures import Built, signature_table
from modalshell.supports import SupportPath


class ContactPath(tables.Table, frozen=True):
    """``path`` of ``[[contacts]]``: keyframes along which the collider moves."""

    times: tables.Times
    translations: tables.Keyframes | None = None
    rotations: tables.Keyframes | None = None
    pivot: tables.Vector | None = None


class ContactTable(Built, frozen=True):
    """A table of ``[[contacts]]``: the collider's own keys, and those of :class:`modalshell.Contact`.

    ``path`` moves the collider as that of supports moves these: ``times`` [s] with ``translations`` [m] or
    ``rotations`` [rad], about ``pivot``.
    """

    sel: tables.Selection = "all"
    friction: float = 0.0
    restitution: float = 0.0
    push_out: float = 0.0
    path: ContactPath | None = None

    def contact(self) -> Contact:
        """The contact."""
        return Contact(
            self.build(), self.sel, self.friction, self.restitution, _motion(self.path), push_out=self.push_out
        )


class SelfContactTable(Built, frozen=True):
    """A table of ``[[contacts]]`` with ``kind = "self"``: the keys of :class:`modalshell.SelfContact`."""

    @property
    def path(self) -> None:
        """None: it moves with the shell."""

    def contact(self) -> SelfContact:
        """The contact."""
        made: SelfContact = self.build()
        return made


def _motion(table: ContactPath | None) -> SupportPath | None:
    if table is None:
        return None
    if table.translations is None and table.rotations is None:
        raise OptionError("path needs translations or rotations, one entry for each of times")
    still = np.zeros((len(table.times), 3))
    moved = still if table.translations is None else table.translations
    return SupportPath(table.times, moved, table.rotations, pivot=table.pivot or (0.0, 0.0, 0.0))


def collider_tables() -> dict[str, type[Any]]:
    """The tables of ``[[contacts]]`` by the kinds of their colliders."""
    kinds = {key: signature_table(kind, ContactTable, tag_field="kind", tag=key) for key, kind in COLLIDERS.items()}
    own = signature_table(SelfContact, SelfContactTable, tag_field="kind", tag=SelfContact.key)
    return kinds | {SelfContact.key: own}


def contact_tables(file: Path, raw: Any) -> tuple[ContactTable | SelfContactTable, ...]:
    """The tables of ``[[contacts]]``; SceneError where one is refused."""
    if not isinstance(raw, list):
        raise SceneError(f"{file}: contacts: must be a list of tables, [[contacts]] (got {raw!r:.60})")
    kinds, made = collider_tables(), []
    for index, entry in enumerate(raw):
        path = f"contacts[{index}]"
        made.append(checked_table(file, path, entry, chosen(file, path, entry, "kind", kinds)))
    return tuple(made)
