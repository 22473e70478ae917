"""Elastic energy of a mesh, a material and its supports, and its derivatives by material constants."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import fields, replace

import numpy as np

from modalshell.core.checks import checked_kind, shortened, shown
from modalshell.core.errors import ModalShellError, OptionError
from modalshell.core.typing import Array, Mask
from modalshell.mesh import TriangleMesh
from modalshell.shell.elastic_energy import ElasticEnergy
from modalshell.shell.elements import ElementSet, ElementSum, Energy, element_sets
from modalshell.shell.material import Material
from modalshell.shell.sheet import Sheet
from modalshell.shell.slopes import HeldSlopes
from modalshell.shell.split_fold_energy import SplitFoldEnergy

ANY_SIGN = ("poisson", "direction", "stretch_4", "bending_4")
"""Constants that need not be above zero: with a Poisson's ratio and an angle the couplings of a fabric."""


def checked_energies(energies: Sequence[Energy]) -> tuple[Energy, ...]:
    """Further energies as a tuple; OptionError if one is not an energy."""
    if isinstance(energies, Energy) or not isinstance(energies, Iterable):
        raise OptionError(f"energies must be a list of energies (got {shown(energies)}): write energies=[...]")
    return tuple(checked_kind("each of energies", energy, Energy) for energy in energies)  # type: ignore[type-abstract]


def energy_of(
    mesh: TriangleMesh,
    material: Material | Sheet,
    slopes: HeldSlopes,
    energies: Sequence[Energy],
    held: Mask,
) -> ElasticEnergy:
    """Elastic energy of a material on a mesh, with further ``energies``."""
    further = further_elements(energies, mesh)
    if isinstance(material, Sheet):
        return SplitFoldEnergy(mesh, material, slopes, further, held)
    return ElementSum([*element_sets(mesh, material, held, slopes), *further], len(mesh.vertices))


def further_elements(energies: Sequence[Energy], mesh: TriangleMesh) -> list[ElementSet]:
    """Elements of each of some further ``energies``."""
    return [_elements(energy, mesh) for energy in energies]


def _elements(energy: Energy, mesh: TriangleMesh) -> ElementSet:
    """Elements of a further energy; OptionError that names it where its own code fails."""
    try:
        return energy.elements(mesh)
    except ModalShellError:
        raise
    except Exception as error:  # whatever another package's code may raise
        kind = type(energy)
        raise OptionError(
            f"energy {kind.key!r} ({kind.__module__}.{kind.__name__}) failed on this mesh: {type(error).__name__}: "
            f"{shortened(str(error))}; repair its method elements"
        ) from error


def material_constants(material: Material | Sheet) -> dict[str, float]:
    """The constants of a material that are one number, by name."""
    if isinstance(material, Sheet):
        return material.constants
    values = {field.name: getattr(material, field.name) for field in fields(material)}
    return {name: float(value) for name, value in values.items() if isinstance(value, float)}


def unit_of_constant(material: Material | Sheet, name: str) -> str:
    """Unit of SI of a constant of a material; "" of one without, or of a material that is not known."""
    per_area = not hasattr(material, "thickness")
    first = {"density": "kg/m^2" if per_area else "kg/m^3", "direction": "deg", "thickness": "m", "young": "Pa"}
    first |= {"stretch": "N/m", "bending": "N m", "flexure": "N m", "shear": "N" if per_area else "Pa"}
    return first.get(name.split("_")[0], "")


def size_of_constant(material: Material | Sheet, mesh: TriangleMesh, name: str) -> float:
    """What a change of a constant of any sign is measured by: for a coupling where it leaves a strain no stiffness."""
    whole, _, place = name.rpartition("_")
    if place != "4":
        return 1.0
    assert isinstance(material, Sheet)
    first, second = getattr(material.on(mesh), whole)[:2]
    return float(np.sqrt(np.min(np.multiply(first, second))))


def with_constants(material: Material | Sheet, values: dict[str, float]) -> Material | Sheet:
    """The material with other values of some constants, by name."""
    return material.with_constants(values) if isinstance(material, Sheet) else replace(material, **values)  # type: ignore[arg-type]


def gradient_by_constant(
    energy: ElasticEnergy,
    mesh: TriangleMesh,
    material: Material | Sheet,
    slopes: HeldSlopes,
    held: Mask,
    name: str,
    x: Array,
    step: Array | None = None,
) -> Array:
    """Derivative (n, 3) of the energy's gradient at ``x`` (n, 3) by the constant ``name``.

    With a ``step`` (n, 3), of the Hessian's first part times the step, which at rest is the whole of it. OptionError
    for a name that is no constant, or one that varies over the mesh.
    """
    known = material_constants(material)
    if name not in known:
        raise OptionError(f"wrt must be one of {', '.join(known)}, one number for the whole mesh (got {name!r})")
    if isinstance(energy, SplitFoldEnergy):
        found = energy.gradient_by_constant(name, x, step)
        if name == "thickness" and step is None:
            found = found + energy.gradient_by_thickness_at_rest(x, known[name])
        return found
    if name == "density":
        return np.zeros_like(x)
    # Linear in each stiffness, and far cheaper to make than one Hessian.
    only: dict[str, float] = {"stretch": 0.0, "shear": 0.0, "flexure": 0.0, name: 1.0}
    assert isinstance(material, Material)
    unit = energy_of(mesh, replace(material, **only), slopes, (), held)  # type: ignore[arg-type]
    return unit.energy_gradient(x)[1] if step is None else -unit.damping_force(x, step, 1.0)
