"""The benchmarks of Sze, Liu and Lo (2004): shells, loads and watched displacements.

Each function takes a mesh family and the cells along and across of the unit square that is mapped onto the surface. 3.4
to 3.7 are parts of a symmetric shell, between planes of symmetry.
"""

from __future__ import annotations

import warnings
from typing import NamedTuple

import numpy as np

import modalshell as ms
from modalshell.supports import Support
from studies.shell_theory import near, quarter_cylinder, spread, square

X, Y, Z = np.eye(3)
GRADING = 1.3
"""Power that draws the cells of a pinched cylinder together where it is pinched."""


class Problem(NamedTuple):
    """A shell, its whole load, forces (n, 3) [N] and others, and the watched vertices, each with a direction."""

    shell: ms.Shell
    force: np.ndarray
    watched: list[tuple[int, np.ndarray]]
    moment: tuple[np.ndarray, float] | None = None


def strip(family: str, cells: tuple[int, int], length: float) -> tuple[ms.Shell, np.ndarray, int]:
    """A cantilever of width 1 and thickness 0.1; which vertices are its end, and the one in their middle."""
    plain = square(family, cells)
    mesh = ms.TriangleMesh(plain.vertices * (length, 1.0, 1.0), plain.faces)
    x = mesh.vertices[:, 0]
    shell = ms.Shell(mesh, ms.Isotropic(1.2e6, 0.0, 0.1, 1.0), clamped=x < 1e-9)
    return shell, np.isclose(x, length), near(mesh, (length, 0.5, 0.0))


def eighth_of_cylinder(u: np.ndarray, v: np.ndarray, diaphragm: bool) -> list[Support]:
    """Planes of symmetry of an eighth of a cylinder, and a rigid diaphragm at its end."""
    planes: list[Support] = [
        ms.Symmetry(np.isclose(u, 0.0), (0.0, 1.0, 0.0)),
        ms.Symmetry(np.isclose(v, 0.0), (0.0, 0.0, 1.0)),
        ms.Symmetry(np.isclose(v, 1.0), (1.0, 0.0, 0.0)),
    ]
    return [*planes, ms.Diaphragm(np.isclose(u, 1.0), axis=(0.0, 1.0, 0.0))] if diaphragm else planes


def cantilever(family: str, cells: tuple[int, int]) -> Problem:
    """3.1: length 10, width 1, thickness 0.1; the shear at its end is 4."""
    shell, end, tip = strip(family, cells, 10.0)
    return Problem(shell, spread(shell.mesh, end, 4.0 * Z), [(tip, -X), (tip, Z)])


def ring(family: str, cells: tuple[int, int]) -> Problem:
    """3.2: length 12, width 1, thickness 0.1; the moment at its end is 50 pi / 3, which bends it to a full ring."""
    shell, end, tip = strip(family, cells, 12.0)
    return Problem(shell, np.zeros_like(shell.rest_positions), [(tip, -X), (tip, Z)], (end, 50.0 * np.pi / 3.0))


def annulus(family: str, cells: tuple[int, int]) -> Problem:
    """3.3: radii 6 and 10, thickness 0.03; one side of the slit is clamped, the other lifted by 0.8 a length."""
    plain = square(family, cells)
    u, v, _ = plain.vertices.T
    radius, angle = 6.0 * (10.0 / 6.0) ** v, 2.0 * np.pi * u
    points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), 0.0 * u])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ms.ModalShellWarning)  # the slit is meant
        mesh = ms.TriangleMesh(points, plain.faces[:, ::-1])
    shell = ms.Shell(mesh, ms.Isotropic(21e6, 0.0, 0.03, 1.0), clamped=u < 1e-9)
    end = np.isclose(u, 1.0)
    inner, outer = (int(np.flatnonzero(end)[pick(radius[end])]) for pick in (np.argmin, np.argmax))
    return Problem(shell, spread(mesh, end, 3.2 * Z), [(inner, Z), (outer, Z)])


