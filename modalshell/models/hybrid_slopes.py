"""Derivatives of the hybrid rung's reduced energy: exact ones that its own Newton steps do without."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from modalshell.errors import OptionError
from modalshell.reduction.assumed_stress import Quadratic, ReducedStress
from modalshell.reduction.assumed_stress_step import evaluate
from modalshell.shell import Shell
from modalshell.shell.energies_of import material_constants
from modalshell.typing import Array

_STEP = 1e-4
_FOURTH_ORDER = ((-2, 1.0 / 12.0), (-1, -2.0 / 3.0), (1, 2.0 / 3.0), (2, -1.0 / 12.0))


def differences(function: Callable[[Array], Array], z: Array) -> Array:
    """Derivatives (k, m) of a function (k,) of coordinates (m,), by differences of fourth order."""
    step = _STEP * (float(np.abs(z).max()) or 1.0)
    units = step * np.eye(z.size)
    columns = [sum(w / step * function(z + k * unit) for k, w in _FOURTH_ORDER) for unit in units]
    return np.stack([np.asarray(column) for column in columns], axis=1)


def forces_by_constants(shell: Shell, reduced: ReducedStress, stresses: Array, z: Array) -> Callable[[str], Array]:
    """Derivatives (m,) of minus the energy's gradient at z by the constants of a coarse shell that are one number.

    The membrane's energy is ``d . A^-1 d / 2`` with the complementary energy ``A_kl = sum_e s_ek s_el / (2 w_e)``, the
    identity as it was trained: by a stiffness it changes by the share of A that is that stiffness's.
    """
    known = material_constants(shell.material)
    measures, slopes = _measures(reduced.membrane, z)
    found, first = {}, 0
    for name, elements in zip(("stretch", "shear"), shell.elements[:2], strict=True):
        own = stresses[first : first + elements.weight.size]
        first += elements.weight.size
        inverse = np.divide(0.5, elements.weight, out=np.zeros(elements.weight.size), where=elements.weight > 0.0)
        if known.get(name):
            found[name] = -slopes.T @ (own.T @ (inverse * (own @ measures))) / known[name]
    if known.get("flexure"):
        stiffer = reduced._replace(flat=2.0 * reduced.flat, roots=np.sqrt(2.0) * reduced.roots)
        found["flexure"] = (_gradient(reduced, z) - _gradient(stiffer, z)) / known["flexure"]

    def by_constant(name: str) -> Array:
        if name not in found:
            raise OptionError(f"the coarse shell has no one {name} above 0 for its whole mesh: take DS")
        return found[name]

    return by_constant


def _measures(quadratic: Quadratic, z: Array) -> tuple[Array, Array]:
    """Values (K,) and slopes (K, m) of quadratic forms."""
    size = z.size
    rows, columns = np.tril_indices(size)
    full = np.zeros((size, size, quadratic.linear.shape[1]))
    full[rows, columns] = full[columns, rows] = quadratic.pairs
    bent = np.tensordot(z, full, 1)
    return z @ (quadratic.linear + 0.5 * bent), (quadratic.linear + bent).T


def _gradient(reduced: ReducedStress, z: Array) -> Array:
    modes = reduced.membrane.linear.shape[1]
    strains = evaluate(reduced, z, np.zeros(modes))[1]
    return np.asarray(evaluate(reduced, z, strains[:modes])[3])
