"""Derivatives of the hybrid rung's reduced energy: exact ones that its own Newton steps do without."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from modalshell.core.errors import OptionError
from modalshell.core.slope import slope
from modalshell.core.typing import Array
from modalshell.models.hybrid.assumed_stress import ReducedStress
from modalshell.models.hybrid.energy_kernels import evaluate
from modalshell.models.hybrid.measures import Measures
from modalshell.shell import Isotropic
from modalshell.shell.energies_of import material_constants
from modalshell.shell.split_fold_energy import SplitFoldEnergy

STEP = 1e-4
"""Step of differences, as a share of edges and of constants."""


def differences(function: Callable[[Array], Array], z: Array, step: float) -> Array:
    """Derivatives (k, m) of a function (k,) of coordinates (m,), by differences of fourth order."""
    return np.stack([slope(function, z, unit, step) for unit in np.eye(z.size)], axis=1)


def forces_by_constants(
    measures: Measures, reduced: ReducedStress, stresses: Array, basis: Array, z: Array
) -> Callable[[str], Array]:
    """Derivatives (m,) of minus the energy's gradient at z by the constants of a coarse shell that are one number.

    The span of the ``stresses`` (e, K) and the ``basis`` (3k, m) stay as trained.
    """
    shell = measures.shell
    known = material_constants(shell.material)
    columns = basis.reshape(-1, 3, z.size)
    first, second = measures.edges.T
    rest = shell.rest_positions[second] - shell.rest_positions[first]
    moved = columns[second] - columns[first]
    arms = rest + moved @ z
    strains = 0.5 * (np.sum(arms**2, axis=1) - np.sum(rest**2, axis=1))
    slopes = np.einsum("ex,exm->em", arms, moved)

    def membrane_force(factors: Array) -> Array:
        tensions = measures.elastic_tensions(stresses, tuple(factors.tolist()))
        return np.asarray(-(slopes.T @ tensions) @ (tensions.T @ strains))

    *parts, hinges = differences(membrane_force, np.ones(3), STEP).T
    bending = reduced.bending
    root = np.sqrt(2.0)
    doubled = bending._replace(flat=2.0 * bending.flat, roots=root * bending.roots, across=root * bending.across)
    hinges = hinges + _gradient(reduced, z) - _gradient(reduced._replace(bending=doubled), z)
    if isinstance(shell.material, Isotropic):
        found = {"young": parts[0] + hinges, "thickness": parts[0] + 3.0 * hinges}
    elif isinstance(shell.elastic_energy, SplitFoldEnergy):
        found = {}
    else:
        found = {"stretch": parts[0], "shear": parts[1], "flexure": hinges}

    def by_constant(name: str) -> Array:
        if not known.get(name) or name not in found:
            names = ", ".join(found) or "no constant of this material"
            raise OptionError(
                f"the hybrid rung knows derivatives by {names}, where it is one number above 0 for the whole coarse "
                f"shell (got {name!r}): take DS"
            )
        return found[name] / known[name]

    return by_constant


def _gradient(reduced: ReducedStress, z: Array) -> Array:
    modes = reduced.membrane.modes
    strains = evaluate(reduced, z, np.zeros(modes))[1]
    return np.asarray(evaluate(reduced, z, strains[:modes])[3])
