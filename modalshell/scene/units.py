"""Units of a scene's numbers, and a check for implausible values."""

from __future__ import annotations

from modalshell.core.units import LENGTHS, MASSES, TIMES
from modalshell.scene.sheets import MaterialTable
from modalshell.scene.tables import PhysicalSheet, Units

_THICKEST = 0.2
"""Thickness, as a share of the size, above which a body is no sheet."""
_DENSITIES = (1.0, 3e4)
"""Densities of solids [kg/m^3], from aerogel to above osmium."""
_STIFFEST = 2e12
"""Young's modulus [Pa] above diamond's."""


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
        remarks.append(
            f"material.density: {density:g} {units.mass}/{units.length}^3 is {real:.3g} kg/m^3, which no sheet has "
            "(water: 1000 kg/m^3): check [units]"
        )
    if isinstance(young, float | int) and (real := young * mass / (length * time**2)) > _STIFFEST:
        remarks.append(
            f"material.young: {young:g} {units.mass}/({units.length} {units.time}^2) is {real:.3g} Pa, stiffer than "
            "diamond: check [units]"
        )
    return remarks
