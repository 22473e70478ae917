"""Numbers of theory 14: bars and margins of a folded beam before its snap and past it."""

from __future__ import annotations

import functools

import numpy as np

import modalshell as ms
from modalshell.statics.error_bar import LARGEST_BAR, LEAST_MARGIN
from studies.theory.touching_frames import bars_over_errors

BEFORE, PAST, MODES = (0.5, 1.0, 2.0, 3.0), 15.0, 8
"""Gravity [m/s^2] before the snap, and past it."""
BRACKET = 5.0, 7.0
"""Gravity about the end of the branch."""


@functools.cache
def model() -> ms.RotationStrain:
    """RSW of a V-beam of shell theory, clamped at one end."""
    mesh = ms.v_beam(length=1.0, width=0.2, fold=150.0, cells=(16, 4))
    sheet = ms.Isotropic(young=9e7, poisson=0.3, thickness=0.0022, density=90.0)
    shell = ms.Shell(mesh, sheet, clamped=mesh.vertices[:, 0] < 1e-6)
    return ms.RotationStrain(ms.solve_modes(shell, MODES))


def found(gravity: float) -> tuple[float, ms.ErrorBar]:
    """True error of RSW, and its bar."""
    rung, truth = model(), ms.DiscreteShell(model().shell)
    load = (0.0, 0.02 * gravity, -gravity)
    answer, exact = rung.equilibrium(gravity=load), truth.equilibrium(gravity=load)
    error = ms.measure.displacement_error(answer.positions, exact.positions, rung.shell)
    return error, ms.error_bar(rung, answer)


def led_on_a_floor() -> tuple[float, float]:
    """True error of RSW of a strip on a floor whose end is lifted, and its bar."""
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(12, 2))
    sheet = ms.Isotropic(young=1e8, poisson=0.3, thickness=5e-3, density=100.0)
    shell = ms.Shell(mesh, sheet, clamped=mesh.vertices[:, 0] < 1e-6)
    end = np.flatnonzero(mesh.vertices[:, 0] > 1.0 - 1e-6)
    lifted = ms.PositionConstraint(end, mesh.vertices[end].mean(axis=0) + np.array([-0.004, 0.0, 0.04]))
    floor = ms.Contact(ms.Plane((0.0, 0.0, 1.0), -0.01))
    answer, exact = (
        one.equilibrium(gravity=(0.0, 0.0, -9.81), contacts=[floor], constraints=[lifted])
        for one in (ms.RotationStrain(ms.solve_modes(shell, MODES)), ms.DiscreteShell(shell))
    )
    error = ms.measure.displacement_error(answer.positions, exact.positions, shell)
    return error, ms.error_bar(shell, answer).displacement


def statements() -> list[str]:
    """What the chapter states."""
    rows, foretold = [], []
    for gravity in BEFORE:
        error, bar = found(gravity)
        ratio = bar.displacement / error
        rows.append(f"| {gravity:g} | {100 * error:.2g} | {ratio:.2f} | {bar.margin:.2f} |")
        foretold.append(gravity * bar.critical_load)
    error, bar = found(PAST)
    about = [100.0 * found(gravity)[0] for gravity in BRACKET]
    ratios, left_out = bars_over_errors()
    ranks, led = (5, 50, 95), led_on_a_floor()
    spread = " | ".join(f"{one:.3f}" for one in np.percentile(ratios, ranks))
    return [
        *rows,
        f"exceeds {LEAST_MARGIN}. Below, it is void. Above a bar of {LARGEST_BAR}",
        f"at {PAST:g} m/s^2 RSW is {100 * error:.0f} % off, and two steps alone read {100 * bar.displacement:.1f} %",
        f"The margin there is {bar.margin:.1f}",
        f"foretell the end of the branch at {min(foretold):.2f} to {max(foretold):.2f} m/s^2",
        "bar over error, " + " | ".join(f"{rank} %" for rank in ranks),
        f"| {len(ratios)} | {spread} | {left_out} |",
        f"RSW is {100 * led[0]:.2f} % off DS, and its bar reads {100 * led[1]:.2f} %",
        f"RSW is {about[0]:.0f} % off at {BRACKET[0]:g} m/s^2 and {about[1]:.0f} % at {BRACKET[1]:g}",
    ]


if __name__ == "__main__":
    print(*statements(), sep="\n")
