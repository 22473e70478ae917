"""Springs between pairs of particles: rest lengths, stiffness and damping."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modalshell.core.checks import LARGEST, as_array, checked_each, checked_vectors, vector_count
from modalshell.core.errors import MaterialError, MeshError
from modalshell.core.short_repr import short_repr
from modalshell.shell.elements import ElementSet
from modalshell.shell.kernels.generated import shear


@final
@short_repr
@dataclass(frozen=True, eq=False)
class Springs:
    """Linear springs, each of the energy stiffness / 2 (length - rest length)^2.

    The energy has the measure of the shell's shear, ``k_h (l - l0)^2 / l0`` with ``k_h = stiffness l0 / 2``, and is
    computed by the same generated kernel.

    Attributes
    ----------
    pairs : ndarray, shape (S, 2)
        Particles at the ends, the lower index first; no pair twice.
    rest_lengths : ndarray, shape (S,)
        [m], above zero.
    stiffness : ndarray, shape (S,)
        [N/m], not negative.
    damping : ndarray, shape (S,)
        Force along the spring over the rate of its length [N s/m], not negative.

    Raises
    ------
    MeshError
        For pairs that are no pairs, out of order, or twice there.
    MaterialError
        For numbers of the wrong shape, not finite, or out of range.
    """

    pairs: NDArray[np.int64]
    rest_lengths: NDArray[np.float64]
    stiffness: NDArray[np.float64]
    damping: NDArray[np.float64]

    def __post_init__(self) -> None:
        """Check every array and store contiguous copies that nobody can write to."""
        pairs = np.array(as_array("pairs", self.pairs, "integers of shape (S, 2)", MeshError), order="C")
        if pairs.ndim != 2 or pairs.shape[1:] != (2,) or pairs.dtype.kind not in "iu":
            raise MeshError(f"pairs must be integers of shape (S, 2) (got {pairs.dtype} of shape {pairs.shape})")
        pairs = pairs.astype(np.int64)
        unordered = np.flatnonzero((pairs[:, 0] < 0) | (pairs[:, 0] >= pairs[:, 1]))
        if len(unordered):
            raise MeshError(f"the lower index comes first in a pair (got {pairs[unordered[0]]} at {unordered[0]})")
        unique, counts = np.unique(pairs, axis=0, return_counts=True)
        if (counts > 1).any():
            raise MeshError(
                f"a pair holds one spring (got {unique[counts > 1][0]} {counts.max()} times); add stiffness"
            )
        pairs.setflags(write=False)
        object.__setattr__(self, "pairs", pairs)
        for name, above in (("rest_lengths", True), ("stiffness", False), ("damping", False)):
            values = checked_each(name, getattr(self, name), len(pairs), MaterialError)
            bad = np.flatnonzero(values < 1.0 / LARGEST if above else values < 0.0)
            if len(bad):
                bound = f"at least {1.0 / LARGEST:g}" if above else "at least 0"
                raise MaterialError(f"{name} must be {bound} (got {values[bad[0]]} at spring {bad[0]})")
            values.setflags(write=False)
            object.__setattr__(self, name, values)

    def __len__(self) -> int:
        """Count of springs."""
        return len(self.pairs)

    def element_set(self) -> ElementSet:
        """The springs as elements of a shell: weight ``stiffness / 2``, dashpots of ``damping / 2``."""
        viscosity = 0.5 * self.damping if self.damping.any() else None
        return ElementSet(
            "springs", shear, np.array(self.pairs), np.array(self.rest_lengths), 0.5 * self.stiffness, viscosity
        )


def checked_masses(mass: ArrayLike) -> NDArray[np.float64]:
    """Return the masses (n,) [kg] of n particles; MaterialError if they are not positive numbers."""
    masses = checked_vectors("mass", mass, (vector_count(mass),), MaterialError)
    if not (masses >= 1.0 / LARGEST).all():
        raise MaterialError(f"mass must be at least {1.0 / LARGEST:g} kg a particle (got {masses.min():g} kg)")
    return masses
