"""``[[contacts]]`` of a scene: a collider by its kind, the vertices that may touch it, and its path."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from modalshell.contact import COLLIDERS, Collider, Contact, MeshCollider, SelfContact
from modalshell.scene import tables
from modalshell.scene.parts import build_mesh, mesh_digest, moved_path
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

    def collider(self, folder: Path, metres: float) -> Collider:  # noqa: ARG002 (of colliders from files)
        """The collider, of files in a ``folder``; ``metres`` is the unit of length [m]."""
        made: Collider = self.build()
        return made

    def contact(self, folder: Path, metres: float) -> Contact:
        """The contact, of files in a ``folder``; ``metres`` is the unit of length [m]."""
        path, body = None if self.path is None else moved_path(self.path, "path needs"), self.collider(folder, metres)
        return Contact(body, self.sel, self.friction, self.restitution, path, push_out=self.push_out)

    def content(self, folder: Path) -> dict[str, Any]:  # noqa: ARG002 (of colliders from files)
        """All input, of files in a ``folder``, too."""
        return self.plain()


class MeshContactTable(ContactTable, frozen=True, tag_field="kind", tag=MeshCollider.key, kw_only=True):
    """A rigid body whose surface is a closed triangle mesh, its normals outward, from a file as that of ``[mesh]``.

    Facets meet in edges, at which a shell's vertices find no smooth surface: a fine mesh converges better.
    """

    file: str
    up: Literal["x", "y", "z"] | None = None
    """Axis of the file that points up and is rotated to z; by default y for glTF, else z."""

    def build(self) -> Collider:
        """The collider of a file in the working folder."""
        return self.collider(Path(), 1.0)

    def collider(self, folder: Path, metres: float) -> Collider:
        """See :meth:`ContactTable.collider`."""
        return MeshCollider(build_mesh(tables.MeshFile(file=self.file, up=self.up), folder, metres))

    def content(self, folder: Path) -> dict[str, Any]:
        """All input, the corners and triangles of the mesh by their SHA-256."""
        mesh = build_mesh(tables.MeshFile(file=self.file, up=self.up), folder)
        return self.plain() | {"mesh": mesh_digest(mesh)}


class SelfContactTable(Built, frozen=True):
    """A table of ``[[contacts]]`` with ``kind = "self"``: the keys of :class:`modalshell.SelfContact`."""

    @property
    def path(self) -> None:
        """None: it moves with the shell."""

    def content(self, folder: Path) -> dict[str, Any]:  # noqa: ARG002 (as those of colliders)
        """All input."""
        return self.plain()

    def contact(self, folder: Path, metres: float) -> SelfContact:  # noqa: ARG002 (as those of colliders)
        """The contact."""
        made: SelfContact = self.build()
        return made


def collider_tables() -> dict[str, type[Any]]:
    """The tables of ``[[contacts]]`` by the kinds of their colliders."""
    formed = {key: kind for key, kind in COLLIDERS.items() if key != MeshCollider.key}
    kinds = {key: signature_table(kind, ContactTable, tag_field="kind", tag=key) for key, kind in formed.items()}
    kinds[MeshCollider.key] = MeshContactTable
    own = signature_table(SelfContact, SelfContactTable, tag_field="kind", tag=SelfContact.key)
    return kinds | {SelfContact.key: own}
