"""Numbers of theory 1: constants of a sheet, and its drop under its own weight in linear theory."""

from __future__ import annotations

import numpy as np

import modalshell as ms

YOUNG, POISSON, THICKNESS, DENSITY, LENGTH, GRAVITY = 1e8, 0.3, 5e-3, 100.0, 1.0, 9.81
"""Of the strip in the first example of the main page, in SI units."""


def statements() -> list[str]:
    """What the chapter states."""
    rigidity = YOUNG * THICKNESS**3 / (12.0 * (1.0 - POISSON**2))
    membrane = YOUNG * THICKNESS / (1.0 - POISSON**2)
    strip = YOUNG * THICKNESS**3 / 12.0
    weight = DENSITY * THICKNESS * GRAVITY
    mesh = ms.flat_beam(length=LENGTH, width=0.2, cells=(40, 8))
    material = ms.Isotropic(young=YOUNG, poisson=POISSON, thickness=THICKNESS, density=DENSITY)
    shell = ms.Shell(mesh, material, clamped=mesh.vertices[:, 0] < 1e-6)
    assert np.isclose(membrane * LENGTH**2 / rigidity, 12.0 * (LENGTH / THICKNESS) ** 2)
    return [
        f"a bending stiffness of {rigidity:.3f} N m, a weight of {weight:.3f} N/m^2",
        f"a length of {(strip / weight) ** (1.0 / 3.0):.3f} m",
        f"as a narrow strip {weight * LENGTH**3 / strip:.3f}, "
        f"as a wide one {weight * LENGTH**3 / rigidity:.3f}, "
        f"and by its own linear drop {GRAVITY * ms.measure.gamma_per_gravity(shell):.3f}",
    ]


if __name__ == "__main__":
    print(*statements(), sep="\n")
