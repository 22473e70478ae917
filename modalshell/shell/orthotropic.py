"""Orthotropic sheet of shell theory: two Young's moduli along and across a direction, as of wood, paper or a weave."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

import numpy as np

from modalshell.core.checks import shown
from modalshell.core.errors import MaterialError
from modalshell.core.short_repr import short_repr
from modalshell.mesh import TriangleMesh
from modalshell.shell.elasticity import Elasticity, plane_elasticity
from modalshell.shell.sheet import IMAGINARY, Direction, Field, Sheet, axes_on, checked_constant

_UNITS = {"shear": "Pa", "poisson": "", "thickness": "m", "density": "kg/m^3", "direction": "deg"}


@final
@short_repr
@dataclass(frozen=True, kw_only=True)
class Orthotropic(Sheet, kind="orthotropic"):
    r"""Orthotropic elastic sheet of the split-fold energy, a Kirchhoff shell in plane stress.

    With Q of :math:`\nu_{21} = \nu_{12} E_2 / E_1`,

    .. math:: Q = \frac{1}{1 - \nu_{12} \nu_{21}} \begin{pmatrix} E_1 & \nu_{12} E_2 & 0 \\ \nu_{12} E_2 & E_2 & 0 \\
              0 & 0 & G_{12} (1 - \nu_{12} \nu_{21}) \end{pmatrix},

    the membrane has h Q and bending :math:`h^3 / 12\, Q` (theory 15, eq. 3). Each constant may be one number, one value
    per triangle, or a function of the triangles' centroids (T, 3) [m].

    Parameters
    ----------
    young : pair of float, array_like of shape (T,), or callable
        Young's moduli along axis 1 and axis 2 [Pa].
    shear : float, array_like of shape (T,), or callable
        Shear modulus in the plane, G12 [Pa].
    poisson : float, array_like of shape (T,), or callable
        Poisson's ratio nu12: contraction along axis 2 over extension along axis 1; ``nu12^2 E2 / E1`` below 1.
    thickness : float, array_like of shape (T,), or callable
        Sheet thickness [m].
    density : float, array_like of shape (T,), or callable
        Mass per volume [kg/m^3].
    direction : float, array_like of shape (3,), (T,) or (T, 3), or callable
        Axis 1 in every triangle: an angle [deg] from the projection of the x axis, counter-clockwise as seen from where
        the normal points; or a vector, which is projected.

    Raises
    ------
    MaterialError
        For values that are not finite or out of range, and, where a shell is built, for fields that do not fit its
        mesh, or a direction normal to a triangle.
    """

    young: tuple[Field, Field]
    shear: Field
    poisson: Field
    thickness: Field
    density: Field
    direction: Direction = 0.0

    def __post_init__(self) -> None:
        if not isinstance(self.young, list | tuple) or len(self.young) != 2:
            raise MaterialError(f"young must be two moduli, along axis 1 and axis 2 [Pa] (got {shown(self.young)})")
        pair = tuple(e if callable(e) else checked_constant(f"young[{k}]", e, "Pa") for k, e in enumerate(self.young))
        object.__setattr__(self, "young", pair)
        self._check(_UNITS)
        if not any(map(callable, (*self.young, self.poisson))):
            self._refuse_unstable()

    def _refuse_unstable(self) -> None:
        first, second = (np.asarray(e) for e in self.young)
        product = np.asarray(self.poisson) ** 2 * second / first
        if (product >= 1.0).any():
            raise MaterialError(
                f"poisson is too large for these moduli: nu12^2 E2 / E1 must be below 1, else some strain has no "
                f"stiffness (got up to {product.max():g}); nu12 belongs to axis 1, and nu21 = nu12 E2 / E1 to axis 2"
            )

    def directed(self, mesh: TriangleMesh, slope: str | None = None) -> tuple[Elasticity, Elasticity]:
        """Elasticity of membrane and bending, or their ``slope`` by a constant, directions turning in its plane."""
        sheet, moved = self.on(mesh), {} if slope is None else {slope: 1j * IMAGINARY}

        def value(name: str, raw: Any) -> Any:
            return np.broadcast_to(np.asarray(raw) + moved.get(name, 0.0), (len(mesh.faces),))

        thickness = value("thickness", sheet.thickness)
        first, second = (value(f"young_{k + 1}", e) for k, e in enumerate(sheet.young))
        plane = plane_elasticity(first, second, value("poisson", sheet.poisson), value("shear", sheet.shear))
        along = axes_on(mesh, sheet.direction, slope)
        found = (thickness[:, None, None] * plane, thickness[:, None, None] ** 3 / 12.0 * plane)
        return Elasticity(found[0], along), Elasticity(found[1], along)
