"""Numbers of theory 17: the stable step of a sheet of springs, a spring across a hinge, and a boid's turn."""

from __future__ import annotations

import numpy as np

import modalshell as ms
from modalshell.crowd.flock import Flock
from modalshell.springs import SheetGrid
from modalshell.springs.mesh_springs import REFERENCE_FOLD, shell_springs


def waves() -> tuple[float, float]:
    """Largest stable step of a sheet in units of sqrt(m / k), and the same of its structural springs alone."""
    steps = []
    for others in (1.0, 0.0):
        grid = SheetGrid(shape=(8, 8), spacing=1.0, particle_mass=1.0, structural=1.0, shear=others, flexion=others)
        steps.append(grid.stable_step())
    return steps[0], steps[1]


def across() -> tuple[float, float]:
    """Energy of the spring across a flat hinge over the hinge's, at half of the reference fold and at twice it."""
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, 0.8, 0.0], [0.5, -0.8, 0.0]])
    mesh = ms.TriangleMesh(corners, [[0, 1, 2], [1, 0, 3]])
    shell = ms.Shell(mesh, ms.Material(stretch=1.0, shear=1.0, flexure=1.0, density=1.0))
    springs = shell_springs(shell)
    number = int(np.flatnonzero((springs.pairs == (2, 3)).all(axis=1))[0])
    found = []
    for fold in (0.5 * REFERENCE_FOLD, 2.0 * REFERENCE_FOLD):
        stretch = 1.6 * (np.cos(0.5 * fold) - 1.0)
        found.append(0.5 * springs.stiffness[number] * stretch**2 / (shell.elements[2].weight[0] * fold**2))
    return found[0], found[1]


def turn() -> float:
    """Angle [degrees] that a boid has left of a right angle to its target after a second at a turning rate of 1 / s."""
    flock = Flock(np.zeros((1, 3)), [[1.0, 0.0, 0.0]], speed=0.0, target=[0.0, 1.0, 0.0], target_weight=1.0)
    for _ in range(1000):
        flock.step(1e-3)
    return float(np.degrees(np.arccos(flock.directions[0, 1])))


def statements() -> list[str]:
    """What the chapter states."""
    both, structural = waves()
    low, high = across()
    return [
        f"steps of {both:.3f} where all three families have the stiffness $k$,",
        f"and of {structural:.3f} with the structural",
        f"{low:.2f} of the hinge's energy at half of the reference of {REFERENCE_FOLD} rad, and {high:.2f} at twice",
        f"after a second {turn():.1f} degrees are left",
    ]


if __name__ == "__main__":
    print(*statements(), sep="\n")
