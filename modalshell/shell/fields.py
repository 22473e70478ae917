"""Strains, stress resultants, curvatures and energies of the triangles of a deformed shell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from modalshell.mesh import TriangleMesh
from modalshell.shell.elastic_energy import ElasticEnergy
from modalshell.shell.isotropic import Isotropic
from modalshell.shell.material import Material
from modalshell.shell.slopes import HeldSlopes
from modalshell.shell.smoothed_membrane import strain_of_lengths
from modalshell.shell.split_fold_energy import SplitFoldEnergy
from modalshell.typing import Array


@final
@dataclass(frozen=True)
class ShellFields:
    """Fields of a deformed shell, one value a triangle.

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
    membrane_force : ndarray, shape (T, 3), or None
        Force per length [N/m]; None without a thickness, as are the moments and stresses.
    moment : ndarray, shape (T, 3), or None
        Bending moment per length [N].
    von_mises : ndarray, shape (T,), or None
        Von Mises stress [Pa], the larger one of both faces of the sheet.
    """

    membrane_strain: Array
    curvature: Array
    energy_density: Array
    membrane_force: Array | None = None
    moment: Array | None = None
    von_mises: Array | None = None


def fields_at(
    mesh: TriangleMesh,
    material: Material | Isotropic,
    energy: ElasticEnergy,
    slopes: HeldSlopes,
    clamped: NDArray[np.bool_],
    x: Array,
) -> ShellFields:
    """Fields of a shell of ``energy`` at positions ``x`` (n, 3); see :meth:`modalshell.Shell.fields`."""
    sheet = material if isinstance(material, Isotropic) else Isotropic(1.0, 0.0, 12.0 ** (1 / 3), 1.0)
    folds = energy if isinstance(energy, SplitFoldEnergy) else SplitFoldEnergy(mesh, sheet, slopes, [], clamped)
    moment = moment_of_folds(mesh, folds.bending(x)[0])
    membrane, rigidity, poisson = sheet.elasticity(mesh)
    curvature = curvature_of_moment(rigidity, poisson, moment)
    strain = membrane_strain(mesh, x)
    density = energy.face_energies(mesh, x) / mesh.face_areas
    if not isinstance(material, Isotropic):
        return ShellFields(strain, curvature, density)
    force = resultants(membrane, poisson, strain)
    return ShellFields(strain, curvature, density, force, moment, von_mises(mesh, sheet, force, moment))


def membrane_strain(mesh: TriangleMesh, x: Array) -> Array:
    """Green strain (T, 3) of every triangle from the rest shape of ``mesh`` to positions ``x`` (n, 3)."""
    corners, rest = x[mesh.faces], mesh.vertices[mesh.faces]
    moved, before = (points[:, [1, 2, 2]] - points[:, [0, 0, 1]] for points in (corners, rest))
    stretches = 0.5 * (np.sum(moved**2, axis=2) - np.sum(before**2, axis=2))
    strain = np.einsum("tij,tj->ti", strain_of_lengths(mesh), stretches)
    strain[:, 2] *= 0.5
    return np.asarray(strain)


def moment_of_folds(mesh: TriangleMesh, fold_moments: Array) -> Array:
    """Moment tensor M (T, 3) [N] with ``l_k n_k . M n_k`` the moment (T, 3) [N m] at the edge opposite corner k."""
    x = mesh.vertices[mesh.faces]
    edges = np.roll(x, -2, axis=1) - np.roll(x, -1, axis=1)
    along = edges[:, 2] / np.linalg.norm(edges[:, 2], axis=1)[:, None]
    across = np.cross(mesh.face_normals, along)
    # An edge with components (s, t) has the normal (t, -s): its square is (t^2, s^2, -2 s t) over the length squared.
    s, t = np.einsum("tki,ti->tk", edges, along), np.einsum("tki,ti->tk", edges, across)
    length = np.hypot(s, t)
    rows = np.stack([t * t, s * s, -2.0 * s * t], axis=2) / length[:, :, None]
    return np.linalg.solve(rows, fold_moments[:, :, None])[:, :, 0]


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


def von_mises(mesh: TriangleMesh, material: Isotropic, force: Array, moment: Array) -> Array:
    """Larger von Mises stress (T,) [Pa] of the two faces, ``N / h + 6 M / h^2`` and ``N / h - 6 M / h^2``."""
    thickness = material.thicknesses(mesh)[:, None]
    worst = np.zeros(len(force))
    for side in (1.0, -1.0):
        first, second, shear = (force / thickness + side * 6.0 * moment / thickness**2).T
        worst = np.maximum(worst, np.sqrt(first**2 - first * second + second**2 + 3.0 * shear**2))
    return worst
