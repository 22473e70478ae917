"""Strains, stress resultants, curvatures and energies of the triangles of a deformed shell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modalshell.core.checks import checked_choice
from modalshell.core.errors import LoadError, OptionError
from modalshell.core.short_repr import short_repr
from modalshell.core.typing import Array, Mask
from modalshell.mesh import TriangleMesh
from modalshell.mesh.topology import area_vectors
from modalshell.shell.isotropic import Isotropic
from modalshell.shell.material import Material
from modalshell.shell.sheet import Sheet
from modalshell.shell.smoothed_membrane import strain_of_lengths
from modalshell.shell.triangle_pairs import moment_tensors

FIELDS: Final[dict[str, str]] = {
    "membrane_strain": "",
    "membrane_force": "N/m",
    "curvature": "1/m",
    "moment": "N",
    "von_mises": "Pa",
    "von_mises_faces": "Pa",
    "energy_density": "J/m^2",
}
"""Unit of every field by its name."""
TENSORS: Final = ("membrane_strain", "membrane_force", "curvature", "moment")
"""Fields that are tensors."""
BARE_SHEET: Final = Isotropic(1.0, 0.0, 12.0 ** (1 / 3), 1.0)
"""A sheet of bending stiffness 1 N m, from whose moments the curvatures of other materials follow."""
_HALF_SHEAR = np.array([1.0, 1.0, 0.5])
"""Tensor components over those that elasticity takes, (11, 22, 2 12)."""


@final
@short_repr
@dataclass(frozen=True)
class ShellFields:
    """Fields of a deformed shell, one value per triangle.

    Tensors are symmetric, (T, 3): their components 11, 22 and 12 in the triangle's own axes, axis 1 along its first
    edge, from the first vertex to the second, axis 2 to its left in its plane.

    Attributes
    ----------
    membrane_strain : ndarray, shape (T, 3)
        Green strain of the middle surface.
    curvature : ndarray, shape (T, 3)
        Change of curvature from rest [1/m], positive where the normals spread.
    energy_density : ndarray, shape (T,)
        Elastic energy per rest area [J/m^2].
    axes : ndarray, shape (T, 2, 3)
        Unit vectors along axis 1 and 2 where the triangle is now.
    membrane_force : ndarray, shape (T, 3), or None
        Force per length [N/m]; None without a thickness, as are the moments and stresses.
    moment : ndarray, shape (T, 3), or None
        Bending moment per length [N].
    von_mises_faces : ndarray, shape (T, 2), or None
        Von Mises stress [Pa] at the face to which the normals point, and at the other one.
    """

    membrane_strain: Array
    curvature: Array
    energy_density: Array
    axes: Array
    membrane_force: Array | None = None
    moment: Array | None = None
    von_mises_faces: Array | None = None

    @classmethod
    def of(
        cls,
        mesh: TriangleMesh,
        material: Material | Sheet,
        x: Array,
        fold_moments: Array,
        energy_density: Array,
        rest: Any = None,
    ) -> ShellFields:
        """The fields at positions x (n, 3) [m], from the moments of the folds (T, 3) [N m] and the energy density.

        With a RestShape strains are those from it; so are the moments.
        """
        moment = moment_of_folds(mesh, fold_moments)
        sheet = material if isinstance(material, Sheet) else BARE_SHEET
        strain = membrane_strain(mesh, x, None if rest is None else rest.squares)
        axes = triangle_axes(mesh, x)
        if (directed := sheet.directed(mesh)) is None:
            membrane, rigidity, poisson = sheet.elasticity(mesh)
            curvature, force = curvature_of_moment(rigidity, poisson, moment), resultants(membrane, poisson, strain)
        else:
            in_plane, bending = (elasticity.in_triangles(mesh) for elasticity in directed)
            curvature = np.linalg.solve(bending, moment[:, :, None])[:, :, 0] * _HALF_SHEAR
            force = np.einsum("tij,tj->ti", in_plane, strain / _HALF_SHEAR)
        if not isinstance(material, Sheet):
            return cls(strain, curvature, energy_density, axes)
        return cls(strain, curvature, energy_density, axes, force, moment, von_mises(mesh, material, force, moment))

    @property
    def von_mises(self) -> Array | None:
        """Von Mises stress (T,) [Pa], the larger one of both faces of the sheet; None without a thickness."""
        return None if self.von_mises_faces is None else self.von_mises_faces.max(axis=1)

    def values(self, name: str) -> Array:
        """The field of a name in :data:`FIELDS`: tensors (T, 3), scalars (T,), the two faces' (T, 2).

        OptionError for another name, and for one that needs a thickness which the material has not.
        """
        checked_choice("field", name, tuple(FIELDS))
        found: Array | None = getattr(self, name)
        if found is None:
            raise OptionError(
                f"{name} needs a sheet with a thickness (got a material of stiffnesses alone): take "
                "ms.Isotropic, or membrane_strain, curvature or energy_density"
            )
        return found

    def require(self, *names: str) -> None:
        """OptionError unless every field of these names is there."""
        for name in names:
            self.values(name)

    def scalar(self, name: str) -> Array:
        """One number per triangle (T,) of a field: of a tensor its principal value of largest size, with its sign."""
        return scalar_of(name, self.values(name))

    def principal(self, name: str) -> tuple[Array, Array]:
        """Principal values (T, 2) of a tensor field, the larger first, and their directions (T, 2, 3) in space."""
        first, second, both = np.moveaxis(self.values(checked_choice("tensor", name, TENSORS)), -1, 0)
        angle = 0.5 * np.arctan2(both, 0.5 * (first - second))
        along = np.cos(angle)[:, None] * self.axes[:, 0] + np.sin(angle)[:, None] * self.axes[:, 1]
        across = np.cos(angle)[:, None] * self.axes[:, 1] - np.sin(angle)[:, None] * self.axes[:, 0]
        return principal_values(self.values(name)), np.stack([along, across], axis=1)


def principal_values(tensors: Array) -> Array:
    """Principal values (..., 2), the larger first, of tensors (..., 3)."""
    first, second, both = np.moveaxis(tensors, -1, 0)
    middle, radius = 0.5 * (first + second), np.hypot(0.5 * (first - second), both)
    return np.stack([middle + radius, middle - radius], axis=-1)


def scalar_of(name: str, values: Array) -> Array:
    """One number per triangle (..., T) of the values of a field: see :meth:`ShellFields.scalar`."""
    if name in TENSORS:
        larger, smaller = np.moveaxis(principal_values(values), -1, 0)
        return np.where(np.abs(larger) >= np.abs(smaller), larger, smaller)
    return np.asarray(values.max(axis=-1)) if name == "von_mises_faces" else values


def vertex_means(scalars: Array, rest: Array, faces: NDArray[np.integer]) -> Array:
    """Means (F, n) at the vertices of numbers (F, T) of the triangles around, by their areas at rest (n, 3)."""
    areas, corners = 0.5 * np.linalg.norm(area_vectors(rest, faces), axis=1), faces.ravel()
    around = np.bincount(corners, np.repeat(areas, 3), len(rest))
    around[around == 0.0] = 1.0
    return np.stack([np.bincount(corners, np.repeat(areas * one, 3), len(rest)) / around for one in scalars])


def flat_triangles(mesh: TriangleMesh, x: Array) -> Mask:
    """Triangles (T,) that have collapsed to a line or a point at positions x (n, 3)."""
    return np.asarray((area_vectors(x, mesh.faces) == 0.0).all(axis=1))


def triangle_axes(mesh: TriangleMesh, x: Array) -> Array:
    """Unit vectors (T, 2, 3) of the triangles' axes at positions x (n, 3): along the first edge, and to its left."""
    sides = x[mesh.faces[:, 1:]] - x[mesh.faces[:, :1]]
    along = sides[:, 0] / np.linalg.norm(sides[:, 0], axis=1)[:, None]
    across = sides[:, 1] - np.sum(sides[:, 1] * along, axis=1)[:, None] * along
    return np.stack([along, across / np.linalg.norm(across, axis=1)[:, None]], axis=1)


