"""Material of a discrete shell: stiffnesses of the stretch, shear and flexure energies, and mass per area."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from modalshell.core.checks import checked_kind, checked_number
from modalshell.core.errors import MaterialError, ModalShellWarning
from modalshell.core.short_repr import short_repr
from modalshell.core.thread_safety import ReadOnlyArrays
from modalshell.core.typing import Array
from modalshell.mesh import TriangleMesh
from modalshell.shell.bending import BendingConstants, bending_constants
from modalshell.shell.calibration_range import calibration_doubts
from modalshell.shell.membrane import lowest_stable_stretch, membrane_stiffness
from modalshell.shell.orientation import Orientation, orient
from modalshell.shell.sheet import checked_constant


@short_repr
@dataclass(frozen=True)
class Material(ReadOnlyArrays):
    """Stiffnesses of the discrete-shell energies [choi2007, eq. 1-3; theory 3, eq. 1] and area density.

    Each may be one number or one value per element of the mesh that the shell is built on.

    Parameters
    ----------
    stretch : float or array_like, shape (T,)
        k_s of ``k_s (A - A0)^2 / A0`` [N/m], over triangles. May be negative, as isotropic sheets with a Poisson's
        ratio below 1/3 need; a shell checks that no triangle becomes unstable by it.
    shear : float or array_like, shape (E,)
        k_h of ``k_h (l - l0)^2 / l0`` [N], over edges.
    flexure : float or array_like, shape (H,)
        k_f of ``k_f (theta - theta0)^2 l0 / h0`` [N m], over interior edges.
    density : float or array_like, shape (T,)
        Mass per area [kg/m^2].
    correct_clamp : bool, optional
        Double the weight of hinges on the clamp line, which stand for half a cell only. Off for plain
        stiffnesses, which are then exactly the paper's energies; on in :meth:`from_physical`.

    Raises
    ------
    MaterialError
        For values that are not finite or out of range.
    """

    stretch: float | Array
    shear: float | Array
    flexure: float | Array
    density: float | Array
    correct_clamp: bool = False

    def __post_init__(self) -> None:
        for name, unit in (("stretch", "N/m"), ("shear", "N"), ("flexure", "N m"), ("density", "kg/m^2")):
            value = checked_constant(name, getattr(self, name), unit, ratio=name != "density", each="element")
            if name in ("shear", "flexure") and np.min(value, initial=0.0) < 0.0:
                raise MaterialError(f"{name} must not be negative (got {np.min(value):g} {unit})")
            object.__setattr__(self, name, value)

    @classmethod
    def from_physical(
        cls,
        *,
        young: float,
        poisson: float,
        thickness: float,
        density: float,
        mesh: TriangleMesh,
        direction: ArrayLike | None = None,
        narrow: bool | None = None,
    ) -> Material:
        """Stiffnesses that give ``mesh`` the membrane and bending stiffness of an isotropic sheet.

        A mesh of hinges bends as the triangulation has it, not as a plate does: the constants are computed from the
        hinges of this very mesh, so every mesh family is calibrated alike. No constant corrects this: the bending
        Poisson effect stays the family's own (-1/3 where isotropic), and so does its twist. Measured against shell
        theory, bending in two directions and twist are 7 to 85 % off on any mesh, and in-plane bending at ``poisson``
        0 is 12 to 18 % too soft on union-jack and Lloyd meshes; strips that bend one way are met within 3 to 5 %. At
        small deflection, Poisson's ratio 0 and a thickness of L/100, beam theory is met within 0.6 % by strips of width
        L/20, within 1.2 % at L/10, and at L/5 strips drop by 1.1 % more under their weight, 1.6 % under a tip force and
        2.4 % under an end moment, on whatever mesh: 1.1 % is the share kept for large deflection, the rest the clamp's,
        whose hold across the constant counts in. Take :class:`Isotropic` for anything else.

        Parameters
        ----------
        young : float
            Young's modulus [Pa].
        poisson : float
            Poisson's ratio, in (-1, 0.5].
        thickness : float
            Sheet thickness [m].
        density : float
            Mass per volume [kg/m^3].
        mesh : TriangleMesh
            The mesh the shell will be built on.
        direction : array_like, shape (3,), optional
            Direction of bending and pulling for which the constants are exact. Without it: the long axis of the mesh,
            the x axis for flat meshes that have none, or the y axis where x is normal to them; curved meshes without a
            long axis are calibrated on the mean over directions.
        narrow : bool, optional
            Whether the sheet bends as a strip, free to curve across (``EI/w``), or as a plate (``D``). Without it: a
            strip where the mesh is at least three times as long as wide.

        Returns
        -------
        Material
            With per-edge shear stiffness and ``correct_clamp`` on.

        Raises
        ------
        MaterialError
            For values out of range.

        Warns
        -----
        ModalShellWarning
            Where the calibration is known to be off on this mesh by more than about 5 %; the message has the number.
        """
        checked_kind("mesh", mesh, TriangleMesh)
        young = checked_number("young", young, MaterialError, above=0.0, unit="Pa")
        thickness = checked_number("thickness", thickness, MaterialError, above=0.0, unit="m")
        density = checked_number("density", density, MaterialError, above=0.0, unit="kg/m^3")
        poisson = checked_number("poisson", poisson, MaterialError, above=-1.0, at_most=0.5)
        orientation = orient(mesh, direction)
        stretch, shear = membrane_stiffness(mesh, young * thickness, poisson, orientation)
        constants = bending_constants(mesh, direction)
        if narrow is None:
            narrow = orientation.elongated
        doubts = calibration_doubts(mesh, orientation, constants, poisson, thickness, narrow)
        if doubts:
            warnings.warn(
                f"the calibration does not hold on this mesh: {'; '.join(doubts)}. ms.Isotropic(young, poisson, "
                "thickness, density) is shell theory and needs no calibration",
                ModalShellWarning,
                stacklevel=2,
            )
        flexure = _flexure(constants, orientation, young, poisson, thickness, narrow)
        return cls(stretch, shear, flexure, density * thickness, correct_clamp=True)

    def per_element(self, mesh: TriangleMesh) -> tuple[Array, Array, Array]:
        """Stiffnesses of triangles (T,), edges (E,) and hinges (H,) of ``mesh``; MaterialError where they misfit."""
        counts = {"stretch": len(mesh.faces), "shear": len(mesh.edges), "flexure": len(mesh.hinges)}
        values = {name: _spread(name, getattr(self, name), count) for name, count in counts.items()}
        if (values["stretch"] < 0).any():
            bound = lowest_stable_stretch(mesh, values["shear"])
            unstable = np.flatnonzero(values["stretch"] < bound * (1.0 + 1e-9))
            if unstable.size:
                first = unstable[0]
                raise MaterialError(
                    f"stretch {values['stretch'][first]:g} N/m makes triangle {first} unstable, {unstable.size} in "
                    f"all: with this shear it must be at least {bound[first]:g} N/m"
                )
        return values["stretch"], values["shear"], values["flexure"]

    def area_density(self, mesh: TriangleMesh) -> Array:
        """Mass per area of every triangle (T,) [kg/m^2]."""
        return _spread("density", self.density, len(mesh.faces))


def _flexure(
    constants: BendingConstants,
    orientation: Orientation,
    young: float,
    poisson: float,
    thickness: float,
    narrow: bool,
) -> float:
    """k_f [N m] of a strip, or of a plate."""
    rigidity = young * thickness**3 / 12.0
    if not narrow:
        return rigidity / (1.0 - poisson**2) / (2.0 * constants.wide)
    # As a wide, thin strip bends further its membrane takes the curvature across away (Searle), and the hinges' own
    # Poisson effect with it: their constant rises from b towards c. The share of that is split between small and large
    # deflection: 2.5 % at most.
    searle = orientation.width**2 / (thickness * orientation.length)
    return rigidity / (2.0 * constants.narrow * (1.0 + 0.025 * searle / (searle + 5.0)))


def _spread(name: str, value: float | Array, count: int) -> Array:
    array = np.asarray(value, dtype=np.float64)
    if array.ndim == 1 and array.size != count:
        raise MaterialError(f"{name} has {array.size} values, but the mesh has {count} such elements")
    return np.ascontiguousarray(np.broadcast_to(array, (count,)))
