"""``[material]`` of a ``kind``: sheets of shell theory that are not isotropic."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any, Literal

from msgspec import Meta

from modalshell.core.errors import MaterialError
from modalshell.scene.tables import PhysicalSheet, Positive, Stiffnesses, Table, Vector
from modalshell.shell import Fabric, Laminate, Orthotropic, Ply, card
from modalshell.shell.sheet import Sheet

_Direction = float | Vector
"""An angle [deg] from the projection of the x axis, or a vector."""
_Constants = Annotated[list[float], Meta(min_length=3, max_length=4)]
"""Three numbers, or four with a coupling."""


class SheetTable(Table, frozen=True):
    """A table whose keys are the parameters of a sheet's class."""

    def sheet(self) -> Sheet:
        """The sheet; MaterialError for numbers that it does not take."""
        raise NotImplementedError


class OrthotropicTable(SheetTable, frozen=True):
    """``[material]`` of ``kind = "orthotropic"``: see :class:`modalshell.Orthotropic`.

    ``young`` along axis 1 and 2 [Pa], ``shear`` modulus [Pa], ``poisson`` nu12, ``thickness`` [m], ``density`` per
    volume [kg/m^3], ``direction`` of axis 1.
    """

    kind: Literal["orthotropic"]
    young: tuple[Positive, Positive]
    shear: Positive
    poisson: Annotated[float, Meta(gt=-100.0, lt=100.0)]
    thickness: Positive
    density: Positive
    direction: _Direction = 0.0

    def sheet(self) -> Orthotropic:
        """The sheet."""
        return Orthotropic(**_parameters(self))


class FabricTable(SheetTable, frozen=True):
    """``[material]`` of ``kind = "fabric"``: see :class:`modalshell.Fabric`.

    ``stretch`` C1, C2, G and perhaps C12 [N/m], ``bending`` B1, B2, B12 and perhaps the coupling [N m], ``density`` per
    area [kg/m^2], ``direction`` of the warp.
    """

    kind: Literal["fabric"]
    stretch: _Constants
    bending: _Constants
    density: Positive
    direction: _Direction = 0.0

    def sheet(self) -> Fabric:
        """The sheet."""
        return Fabric(**_parameters(self))


class PlyTable(Table, frozen=True):
    """A ply of a laminate: its moduli as of an orthotropic sheet, ``angle`` [deg] and ``thickness`` [m]."""

    young: tuple[Positive, Positive]
    shear: Positive
    poisson: Annotated[float, Meta(gt=-100.0, lt=100.0)]
    density: Positive
    angle: float
    thickness: Positive


class LaminateTable(SheetTable, frozen=True):
    """``[material]`` of ``kind = "laminate"``: ``plies`` from the bottom to the top, and ``direction`` of axis 1."""

    kind: Literal["laminate"]
    plies: Annotated[list[PlyTable], Meta(min_length=1)]
    direction: _Direction = 0.0

    def sheet(self) -> Laminate:
        """The sheet."""
        own = [Orthotropic(**_parameters(ply, "angle")) for ply in self.plies]
        plies = [Ply(material, ply.angle, ply.thickness) for material, ply in zip(own, self.plies, strict=True)]
        return Laminate(plies, self.direction)


class CardTable(SheetTable, frozen=True):
    """``[material]`` of ``kind = "card"``: a sheet with measured constants by its ``name``, see ``modalshell cards``.

    Its axis 1 along ``direction``; a card is in SI units, and so must be the scene.
    """

    kind: Literal["card"]
    name: str
    direction: _Direction | None = None

    def sheet(self) -> Sheet:
        """The sheet."""
        sheet = card(self.name)
        if self.direction is None:
            return sheet
        if not isinstance(sheet, Fabric):
            raise MaterialError(f"direction must be left out of card {self.name!r}, the same in all directions")
        return replace(sheet, direction=self.direction).sourced(sheet.source)


def _parameters(table: Table, without: str = "kind") -> dict[str, Any]:
    return {name: getattr(table, name) for name in table.__struct_fields__ if name != without}


MaterialTable = Stiffnesses | PhysicalSheet | SheetTable
"""What ``[material]`` may be."""
SHEET_TABLES: dict[str, type[SheetTable]] = {
    "orthotropic": OrthotropicTable,
    "fabric": FabricTable,
    "laminate": LaminateTable,
    "card": CardTable,
}
"""Tables of sheets by their kind."""