def membrane_strain(mesh: TriangleMesh, x: Array, squares: Array | None = None) -> Array:
    """Green strain (T, 3) of every triangle from the rest shape of ``mesh`` to positions ``x`` (n, 3).

    ``squares`` (E,) is the change of half the squared lengths [m^2] that the edges have without stress.
    """
    corners, rest = x[mesh.faces], mesh.vertices[mesh.faces]
    moved, before = (points[:, [1, 2, 2]] - points[:, [0, 0, 1]] for points in (corners, rest))
    stretches = 0.5 * (np.sum(moved**2, axis=2) - np.sum(before**2, axis=2))
    if squares is not None:
        stretches = stretches - squares[mesh.face_edges[:, [0, 2, 1]]]
    strain = np.einsum("tij,tj->ti", strain_of_lengths(mesh, mesh.faces), stretches)
    strain[:, 2] *= 0.5
    return np.asarray(strain)


def moment_of_folds(mesh: TriangleMesh, fold_moments: Array) -> Array:
    """Moment tensor M (T, 3) [N] with ``l_k n_k . M n_k`` the moment (T, 3) [N m] at the edge opposite corner k."""
    every = np.arange(len(mesh.faces))
    units = moment_tensors(mesh, every, np.full_like(every, 2))  # axis 1 is along the edge opposite corner 2
    return np.asarray(np.einsum("tik,tk->ti", units, fold_moments[:, [2, 0, 1]]))


