"""Numbers of theory 2: errors of the warp of a strip, the asymmetry of its modal force, and the drift of its sum."""

from __future__ import annotations

import numpy as np

import modalshell as ms
from studies.pages import committed

CELLS, MODES, GAMMAS = (20, 4), 8, (1.0, 4.0, 16.0)
RIGIDITY, WEIGHT = 1e8 * 5e-3**3 / 12.0, 0.5
"""Of a strip of length 1 m: D [N m] and mass per area [kg/m^2]."""


def strip() -> ms.Shell:
    """A strip of Poisson's ratio 0, five times as long as wide, clamped at one end."""
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=CELLS)
    material = ms.Isotropic(young=1e8, poisson=0.0, thickness=5e-3, density=100.0)
    return ms.Shell(mesh, material, clamped=mesh.vertices[:, 0] < 1e-9)


def statements() -> list[str]:
    """What the chapter states."""
    shell = strip()
    basis = ms.solve_modes(shell, MODES)
    warping = ms.ModalWarping(basis)
    models = ms.LinearModal(basis), warping, ms.ModalWarping(basis, consistent_force=True), ms.RotationStrain(basis)
    rows = []
    for gamma in GAMMAS:
        gravity = (0.0, 0.0, -gamma * RIGIDITY / WEIGHT)
        truth = ms.DiscreteShell(shell).equilibrium(gravity=gravity).positions
        tip = -truth[shell.rest_positions[:, 0] > 1.0 - 1e-9, 2].mean()
        answers = [model.equilibrium(gravity=gravity).positions for model in models]
        errors = [100.0 * ms.measure.displacement_error(answer, truth, shell) for answer in answers]
        areas = [100.0 * ms.measure.area_change(answer, shell.mesh) for answer in answers[:2]]
        columns = [f"{tip:.2f}", *(f"{each:.3g}" for each in errors), *(f"{each:.1f}" for each in areas)]
        rows.append(f"| {gamma:g} | {' | '.join(columns)} |")
    slope = warping.modal_force_jacobian(np.zeros(MODES), shell.gravity_force((0.0, 0.0, -1.0)))
    asymmetry = np.linalg.norm(slope - slope.T) / np.linalg.norm(slope)
    drift = committed("integrator_drift").findings
    v_beam, flat = (100.0 * drift[scene]["loop"]["path_part"] for scene in ("v_beam", "strip"))
    return [
        *rows,
        f"in the Frobenius norm is {asymmetry:.2f}",
        f"by {v_beam:.1f} % of the length (a V-beam) and {flat:.0f} % (a strip)",
    ]


if __name__ == "__main__":
    print(*statements(), sep="\n")
