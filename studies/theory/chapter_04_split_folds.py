"""Numbers of theory 4: the hinge that split folds make of two triangles, and what halves of folds make of a twist."""

from __future__ import annotations

import numpy as np
import scipy.sparse.linalg as spla

import modalshell as ms
from modalshell.mesh import TriangleMesh
from modalshell.shell.bending import hinge_operator
from studies.theory.plates import shared_folds

POISSON = 0.3


def condition(mesh: TriangleMesh) -> float:
    """Condition number of the shares' stiffness, scaled to a unit diagonal."""
    stiffness = shared_folds(mesh, POISSON)[2].toarray()
    root = np.sqrt(stiffness.diagonal())
    values = np.linalg.eigvalsh(stiffness / root[:, None] / root)
    return float(values[-1] / values[0])


def hinge(poisson: float) -> float:
    """H of two equilateral triangles with free edges, in units of D."""
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, np.sqrt(0.75)], [0.5, -np.sqrt(0.75)]])
    pair = TriangleMesh(np.column_stack([corners, np.zeros(4)]), [[0, 1, 2], [1, 0, 3]])
    by_folds, coupling, by_shares = shared_folds(pair, poisson)
    return float(by_folds[0, 0] - coupling[0, 0] ** 2 / by_shares[0, 0])


def twist(family: str, cells: int, halves: bool) -> float:
    """Energy of w = x y over the exact one, with halves of folds or with the least shares."""
    mesh = ms.sheet(length=1.0, width=1.0, cells=(cells, cells), family=family)
    by_folds, coupling, by_shares = shared_folds(mesh, POISSON)
    folds = hinge_operator(mesh) @ (mesh.vertices[:, 0] * mesh.vertices[:, 1])
    energy = 0.5 * folds @ by_folds @ folds
    if not halves:
        energy -= 0.5 * (coupling @ folds) @ spla.spsolve(by_shares.tocsc(), coupling @ folds)
    return float(energy / ((1.0 - POISSON) * mesh.area))


def statements() -> list[str]:
    """What the chapter states."""
    families = {"union-jack": "union-jack", "equilateral": "equilateral", "Delaunay": "delaunay"}
    union_jack, equilateral, delaunay = (
        f"{condition(ms.sheet(length=1.0, width=1.0, cells=(12, 12), family=family)):.1f} ({name})"
        for name, family in families.items()
    )
    assert np.isclose(hinge(POISSON), 3.0 * np.sqrt(3.0) * (1.0 - POISSON**2) / (5.0 + 3.0 * POISSON), rtol=1e-12)
    assert all(np.isclose(twist(family, 12, False), 1.0, rtol=1e-9) for family in families.values())
    ratios = [twist("union-jack", cells, True) for cells in (12, 24)]
    rim = (1.0 + POISSON) ** 2
    for cells, ratio in zip((12, 24), ratios, strict=True):
        assert np.isclose(ratio, 2.0 / (1.0 - POISSON) * (1.0 - rim / (2.0 * cells)), rtol=1e-9)
    even = [twist("equilateral", cells, True) for cells in (12, 24)]
    return [
        f"{1.0 - rim / 4.0:.4f} at the $\\nu = {POISSON}$ of these numbers",
        f"{union_jack}, {equilateral} and {delaunay}",
        f"which is {hinge(POISSON):.4f} D at a Poisson's ratio of {POISSON}",
        f"on union-jack sheets of 12 and 24 cells the twist is {ratios[0]:.2f} and {ratios[1]:.2f} times too stiff",
        f"on equilateral sheets {even[0]:.3f} and {even[1]:.3f} times",
    ]


if __name__ == "__main__":
    print(*statements(), sep="\n")
