"""A sheet with either bending energy, split folds or calibrated hinges, free or clamped along one edge."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator

import modalshell as ms
from modalshell.supports import Support

FAMILIES = ("union-jack", "equilateral", "delaunay")
ENERGIES = ("Isotropic", "hinges")


class Sheet(TypedDict):
    """Young's modulus [Pa], Poisson's ratio, thickness [m] and density [kg/m^3]."""

    young: float
    poisson: float
    thickness: float
    density: float


def flat_shell(
    energy: str,
    mesh: ms.TriangleMesh,
    sheet: Sheet,
    held: NDArray[np.bool_] | None = None,
    supports: Sequence[Support] = (),
    direction: tuple[float, float, float] | None = None,
) -> ms.Shell:
    """Shell of ``sheet`` with one of the ``ENERGIES``, clamped along the vertices ``held``, or on other ``supports``.

    Hinges are calibrated for bending along ``direction``, or along what is longest.

    One held row clamps split folds. Hinges bend at edges between two triangles only: the triangles along the clamped
    line get mirror images behind it, which are held too. Both shells then have the same free vertices, numbered alike,
    and are clamped at the same line.
    """
    if energy == "Isotropic":
        return ms.Shell(mesh, ms.Isotropic(**sheet), clamped=held, supports=supports)
    with warnings.catch_warnings():
        # Obtuse triangles change the membrane alone, and these sheets hardly stretch.
        warnings.simplefilter("ignore", ms.ModalShellWarning)
        material = ms.Material.from_physical(**sheet, mesh=mesh, direction=direction)
        if held is not None:
            mesh, held = with_mirrored_triangles(mesh, held)
            # The images have no part in the calibration of bending; the membrane's is of each triangle and edge.
            material = replace(ms.Material.from_physical(**sheet, mesh=mesh), flexure=material.flexure)
        return ms.Shell(mesh, material, clamped=held, supports=supports)


def with_mirrored_triangles(
    mesh: ms.TriangleMesh, held: NDArray[np.bool_]
) -> tuple[ms.TriangleMesh, NDArray[np.bool_]]:
    """``mesh`` and the mirror images, behind the line x = 0 of ``held``, of its triangles along it; what they hold."""
    rows = np.flatnonzero(held[mesh.faces].sum(axis=1) == 2)
    opposite, images = np.unique(mesh.faces[rows][~held[mesh.faces[rows]]], return_inverse=True)
    count = len(mesh.vertices)
    mirrored = mesh.faces[rows][:, ::-1].copy()  # reversed, so that they face as the others do
    mirrored[~held[mirrored]] = count + images
    vertices = np.vstack([mesh.vertices, mesh.vertices[opposite] * (-1.0, 1.0, 1.0)])
    further = ms.TriangleMesh(vertices, np.vstack([mesh.faces, mirrored]))
    return further, np.append(held, np.ones(len(opposite), dtype=bool))


def displacements_at(shell: ms.Shell, positions: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Displacements (k, 3) [m] at ``points`` of a shell whose parts lie side by side, seen from above."""
    rest = shell.rest_positions
    kept = rest[:, 0] > -1e-9  # without mirror images behind the clamp
    low, high = rest[kept, :2].min(axis=0), rest[kept, :2].max(axis=0)
    margin = 1e-5 * (high - low)  # not beyond the edges by rounding
    inside = np.clip(points[:, :2], low + margin, high - margin)
    return np.asarray(LinearNDInterpolator(rest[kept, :2], (positions - rest)[kept])(inside))