def resultants(stiffness: Array, poisson: Array, strain: Array) -> Array:
    """Plane stress: resultants (T, 3) of the strains or curvatures (T, 3) by a stiffness and Poisson's ratio (T,)."""
    trace = strain[:, 0] + strain[:, 1]
    out = (1.0 - poisson)[:, None] * strain
    out[:, :2] += (poisson * trace)[:, None]
    return np.asarray(stiffness[:, None] * out)


def curvature_of_moment(rigidity: Array, poisson: Array, moment: Array) -> Array:
    """Curvatures (T, 3) [1/m] under moments (T, 3) [N]: the inverse of :func:`resultants`."""
    trace = moment[:, 0] + moment[:, 1]
    out = (1.0 + poisson)[:, None] * moment
    out[:, :2] -= (poisson * trace)[:, None]
    return np.asarray(out / (rigidity * (1.0 - poisson**2))[:, None])


def von_mises(mesh: TriangleMesh, material: Sheet, force: Array, moment: Array) -> Array | None:
    """Von Mises stress (T, 2) [Pa] at both faces; None of a sheet without a thickness."""
    stresses = material.face_stresses(mesh, force, moment)
    if stresses is None:
        return None
    faces = []
    for first, second, shear in (stress.T for stress in stresses):
        faces.append(np.sqrt(first**2 - first * second + second**2 + 3.0 * shear**2))
    return np.stack(faces, axis=1)


def refuse_collapse(mesh: TriangleMesh, name: str, values: ArrayLike, x: Array) -> None:
    """LoadError that names the flattest triangle at ``x`` (n, 3), where ``values`` are not all finite."""
    if np.isfinite(values).all():
        return
    corners = x[mesh.faces]
    sides = corners - np.roll(corners, 1, axis=1)
    longest = np.max(np.sum(sides**2, axis=2), axis=1)
    flatness = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) / np.where(longest > 0.0, longest, 1.0)
    worst = int(np.argmin(flatness))
    raise LoadError(
        f"the {name} is not finite at these positions; the flattest triangle is {worst}, vertices "
        f"{mesh.faces[worst].tolist()} (counted from 0), twice its area {flatness[worst]:.1e} of its longest side "
        "squared: move its corners apart"
    )
