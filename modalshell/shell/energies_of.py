"""The elastic energy of a mesh, a material and its supports, and its derivative by a constant of the material."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from modalshell.checks import checked_kind
from modalshell.errors import OptionError
from modalshell.mesh import TriangleMesh
from modalshell.shell.elastic_energy import ElasticEnergy
from modalshell.shell.elements import ElementSum, Energy, element_sets
from modalshell.shell.isotropic import Isotropic
from modalshell.shell.material import Material
from modalshell.shell.slopes import HeldSlopes
from modalshell.shell.split_fold_energy import SplitFoldEnergy
from modalshell.typing import Array

_STEP = 1e-3
"""Relative change of a constant: most enter as polynomials, for which differences of fourth order are exact."""
_CENTRAL = ((-2, 1.0 / 12.0), (-1, -2.0 / 3.0), (1, 2.0 / 3.0), (2, -1.0 / 12.0))
_FORWARD = ((0, -25.0 / 12.0), (1, 4.0), (2, -3.0), (3, 4.0 / 3.0), (4, -0.25))
"""At a constant of zero, below which none may lie."""


def energy_of(
    mesh: TriangleMesh,
    material: Material | Isotropic,
    slopes: HeldSlopes,
    energies: Sequence[Energy],
    held: NDArray[np.bool_],
) -> ElasticEnergy:
    """Elastic energy of a material on a mesh, with further ``energies``."""
    further = [
        checked_kind("each of energies", energy, Energy).elements(mesh)  # type: ignore[type-abstract]
        for energy in energies
    ]
    if isinstance(material, Isotropic):
        return SplitFoldEnergy(mesh, material, slopes, further, held)
    return ElementSum([*element_sets(mesh, material, held, slopes), *further], len(mesh.vertices))


def material_constants(material: Material | Isotropic) -> dict[str, float]:
    """The constants of a material that are one number, by name."""
    values = {field.name: getattr(material, field.name) for field in fields(material)}
    return {name: float(value) for name, value in values.items() if isinstance(value, float)}


def gradient_by_constant(
    mesh: TriangleMesh,
    material: Material | Isotropic,
    slopes: HeldSlopes,
    held: NDArray[np.bool_],
    name: str,
    x: Array,
) -> Array:
    """Derivative (n, 3) of the energy's gradient at ``x`` (n, 3) by the constant ``name``.

    Stretch, shear, flexure and Young's modulus enter linearly, the thickness by powers up to three: differences of
    fourth order over a thousandth of the constant have no error of their own there, and none that is seen for
    Poisson's ratio.

    Raises
    ------
    OptionError
        For a name that is no constant, or one that varies over the mesh.
    """
    known = material_constants(material)
    if name not in known:
        raise OptionError(f"wrt must be one of {', '.join(known)}, one number for the whole mesh (got {name!r})")
    zero = known[name] == 0.0 and name != "poisson"
    step = _STEP * (abs(known[name]) or 1.0)
    total = np.zeros_like(x)
    for count, weight in _FORWARD if zero else _CENTRAL:
        changed: Material | Isotropic = replace(material, **{name: known[name] + count * step})  # type: ignore[arg-type]
        total += weight / step * energy_of(mesh, changed, slopes, (), held).energy_gradient(x)[1]
    return total
