"""Isotropic sheet of shell theory: Young's modulus, Poisson's ratio, thickness and density."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

import numpy as np

from modalshell.core.errors import MaterialError
from modalshell.core.short_repr import short_repr
from modalshell.core.typing import Array
from modalshell.mesh import TriangleMesh
from modalshell.shell.sheet import Field, Sheet

_UNITS = {"young": "Pa", "poisson": "", "thickness": "m", "density": "kg/m^3"}


@final
@short_repr
@dataclass(frozen=True)
class Isotropic(Sheet, kind="isotropic"):
    """Isotropic elastic sheet of the split-fold energy, a Kirchhoff shell; no calibration to the mesh.

    Each may be one number, one value per triangle, or a function of the triangles' centroids (T, 3) [m].

    Parameters
    ----------
    young : float, array_like of shape (T,), or callable
        Young's modulus [Pa].
    poisson : float, array_like of shape (T,), or callable
        Poisson's ratio, above -1 and at most 0.5.
    thickness : float, array_like of shape (T,), or callable
        Sheet thickness [m].
    density : float, array_like of shape (T,), or callable
        Mass per volume [kg/m^3].

    Raises
    ------
    MaterialError
        For values that are not finite or out of range; functions are checked where a shell is built.
    """

    young: Field
    poisson: Field
    thickness: Field
    density: Field

    def __post_init__(self) -> None:
        self._check(_UNITS)
        ratio = np.zeros(1) if callable(self.poisson) else np.asarray(self.poisson)
        if not ((ratio > -1.0) & (ratio <= 0.5)).all():
            raise MaterialError(f"poisson must be above -1 and at most 0.5 (got {ratio.min():g} to {ratio.max():g})")

    def elasticity(self, mesh: TriangleMesh) -> tuple[Array, Array, Array]:
        """Membrane stiffness ``E h / (1 - nu^2)`` [N/m], bending stiffness D [N m] and nu of every triangle (T,)."""
        sheet: Any = self.on(mesh)
        given = sheet.young, sheet.poisson, sheet.thickness
        young, poisson, thickness = (np.broadcast_to(value, (len(mesh.faces),)) for value in given)
        membrane = young * thickness / (1.0 - poisson**2)
        return membrane, membrane * thickness**2 / 12.0, poisson
