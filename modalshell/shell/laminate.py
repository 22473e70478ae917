"""Laminates of orthotropic plies, by classical lamination theory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self, final

import numpy as np

from modalshell.core.checks import shown
from modalshell.core.errors import MaterialError
from modalshell.core.short_repr import short_repr
from modalshell.core.thread_safety import ReadOnlyArrays
from modalshell.core.typing import Array
from modalshell.mesh import TriangleMesh
from modalshell.shell.elasticity import Elasticity, directions_on, plane_elasticity, strain_turn, turned
from modalshell.shell.fields import ShellFields, triangle_axes
from modalshell.shell.isotropic import Isotropic
from modalshell.shell.orthotropic import Orthotropic
from modalshell.shell.sheet import SHEETS, Direction, Field, Sheet, axes_on, checked_constant, evaluated

_COUPLED = 1e-9
"""Least size of the coupling B, over membrane stiffness times thickness, that counts."""


@final
@short_repr
@dataclass(frozen=True)
class Ply(ReadOnlyArrays):
    """One ply of a :class:`Laminate`.

    Angle and thickness may each be one number, one value per triangle, or a function of the triangles' centroids
    (T, 3) [m]: fibres that are steered, plies that end or grow thinner.

    Parameters
    ----------
    material : Orthotropic or Isotropic
        Its moduli and density, single numbers; the thickness and direction are those of the ply.
    angle : float, array_like of shape (T,), or callable
        Axis 1 of the ply [deg], counter-clockwise from that of the laminate, as seen from where the normal points.
    thickness : float, array_like of shape (T,), or callable
        Its thickness [m].

    Raises
    ------
    MaterialError
        For another material, one with fields or a direction of its own, or numbers out of range; functions are checked
        where a shell is built.
    """

    material: Orthotropic | Isotropic
    angle: Field
    thickness: Field

    def __post_init__(self) -> None:
        if not isinstance(self.material, Orthotropic | Isotropic):
            raise MaterialError(
                f"material must be an Orthotropic or an Isotropic of its own (got {shown(self.material)})"
            )
        for name, unit in (("angle", "deg"), ("thickness", "m")):
            if not callable(raw := getattr(self, name)):
                object.__setattr__(self, name, checked_constant(name, raw, unit, ratio=name == "angle"))
        constants = self.material.constants
        wanted = {"young", "poisson", "density"} if isinstance(self.material, Isotropic) else set(_NUMBERS)
        if missing := sorted(wanted - set(constants)):
            raise MaterialError(f"material of a ply must be of single numbers (got a field of {', '.join(missing)})")
        direction = getattr(self.material, "direction", 0.0)
        if not isinstance(direction, float) or direction != 0.0:
            raise MaterialError(
                f"material of a ply must have direction 0.0: its angle takes that place (got {shown(self.material)})"
            )

    @property
    def sizes(self) -> set[int]:
        """Numbers of triangles of its fields; MaterialError for functions, which have none without a mesh."""
        if callable(self.angle) or callable(self.thickness):
            raise MaterialError("a ply is given by functions, which have values on a mesh: take laminate.on(mesh)")
        return {len(value) for value in (self.angle, self.thickness) if isinstance(value, np.ndarray)}

    def on(self, mesh: TriangleMesh) -> Ply:
        """The same ply, functions evaluated on the triangles of ``mesh``; MaterialError where fields misfit."""
        return Ply(self.material, *(evaluated(name, getattr(self, name), mesh) for name in ("angle", "thickness")))

    @property
    def own_plane(self) -> Array:
        """Q (3, 3) [Pa] in axes of the ply."""
        own = self.material.constants
        if isinstance(self.material, Isotropic):
            young, poisson = own["young"], own["poisson"]
            values = young, young, poisson, young / (2.0 * (1.0 + poisson))
        else:
            values = own["young_1"], own["young_2"], own["poisson"], own["shear"]
        first, second, ratio, shear = map(np.atleast_1d, values)
        return np.asarray(plane_elasticity(first, second, ratio, shear)[0])

    @property
    def plane(self) -> Array:
        """Q (3, 3) [Pa] in axes of the laminate, or (T, 3, 3) of a field of angles."""
        return turned(self.own_plane, self.angle)  # type: ignore[arg-type]  # no function: see sizes


_NUMBERS = ("young_1", "young_2", "shear", "poisson", "density")


@final
@short_repr
@dataclass(frozen=True)
class Laminate(Sheet, kind="laminate"):
    r"""Sheet of the split-fold energy made of plies, by classical lamination theory.

    With :math:`\bar Q_p` of ply p in axes of the laminate, from the height :math:`z_p` above the middle to
    :math:`z_{p+1}`,

    .. math:: C_m = \sum_p (z_{p+1} - z_p) \bar Q_p , \quad B = \sum_p \frac{z_{p+1}^2 - z_p^2}{2} \bar Q_p , \quad
              C_b = \sum_p \frac{z_{p+1}^3 - z_p^3}{3} \bar Q_p .

    The coupling B of stretch and bending must be zero, as it is of every stack that is symmetric about its middle.

    Parameters
    ----------
    plies : sequence of Ply
        From the bottom to the top, to which the normals point.
    direction : float, array_like of shape (3,), (T,) or (T, 3), or callable
        Axis 1 of the laminate in every triangle: as of :class:`Orthotropic`.

    Raises
    ------
    MaterialError
        For no plies, a stack whose B is not zero on some triangle, fields that misfit, or a direction that is none.
    """

    plies: Sequence[Ply]
    direction: Direction = 0.0

    def __post_init__(self) -> None:
        if not isinstance(self.plies, list | tuple) or not self.plies:
            raise MaterialError(f"plies must be a list of ms.Ply, from the bottom to the top (got {shown(self.plies)})")
        for k, ply in enumerate(self.plies):
            if not isinstance(ply, Ply):
                raise MaterialError(f"plies[{k}] must be an ms.Ply (got {shown(ply)})")
        object.__setattr__(self, "plies", tuple(self.plies))
        self._check({"direction": "deg"})
        if any(callable(ply.angle) or callable(ply.thickness) for ply in self.plies):
            return  # checked where they have values
        if len(sizes := set[int]().union(*(ply.sizes for ply in self.plies))) > 1:
            raise MaterialError(f"fields of plies must have one value per triangle each (got {sorted(sizes)} values)")
        membrane, coupling, _ = (np.abs(matrix).max(axis=(-2, -1)) for matrix in self.matrices)
        share = float(np.max(coupling / (membrane * self.thickness)))
        if share > _COUPLED:
            raise MaterialError(
                f"plies must have no coupling of stretch and bending (got B of {share:.2g} of the membrane's stiffness "
                "times the thickness): a laminate must be symmetric about its middle, such as [0, 90, 90, 0]"
            )

    @property
    def _plied(self) -> list[Any]:
        """Thicknesses of the plies [m], a number or (T,) each."""
        sizes = max((size for ply in self.plies for size in ply.sizes), default=0)
        depths: list[Any] = [ply.thickness for ply in self.plies]
        return [np.broadcast_to(depth, (sizes,)) for depth in depths] if sizes else depths

    @property
    def thickness(self) -> Any:
        """Thickness of all plies together [m], or (T,) of plies with fields."""
        return sum(self._plied)

    @property
    def heights(self) -> Array:
        """Heights (plies + 1,) of their faces above the middle [m], or (plies + 1, T) of plies with fields."""
        above = np.cumsum(self._plied, axis=0)
        return np.concatenate([np.zeros_like(above[:1]), above]) - 0.5 * self.thickness

    @property
    def matrices(self) -> tuple[Array, Array, Array]:
        """Membrane [N/m], coupling [N] and bending stiffness [N m] (3, 3), on (11, 22, 2 12) in its own axes.

        They are (T, 3, 3) of plies with fields.
        """
        low, high = self.heights[:-1], self.heights[1:]
        layers = [(high**power - low**power) / power for power in (1, 2, 3)]
        if low.ndim == 1:
            planes = np.stack([ply.plane for ply in self.plies])
            first, second, third = (np.tensordot(layer, planes, axes=1) for layer in layers)
        else:
            first, second, third = (
                np.asarray(sum(layer[k, :, None, None] * ply.plane for k, ply in enumerate(self.plies)))
                for layer in layers
            )
        return first, second, third

    def on(self, mesh: TriangleMesh) -> Laminate:
        """The same sheet, its direction and plies evaluated on the triangles of ``mesh``."""
        return Laminate([ply.on(mesh) for ply in self.plies], evaluated("direction", self.direction, mesh))

    def area_density(self, mesh: TriangleMesh) -> Array:
        """Mass per area of every triangle (T,) [kg/m^2]."""
        plies: list[Any] = [ply.on(mesh) for ply in self.plies]
        return np.full(len(mesh.faces), sum(ply.thickness * ply.material.constants["density"] for ply in plies))

    def directed(self, mesh: TriangleMesh, slope: str | None = None) -> tuple[Elasticity, Elasticity]:
        """Elasticity of membrane and bending, or their ``slope`` by the direction."""
        sheet = self.on(mesh)
        along = axes_on(mesh, sheet.direction, slope)
        membrane, _, bending = (np.broadcast_to(c, (len(mesh.faces), 3, 3)) for c in sheet.matrices)
        return Elasticity(membrane, along), Elasticity(bending, along)

    def face_stresses(self, mesh: TriangleMesh, force: Array, moment: Array) -> tuple[Array, Array]:
        """Stress tensors (T, 3) [Pa] at the faces of the top and the bottom ply, in the triangles' axes."""
        strain, curvature = (
            np.linalg.solve(c.in_triangles(mesh), loads[:, :, None])
            for c, loads in zip(self.directed(mesh), (force, moment), strict=True)
        )
        sheet = self.on(mesh)
        along = directions_on(mesh, np.asarray(sheet.direction))
        found = []
        for ply, height in ((sheet.plies[-1], sheet.heights[-1]), (sheet.plies[0], sheet.heights[0])):
            plane = Elasticity(np.broadcast_to(ply.plane, (len(mesh.faces), 3, 3)), along).in_triangles(mesh)
            found.append(np.asarray((plane @ (strain + np.reshape(height, (-1, 1, 1)) * curvature))[:, :, 0]))
        return found[0], found[1]

    def ply_stresses(self, mesh: TriangleMesh, fields: ShellFields) -> Array:
        """Stresses (T, plies, 2, 3) [Pa] at the lower and the upper face of every ply: 11, 22 and 12 in its own axes.

        Parameters
        ----------
        mesh : TriangleMesh
            Mesh of the shell without stress, :attr:`Shell.rest_mesh`.
        fields : ShellFields
            Its fields, from :meth:`Shell.fields`.
        """
        sheet = self.on(mesh)
        along = directions_on(mesh, np.asarray(sheet.direction))
        first, second = triangle_axes(mesh, mesh.vertices).swapaxes(0, 1)
        angles = np.degrees(np.arctan2(np.sum(second * along, axis=1), np.sum(first * along, axis=1)))
        found = np.empty((len(mesh.faces), len(self.plies), 2, 3))
        for k, ply in enumerate(sheet.plies):
            turns = strain_turn(angles + ply.angle)
            for side in (0, 1):
                strain = fields.membrane_strain + np.reshape(sheet.heights[k + side], (-1, 1)) * fields.curvature
                turned_strain = np.einsum("tij,tj->ti", turns, strain * np.array([1.0, 1.0, 2.0]))
                found[:, k, side] = turned_strain @ ply.own_plane
        return found

    def plain(self, mesh: TriangleMesh) -> dict[str, Any]:
        """The plies and the direction on a mesh as numbers and lists."""
        sheet = self.on(mesh)
        plies = [
            [
                ply.material.kind,
                ply.material.plain(mesh),
                *(np.asarray(part).tolist() for part in (ply.angle, ply.thickness)),
            ]
            for ply in sheet.plies
        ]
        return {"plies": plies, "direction": np.asarray(sheet.direction).tolist()}

    @classmethod
    def of_plain(cls, values: Mapping[str, Any]) -> Self:
        """The laminate of what :meth:`plain` gives."""
        plies = []
        for kind, constants, angle, thickness in values["plies"]:
            plies.append(Ply(SHEETS[kind].of_plain(constants), angle, thickness))  # type: ignore[arg-type]
        return cls(plies, values["direction"])
