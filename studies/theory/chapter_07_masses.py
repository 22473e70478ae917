"""Numbers of theory 7: the rotary inertia of strips by thirds and by corrected masses."""

from __future__ import annotations

import numpy as np

import modalshell as ms
from modalshell.mesh import TriangleMesh
from modalshell.shell import vertex_masses as module
from modalshell.shell.vertex_masses import vertex_masses

WIDTH = 0.2


def strip(family: str, across: int) -> TriangleMesh:
    """A strip of five widths with a number of cells across."""
    stretch = 2.0 / np.sqrt(3.0) if family == "equilateral" else 1.0
    cells = (round(5 * across * stretch), across)
    return ms.flat_beam(length=5.0 * WIDTH, width=WIDTH, cells=cells, family=family)


def inertia_errors(mesh: TriangleMesh) -> tuple[float, float]:
    """Errors [%] of the rotary inertia about the axis, by thirds and by corrected masses."""
    exact = mesh.area * WIDTH**2 / 12.0
    nobody = np.zeros(len(mesh.vertices), dtype=bool)
    masses = mesh.shared_among_corners(mesh.face_areas), vertex_masses(mesh, np.ones(len(mesh.faces)), nobody)
    thirds, corrected = (100.0 * (mass @ mesh.vertices[:, 1] ** 2 / exact - 1.0) for mass in masses)
    return float(thirds), float(corrected)


def statements() -> list[str]:
    """What the chapter states."""
    rows = []
    for family in ("union-jack", "alternating", "equilateral", "delaunay", "lloyd"):
        errors = [inertia_errors(strip(family, across)) for across in (4, 8)]
        rows.append(f"| {family} | " + " | ".join(f"{each:.1f}" for pair in errors for each in pair) + " |")
    for across in (4, 8):
        thirds, corrected = inertia_errors(strip("alternating", across))
        assert np.isclose(thirds, 100.0 * 2.0 / across**2)
        assert np.isclose(corrected, 100.0 * 2.0 / across**3)
    return [*rows, f"no vertex is left with less than {module._LEAST} of its thirds"]


if __name__ == "__main__":
    print(*statements(), sep="\n")