def hemisphere(family: str, cells: tuple[int, int]) -> Problem:
    """3.4: a quarter of radius 10 and thickness 0.04 with a hole of 18 degrees; 400 pulls at A and pushes at B."""
    plain = square(family, cells)
    u, v, _ = plain.vertices.T
    low = np.log(np.tan(np.radians(9.0)))
    polar, angle = 2.0 * np.arctan(np.exp(low * (1.0 - u))), 0.5 * np.pi * v  # angles are kept
    points = 10.0 * np.column_stack([np.sin(polar) * np.cos(angle), np.sin(polar) * np.sin(angle), np.cos(polar)])
    mesh = ms.TriangleMesh(points, plain.faces)
    pulled, pushed = near(mesh, (0.0, 10.0, 0.0)), near(mesh, (10.0, 0.0, 0.0))
    supports: list[Support] = [
        ms.Symmetry(np.isclose(v, 1.0), (1.0, 0.0, 0.0)),
        ms.Symmetry(np.isclose(v, 0.0), (0.0, 1.0, 0.0)),
        ms.Fix([near(mesh, tuple(points[np.isclose(u, 0.0)][0]))], axes="z"),
    ]
    shell = ms.Shell(mesh, ms.Isotropic(6.825e7, 0.3, 0.04, 1.0), supports=supports)
    force = np.zeros_like(points)
    force[pulled], force[pushed] = 200.0 * Y, -200.0 * X  # halves: both lie in a plane of symmetry
    return Problem(shell, force, [(pulled, Y), (pushed, -X)])


def cylinder(family: str, cells: tuple[int, int]) -> Problem:
    """3.5: an eighth of radius 4.953, length 10.35 and thickness 0.094; 40,000 pull at its middle."""
    mesh, u, v = quarter_cylinder(family, cells, 4.953, 5.175)
    supports = eighth_of_cylinder(u, v, diaphragm=False)
    shell = ms.Shell(mesh, ms.Isotropic(10.5e6, 0.3125, 0.094, 1.0), supports=supports)
    pulled = near(mesh, (0.0, 0.0, 4.953))
    force = np.zeros_like(mesh.vertices)
    force[pulled] = 10000.0 * Z
    beside, end = near(mesh, (4.953, 0.0, 0.0)), near(mesh, (4.953, 5.175, 0.0))
    return Problem(shell, force, [(pulled, Z), (beside, -X), (end, -X)])


def pinched_cylinder(family: str, cells: tuple[int, int]) -> Problem:
    """3.6: an eighth of radius 100, length 200 and thickness 1 between rigid diaphragms; 12,000 push at its middle.

    Cells are smaller towards the force: equal ones leave its dent twice as far off.
    """
    mesh, u, v = quarter_cylinder(family, cells, 100.0, 100.0, GRADING)
    supports = eighth_of_cylinder(u, v, diaphragm=True)
    shell = ms.Shell(mesh, ms.Isotropic(30e3, 0.3, 1.0, 1.0), supports=supports)
    pushed, beside = near(mesh, (0.0, 0.0, 100.0)), near(mesh, (100.0, 0.0, 0.0))
    force = np.zeros_like(mesh.vertices)
    force[pushed] = -3000.0 * Z
    return Problem(shell, force, [(pushed, -Z), (beside, X)])


def semi_cylinder(family: str, cells: tuple[int, int]) -> Problem:
    """3.7: a half of radius 1.016, length 3.048 and thickness 0.03, clamped at one end; 2,000 push at the other.

    Its straight edges keep their height and do not turn: they lie in a plane of symmetry.
    """
    mesh, u, v = quarter_cylinder(family, cells, 1.016, 3.048)
    supports: list[Support] = [
        ms.Clamp(np.isclose(u, 0.0)),
        ms.Symmetry(np.isclose(v, 0.0), (0.0, 0.0, 1.0)),
        ms.Symmetry(np.isclose(v, 1.0), (1.0, 0.0, 0.0)),
    ]
    shell = ms.Shell(mesh, ms.Isotropic(20.685e6, 0.3, 0.03, 1.0), supports=supports)
    pushed = near(mesh, (0.0, 3.048, 1.016))
    force = np.zeros_like(mesh.vertices)
    force[pushed] = -1000.0 * Z
    return Problem(shell, force, [(pushed, -100.0 * Z)])  # the table's unit is a hundredth


PROBLEMS = {
    "3.1": cantilever,
    "3.2": ring,
    "3.3": annulus,
    "3.4": hemisphere,
    "3.5": cylinder,
    "3.6": pinched_cylinder,
    "3.7": semi_cylinder,
}
"""The problems by their sections."""
