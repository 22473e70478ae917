"""Derivatives of the hybrid rung's reduced energy: exact ones that its own Newton steps do without."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from modalshell.core.errors import OptionError
from modalshell.core.typing import Array
from modalshell.models.hybrid.assumed_stress import ReducedStress, elastic_stresses
from modalshell.models.hybrid.assumed_stress_step import evaluate
from modalshell.shell import Shell
from modalshell.shell.energies_of import material_constants

_STEP = 1e-4
_FOURTH_ORDER = ((-2, 1.0 / 12.0), (-1, -2.0 / 3.0), (1, 2.0 / 3.0), (2, -1.0 / 12.0))


def differences(function: Callable[[Array], Array], z: Array) -> Array:
    """Derivatives (k, m) of a function (k,) of coordinates (m,), by differences of fourth order."""
    step = _STEP * (float(np.abs(z).max()) or 1.0)
    units = step * np.eye(z.size)
    columns = [sum(w / step * function(z + k * unit) for k, w in _FOURTH_ORDER) for unit in units]
    return np.stack([np.asarray(column) for column in columns], axis=1)


def forces_by_constants(
    shell: Shell, reduced: ReducedStress, stresses: Array, basis: Array, z: Array
) -> Callable[[str], Array]:
    """Derivatives (m,) of minus the energy's gradient at z by the constants of a coarse shell that are one number.

    The span of the ``stresses`` (T + E, K) and the ``basis`` (3k, m) stay as trained.
    """
    known = material_constants(shell.material)
    shear, columns = shell.elements[1], basis.reshape(-1, 3, z.size)
    first, second = shear.stencils.T
    x = shell.rest_positions + columns @ z
    arms = x[second] - x[first]
    strains = (np.sum(arms**2, axis=1) - shear.rest**2) / (2.0 * shear.rest)
    slopes = np.einsum("ex,exm->em", arms / shear.rest[:, None], columns[second] - columns[first])

    def membrane_force(factors: Array) -> Array:
        stretch, edges, hinges = factors.tolist()
        along = elastic_stresses(shell, stresses, (stretch, edges, hinges))
        return np.asarray(-(slopes.T @ along) @ (along.T @ strains))

    found = dict(zip(("stretch", "shear", "flexure"), differences(membrane_force, np.ones(3)).T, strict=True))
    stiffer = reduced._replace(flat=2.0 * reduced.flat, roots=np.sqrt(2.0) * reduced.roots)
    found["flexure"] = found["flexure"] + _gradient(reduced, z) - _gradient(stiffer, z)

    def by_constant(name: str) -> Array:
        if not known.get(name) or name not in found:
            raise OptionError(f"the coarse shell has no one {name} above 0 for its whole mesh: take DS")
        return found[name] / known[name]

    return by_constant


def _gradient(reduced: ReducedStress, z: Array) -> Array:
    modes = reduced.membrane.linear.shape[1]
    strains = evaluate(reduced, z, np.zeros(modes))[1]
    return np.asarray(evaluate(reduced, z, strains[:modes])[3])
