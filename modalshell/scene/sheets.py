"""``[material]`` of a ``kind``: sheets of shell theory that are not isotropic."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from msgspec import Meta

from modalshell.scene.tables import PhysicalSheet, Positive, Stiffnesses, Table, Vector
from modalshell.shell import Fabric, Orthotropic
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


def _parameters(table: SheetTable) -> dict[str, Any]:
    return {name: getattr(table, name) for name in table.__struct_fields__ if name != "kind"}


MaterialTable = Stiffnesses | PhysicalSheet | SheetTable
"""What ``[material]`` may be."""
SHEET_TABLES: dict[str, type[SheetTable]] = {"orthotropic": OrthotropicTable, "fabric": FabricTable}
"""Tables of sheets by their kind."""
