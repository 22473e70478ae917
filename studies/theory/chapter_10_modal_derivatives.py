"""Numbers of theory 10: modal derivatives of strips of several thicknesses, modes without them, and a cubature."""

from __future__ import annotations

import numpy as np

import modalshell as ms
from modalshell.models.reduction.derivatives import edge_changes
from modalshell.models.reduction.reduced_energy import ReducedEnergy, ReducedPotential
from modalshell.statics.continuation import equilibrium
from studies.theory.chapter_09_rotation_strain import strip

GAMMA, MODES = 4.0, 4


def errors(poisson: float, slenderness: int) -> tuple[float, float]:
    """Errors [%] of the displacements with the derivatives, and with the modes alone."""
    shell, gravity = strip(poisson, 1.0 / slenderness), (0.0, 0.0, -GAMMA)
    truth = ms.DiscreteShell(shell).equilibrium(gravity=gravity).positions
    model = ms.ModalDerivatives(shell, MODES)
    modes = model.basis.modes
    push = shell.gravity_force(gravity).ravel() @ modes.modes

    def change(z: np.ndarray) -> float:
        return float(edge_changes(shell, (modes.modes @ z).reshape(-1, 3, 1)).max())

    energy = ReducedEnergy(shell, modes.modes)
    alone = ReducedPotential(push, np.zeros_like(push), energy, np.sqrt(modes.eigenvalues), change)
    answers = model.equilibrium(gravity=gravity).positions, energy.positions(equilibrium(alone, None).point)
    found, locked = (100.0 * ms.measure.displacement_error(answer, truth, shell) for answer in answers)
    return found, locked


def statements() -> list[str]:
    """What the chapter states."""
    rows = []
    for poisson in (0.0, 0.3):
        for slenderness in (100, 300, 1000):
            found, locked = errors(poisson, slenderness)
            rows.append(f"| {poisson} | {slenderness} | {found:.2g} | {locked:.0f} |")
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(40, 8))
    fine = ms.Shell(mesh, ms.Isotropic(12e6, 0.3, 1e-2, 100.0), clamped=mesh.vertices[:, 0] < 1e-9)
    cubature = ms.ModalDerivatives(fine, MODES, cubature=True).cubature
    assert cubature is not None
    return [
        *rows,
        f"takes {100.0 * cubature.share:.0f} % of the elements and is within {100.0 * cubature.held_out_error:.2f} %",
    ]


if __name__ == "__main__":
    print(*statements(), sep="\n")
