"""A strip that turns about its clamp in long steps, damped by its stiffness."""

from __future__ import annotations

import numpy as np

import modalshell as ms

STEP, VISCOSITY = 0.2, 0.05
"""Long step and damping by the stiffness [s]."""


def held_back(rule: str) -> float:
    """Most that a strip damped by its stiffness is off in long steps, against short ones of the composite rule [m]."""
    mesh = ms.flat_beam(length=1.0, width=0.1, cells=(12, 2))
    shell = ms.Shell(mesh, ms.Isotropic(1e8, 0.3, 2e-3, 500.0), clamped="x < 1e-6")
    frames = [
        ms.simulate(
            ms.DiscreteShell(shell, integrator=key), duration=1.0, dt=STEP / parts, gravity=(0.0, 0.0, -0.5),
            damping=(0.0, VISCOSITY), store_every=parts,
        ).positions
        for key, parts in ((rule, 1), ("composite", 32))
    ]  # fmt: skip
    return float(np.linalg.norm(frames[0] - frames[1], axis=2).max())
