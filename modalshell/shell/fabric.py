"""Fabric: a sheet whose resistance to stretch and to bending were measured apart."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

import numpy as np

from modalshell.core.checks import shown
from modalshell.core.errors import MaterialError
from modalshell.core.short_repr import short_repr
from modalshell.mesh import TriangleMesh
from modalshell.shell.elasticity import Elasticity
from modalshell.shell.sheet import IMAGINARY, Direction, Field, Sheet, axes_on, checked_constant

_Constants = tuple[Field, Field, Field] | tuple[Field, Field, Field, Field]
_UNITS = {"stretch": "N/m", "bending": "N m"}


@final
@short_repr
@dataclass(frozen=True, kw_only=True)
class Fabric(Sheet, kind="fabric"):
    r"""Sheet of the split-fold energy with membrane and bending apart: cloth bends far more easily than a plate of it.

    Membrane forces and moments per width are :math:`N = C_m (E_{11}, E_{22}, 2 E_{12})` and
    :math:`M = C_b (\kappa_{11}, \kappa_{22}, 2 \kappa_{12})` with the matrices

    .. math:: \begin{pmatrix} C_1 & C_{12} & 0 \\ C_{12} & C_2 & 0 \\ 0 & 0 & G \end{pmatrix} , \qquad
              \begin{pmatrix} B_1 & B_{12}' & 0 \\ B_{12}' & B_2 & 0 \\ 0 & 0 & B_{12} \end{pmatrix}

    (theory 15, eq. 2). Bent to a cylinder at an angle :math:`\theta` to axis 1, a sheet without coupling has the
    stiffness :math:`B_1 \cos^4 \theta + B_2 \sin^4 \theta + 4 B_{12} \cos^2 \theta \sin^2 \theta`: of a measurement at
    45 degrees, :math:`B_{12} = B_{45} - (B_1 + B_2) / 4`. Each number may be one value per triangle, or a function of
    the triangles' centroids (T, 3) [m].

    Parameters
    ----------
    stretch : tuple of 3 or 4
        :math:`C_1, C_2, G` and, where given, the coupling :math:`C_{12}` [N/m].
    bending : tuple of 3 or 4
        :math:`B_1, B_2, B_{12}` and, where given, the coupling of both curvatures :math:`B_{12}'` [N m].
    density : float, array_like of shape (T,), or callable
        Mass per area [kg/m^2].
    direction : float, array_like of shape (3,), (T,) or (T, 3), or callable
        Axis 1, the warp, in every triangle: as of :class:`Orthotropic`.

    Raises
    ------
    MaterialError
        For values that are not finite or out of range, couplings that leave some strain without stiffness; and, where a
        shell is built, for fields that do not fit its mesh, or a direction normal to a triangle.
    """

    stretch: _Constants
    bending: _Constants
    density: Field
    direction: Direction = 0.0

    def __post_init__(self) -> None:
        for name, unit in _UNITS.items():
            raw = getattr(self, name)
            if not isinstance(raw, list | tuple) or len(raw) not in (3, 4):
                raise MaterialError(
                    f"{name} must be three numbers [{unit}], along axis 1, axis 2, and in shear or twist, or four "
                    f"with the coupling of the first two (got {shown(raw)})"
                )
            checked: tuple[Any, ...] = tuple(
                value if callable(value) else checked_constant(f"{name}[{k}]", value, unit, ratio=k == 3)
                for k, value in enumerate(raw)
            )
            object.__setattr__(self, name, checked)
            if len(checked) == 4 and not any(map(callable, checked)):
                first, second, _, coupling = (np.asarray(value) for value in checked)
                if (coupling**2 >= first * second).any():
                    raise MaterialError(
                        f"{name}[3], the coupling, must be below the geometric mean of the first two, else some "
                        f"strain has no stiffness (got {shown(raw)})"
                    )
        self._check({"density": "kg/m^2", "direction": "deg"})

    def directed(self, mesh: TriangleMesh, slope: str | None = None) -> tuple[Elasticity, Elasticity]:
        """Elasticity of membrane and bending, or their ``slope`` by a constant, directions turning in its plane."""
        sheet = self.on(mesh)
        along = axes_on(mesh, sheet.direction, slope)
        found = []
        for name in _UNITS:
            values = [np.asarray(value) for value in getattr(sheet, name)]
            if slope is not None and slope.startswith(f"{name}_"):
                place = int(slope.removeprefix(f"{name}_")) - 1
                values[place] = values[place] + 1j * IMAGINARY
            matrix = np.zeros((len(mesh.faces), 3, 3), dtype=np.result_type(*values))
            matrix[:, 0, 0], matrix[:, 1, 1], matrix[:, 2, 2] = values[:3]
            if len(values) == 4:
                matrix[:, 0, 1] = matrix[:, 1, 0] = values[3]
            found.append(Elasticity(matrix, along))
        return found[0], found[1]
