"""``[[contacts]]`` of a scene: a collider by its kind, the vertices that may touch it, and its path."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from modalshell.contact import COLLIDERS, Contact, SelfContact
from modalshell.scene import tables
from modalshell.scene.parts import moved_path
from modalshell.scene.read import listed_tables
from modalshell.scene.signatures import Built, signature_table


class ContactTable(Built, frozen=True):
    """A table of ``[[contacts]]``: the collider's own keys, and those of :class:`modalshell.Contact`.

    ``path`` moves the collider as that of supports moves these: ``times`` [s] with ``translations`` [m] or
    ``rotations`` [rad], about ``pivot``.
    """

    sel: tables.Selection = "all"
    friction: float = 0.0
    restitution: float = 0.0
    push_out: float = 0.0
    path: tables.Moved | None = None

    def contact(self) -> Contact:
        """The contact."""
        path = None if self.path is None else moved_path(self.path, "path needs")
        return Contact(self.build(), self.sel, self.friction, self.restitution, path, push_out=self.push_out)


class SelfContactTable(Built, frozen=True):
    """A table of ``[[contacts]]`` with ``kind = "self"``: the keys of :class:`modalshell.SelfContact`."""

    @property
    def path(self) -> None:
        """None: it moves with the shell."""

    def contact(self) -> SelfContact:
        """The contact."""
        made: SelfContact = self.build()
        return made


def collider_tables() -> dict[str, type[Any]]:
    """The tables of ``[[contacts]]`` by the kinds of their colliders."""
    kinds = {key: signature_table(kind, ContactTable, tag_field="kind", tag=key) for key, kind in COLLIDERS.items()}
    own = signature_table(SelfContact, SelfContactTable, tag_field="kind", tag=SelfContact.key)
    return kinds | {SelfContact.key: own}


def contact_tables(file: Path, raw: Any) -> tuple[ContactTable | SelfContactTable, ...]:
    """The tables of ``[[contacts]]``; SceneError where one is refused."""
    return listed_tables(file, "contacts", raw, collider_tables())
