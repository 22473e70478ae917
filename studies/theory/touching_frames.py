"""Bars of frames in motion under contacts, against DS at rest under the same load: a strip on three colliders."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

import modalshell as ms
from modalshell.contact.contact import stopped
from modalshell.core.typing import Array
from modalshell.models.motion_check import MotionCheck, touching_frames

GRAVITY, DAMPING, STEP, EVERY, MODES = (0.0, 0.0, -9.81), ms.Damping(2.0), 1.0 / 60.0, 6, 8
"""Gravity [m/s^2], damping, step [s], steps from one bar to the next, and modes."""


def contacts() -> list[ms.Contact]:
    """A table, a ball, and a table that rises."""
    risen = ms.SupportPath((0.0, 0.5, 1.5, 2.0), [(0, 0, 0), (0, 0, 0), (0, 0, 0.2), (0, 0, 0.2)])
    return [
        ms.Contact(ms.Plane((0, 0, 1), -0.15)),
        ms.Contact(ms.Sphere((0.7, 0.0, -0.41), 0.3)),
        ms.Contact(ms.Plane((0, 0, 1), -0.25), motion=risen),
    ]


def bars_over_errors() -> tuple[Array, int]:
    """Bar over true error of the frames of MWTS and RSW that are judged, and how many are not."""
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(20, 4))
    sheet = ms.Isotropic(young=1e8, poisson=0.3, thickness=5e-3, density=100.0)
    shell = ms.Shell(mesh, sheet, clamped=mesh.vertices[:, 0] < 1e-6)
    basis, truth = ms.solve_modes(shell, MODES), ms.DiscreteShell(shell)
    ratios: list[float] = []
    left_out = 0
    given: dict[str, Any] = {"duration": 1.6, "dt": STEP, "gravity": GRAVITY, "damping": DAMPING, "bars": EVERY}
    models: tuple[ms.Model, ...] = ms.ModalWarping(basis), ms.RotationStrain(basis)
    for model, contact in itertools.product(models, contacts()):
        run = ms.simulate(model, **given, contacts=[contact])
        assert run.bars is not None
        touching = touching_frames(model, [contact], STEP)
        check = MotionCheck(shell, shell.loading(GRAVITY), DAMPING, touching=touching)
        frames = np.asarray(run.positions, dtype=np.float64)
        moved = np.maximum.accumulate([check.moved(x) for x in frames])
        left_out += sum(map(bool, run.bars.unjudged))
        for time, bar, valid in zip(run.bars.times, run.bars.displacement, run.bars.valid, strict=True):
            if not valid:
                continue
            k = round(float(time) / STEP)
            load = check.load_under(run.times[k - 1 : k + 2], frames[k - 1 : k + 2])[0]
            still = [stopped(contact, float(time))]
            rest = truth.equilibrium(force=load, contacts=still, start=frames[k])
            off = check.norm(rest.positions - frames[k])
            ratios.append(bar * moved[k] / off)
    return np.array(ratios), left_out


if __name__ == "__main__":
    found, unjudged = bars_over_errors()
    print(len(found), unjudged, np.quantile(found, (0.05, 0.5, 0.95)))
