"""Numbers of theory 6: in-plane bending of a clamped strip, by several parts of triangles' areas for their edges."""

from __future__ import annotations

from unittest.mock import patch

import numpy as np
import scipy.sparse as sps
import scipy.sparse.linalg as spla

import modalshell as ms
from modalshell.mesh import TriangleMesh
from modalshell.shell import smoothed_membrane as membrane
from modalshell.shell.triangle_pairs import LIKE_POISSON

POISSON, LENGTH, WIDTH = 0.3, 5.0, 1.0
THIRDS, LINEAR, FOURTH = 0, 2, membrane.SHARE_EXPONENT
LEAST = membrane._LEAST_POWER


def stiffness(mesh: TriangleMesh, power: int, least: float) -> sps.csr_array:
    """Theory 6, eq. 7 at rest in the plane (2n, 2n), E h = 1, of a strip that is clamped at x = 0."""
    count, edges = len(mesh.vertices), mesh.edges
    clamped, none = mesh.vertices[:, 0] < 1e-9, np.zeros(0, dtype=np.int64)
    with patch.object(membrane, "SHARE_EXPONENT", power), patch.object(membrane, "_LEAST_POWER", least):
        strained = membrane.strained_elements(mesh, clamped, np.ones(len(mesh.hinges), dtype=bool), none)
    triangles = len(mesh.faces)
    elastic = membrane.plane_stress(np.full(triangles, 1.0 / (1.0 - POISSON**2)), np.full(triangles, POISSON))
    tension = membrane.membrane_matrix(membrane.membrane_elements(strained, elastic), len(edges))
    sides = (mesh.vertices[edges[:, 1]] - mesh.vertices[edges[:, 0]])[:, :2]
    rows = np.repeat(np.arange(len(edges)), 4)
    columns = (2 * edges[:, :, None] + np.arange(2)).ravel()
    slopes = sps.csr_array((np.stack([-sides, sides], axis=1).ravel(), (rows, columns)), shape=(len(edges), 2 * count))
    return sps.csr_array(slopes.T @ tension @ slopes)


def deflection(family: str, cells: tuple[int, int], power: int = FOURTH, least: float = LEAST) -> float:
    """Mean deflection in the plane of a strip that is clamped at one end, under a uniform load along its width."""
    mesh = ms.flat_beam(length=LENGTH, width=WIDTH, cells=cells, family=family)
    free = np.flatnonzero(np.repeat(mesh.vertices[:, 0] > 1e-9, 2))
    load = np.zeros((len(mesh.vertices), 2))
    load[:, 1] = mesh.shared_among_corners(mesh.face_areas) / mesh.area
    matrix = stiffness(mesh, power, least)[free][:, free].tocsc()
    return float(load.ravel()[free] @ spla.spsolve(matrix, load.ravel()[free]))


def statements() -> list[str]:
    """What the chapter states."""
    coarse, fine = (deflection("union-jack", (5 * across, across)) for across in (16, 32))
    exact = (4.0 * fine - coarse) / 3.0
    rows = []
    for family in ("union-jack", "right", "equilateral", "delaunay"):
        errors = [100.0 * (deflection(family, (20, 4), power) / exact - 1.0) for power in (THIRDS, LINEAR, FOURTH)]
        rows.append(f"| {family} | {' | '.join(f'{error:.1f}' for error in errors)} |")
    finer = [100.0 * (1.0 - deflection("union-jack", (40, 8), power) / exact) for power in (THIRDS, FOURTH)]
    slender = [deflection("right", (20, 1), FOURTH, least) / exact for least in (1e-12, LEAST)]
    return [
        *rows,
        f"with a Poisson's ratio of {POISSON}",
        f"or Poisson's ratio by more than {LIKE_POISSON}:",
        f"it falls to {finer[0]:.1f} % by thirds and to {finer[1]:.2f} % by the fourth power",
        f"{slender[0]:.0f} times too far without a least part and {slender[1]:.1f} times with it",
        f"by at least {LEAST} of",
    ]


if __name__ == "__main__":
    print(*statements(), sep="\n")
