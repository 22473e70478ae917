"""``[material]`` of a ``kind``: sheets of shell theory that are not isotropic."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any, Literal

from msgspec import Meta

from modalshell.core.checks import shown
from modalshell.core.errors import MaterialError
from modalshell.core.units import LENGTHS, MASSES, TIMES
from modalshell.scene.tables import PhysicalSheet, Positive, Stiffnesses, Table, Units, Vector
from modalshell.shell import Fabric, Isotropic, Laminate, Orthotropic, Ply, card
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


class PlyTable(Table, frozen=True, kw_only=True):
    """A ply of a laminate: its moduli as of an orthotropic sheet, ``angle`` [deg] and ``thickness`` [m].

    One ``young`` in place of two, without ``shear``, is the same in all directions.
    """

    young: float | tuple[Positive, Positive]  # msgspec 0.22 crashes on a bounded number or a tuple; Isotropic checks it
    shear: Positive | None = None
    poisson: Annotated[float, Meta(gt=-100.0, lt=100.0)]
    density: Positive
    angle: float = 0.0
    thickness: Positive

    def ply(self, place: str) -> Ply:
        """The ply; MaterialError that names its ``place`` where shear is missing or too much."""
        one = not isinstance(self.young, tuple)
        if one != (self.shear is None):
            raise MaterialError(
                f"{place} must have young = [E1, E2] and a shear modulus, or one young alone "
                f"(got young = {shown(self.young)}, shear = {shown(self.shear)})"
            )
        table = _parameters(self, "angle")
        if one:
            del table["shear"]
        return Ply(Isotropic(**table) if one else Orthotropic(**table), self.angle, self.thickness)


class LaminateTable(SheetTable, frozen=True):
    """``[material]`` of ``kind = "laminate"``: ``plies`` from the bottom to the top, and ``direction`` of axis 1."""

    kind: Literal["laminate"]
    plies: Annotated[list[PlyTable], Meta(min_length=1)]
    direction: _Direction = 0.0

    def sheet(self) -> Laminate:
        """The sheet."""
        return Laminate([ply.ply(f"plies[{index}]") for index, ply in enumerate(self.plies)], self.direction)


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


_THICKEST = 0.2
"""Thickness, as a share of the size, above which a body is no sheet."""
_DENSITIES = (1.0, 3e4)
"""Densities of solids [kg/m^3], from aerogel to above osmium."""
_STIFFEST = 2e12
"""Young's modulus [Pa] above diamond's."""
_SOFTEST = 1e3
"""Young's modulus [Pa] below jelly's."""


def odd_values(material: MaterialTable, units: Units, size: float) -> list[str]:
    """Message about implausible values of a material on a mesh of ``size``; values from files are not checked."""
    if not isinstance(material, PhysicalSheet):
        return []
    length, mass, time = LENGTHS[units.length], MASSES[units.mass], TIMES[units.time]
    remarks = []
    thickness, density, young = material.thickness, material.density, material.young
    if isinstance(thickness, float | int) and thickness > _THICKEST * size:
        remarks.append(
            f"material.thickness: {thickness:g} {units.length} is over a fifth of the mesh's size, {size:g} "
            f"{units.length}: too thick for a sheet, or of other units than the mesh"
        )
    if isinstance(density, float | int) and not _DENSITIES[0] <= (real := density * mass / length**3) <= _DENSITIES[1]:
        given = _in_si(density, f"{units.mass}/{units.length}^3", real, "kg/m^3")
        remarks.append(f"material.density: {given}, which no sheet has (water: 1000 kg/m^3): check [units]")
    if isinstance(young, float | int):
        real = young * mass / (length * time**2)
        given = f"material.young: {_in_si(young, f'{units.mass}/({units.length} {units.time}^2)', real, 'Pa')}"
        if real > _STIFFEST:
            remarks.append(f"{given}, stiffer than diamond: check [units]")
        if real < _SOFTEST:
            remarks.append(f"{given}, softer than jelly: check [units] (210 GPa are 210e9 Pa)")
    return remarks


def _in_si(value: float, unit: str, real: float, si: str) -> str:
    """A value in its unit and in that of SI, which is ``real``; once where these are the same."""
    return f"{value:g} {si}" if real == value else f"{value:g} {unit} is {real:.3g} {si}"
