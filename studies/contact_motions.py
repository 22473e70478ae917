"""Motions of the study ``contact_truth``: strips that fall on bodies and slide, and modal rungs on a table."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import modalshell as ms
from modalshell.core.typing import Array
from modalshell.motion import Motion

GRAVITY = 9.81
FRICTION = 0.4
BODIES = {
    "floor": ms.Contact(ms.Plane()),
    "floor, with friction": ms.Contact(ms.Plane(), friction=FRICTION),
    "ball": ms.Contact(ms.Sphere((0, 0, -0.05), 0.2)),
    "cylinder": ms.Contact(ms.Cylinder((0, -1, 0), (0, 1, 0), 0.15)),
    "rounded box": ms.Contact(ms.Box((0, 0, 0), (0.2, 0.3, 0.15), rounding=0.05)),
    "table, held at an end": ms.Contact(ms.Plane((0, 0, 1), -0.3)),
}
"""What a strip of a metre falls on."""
TILTED = (0.3, 0.2, 0.1)
STRIKES: dict[str, tuple[ms.Collider, float, tuple[int, int], tuple[float, float, float], float]] = {
    "panel, ball": (ms.Sphere((0.25, 0.1, -0.4), 0.2), 0.3, (8, 6), TILTED, 1e8),
    "panel, ball, 100 times as stiff": (ms.Sphere((0.25, 0.1, -0.4), 0.2), 0.3, (8, 6), TILTED, 1e10),
    "strip, ball": (ms.Sphere((0.25, 0.0, -0.4), 0.2), 0.03, (24, 2), (0.0, 0.2, 0.0), 1e8),
    "panel, cylinder": (ms.Cylinder((0.2, -2, -0.4), (0.2, 2, -0.4), 0.2), 0.3, (8, 6), (0.0, 0.2, 0.0), 1e8),
}
"""Body, width [m], cells, turns [rad] and modulus [Pa] of what falls on it."""
FRAMES, QUICK_FRAMES = 120, 10
"""Frames of a cantilever on a table whose time is taken, after as many in which it comes down."""


def fall(integrator: str, thickness: float, steps: int) -> dict[str, Any]:
    """A tilted strip falls on a floor and comes down flat."""
    mesh = ms.flat_beam(length=1.0, width=0.1, cells=(40, 4))
    shell = ms.Shell(mesh, ms.Isotropic(young=1e8, poisson=0.3, thickness=thickness, density=500.0))
    x = mesh.vertices[:, 0] - 0.5
    start = np.stack([x * np.cos(0.3), mesh.vertices[:, 1], x * np.sin(0.3) + 0.35], axis=1)
    model = ms.DiscreteShell(shell, integrator=integrator)
    given: dict[str, Any] = {"duration": steps / 60, "dt": 1 / 60, "gravity": (0, 0, -GRAVITY), "start": start}
    rows: dict[str, Any] = {}
    for name, friction in (("smooth", 0.0), ("rough", FRICTION)):
        run = ms.simulate(model, contacts=[ms.Contact(ms.Plane(), friction=friction)], **given)
        gained = float(np.diff(run.energies.sum(axis=1)).max() / np.ptp(run.energies[:, 2]))
        rows |= {f"gained {name}": gained, f"unsolved {name}": run.unconverged_steps}
        rows |= {f"deepest {name}": max(0.0, -float(run.positions[..., 2].min()))}
    return {"integrator": integrator, "thickness": thickness, **rows}


def motion_on(body: str, thickness: float, steps: int) -> dict[str, Any]:
    """A strip falls on a body, in steps of implicit Euler."""
    mesh = ms.flat_beam(length=1.0, width=0.1, cells=(30, 3))
    held = "x < 1e-6" if "held" in body else None
    sheet = ms.Isotropic(young=1e8, poisson=0.3, thickness=thickness, density=500.0)
    shell, start = ms.Shell(mesh, sheet, clamped=held), None
    if held is None:
        x = mesh.vertices[:, 0] - 0.5
        start = np.stack([x * np.cos(0.3), mesh.vertices[:, 1], x * np.sin(0.3) + 0.35], axis=1)
    model = ms.DiscreteShell(shell, integrator="implicit")
    given: dict[str, Any] = {"duration": steps / 60, "dt": 1 / 60, "gravity": (0, 0, -GRAVITY), "start": start}
    run = ms.simulate(model, contacts=[BODIES[body]], **given)
    gained = np.diff(run.energies.sum(axis=1)) / np.ptp(run.energies[:, 2])
    return {
        "body": body,
        "thickness": thickness,
        "touching": int(run.in_contact.any(axis=1).sum()),
        "gained": max(0.0, float(gained.max())),
        "unsolved": run.unconverged_steps,
        "deepest": float(run.deepest.max()),
    }


def slope(share: float) -> dict[str, Any]:
    """A strip on a slope of ``share`` times the tangent at which a block begins to slide."""
    angle = float(np.arctan(share * FRICTION))
    gravity = GRAVITY * np.array([np.sin(angle), 0.0, -np.cos(angle)])
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(16, 2))
    shell = ms.Shell(mesh, ms.Isotropic(young=1e8, poisson=0.3, thickness=1e-3, density=500.0))
    contact, dt = ms.Contact(ms.Plane(), friction=FRICTION), 1 / 60
    run = ms.simulate(
        ms.DiscreteShell(shell, integrator="bdf2"), duration=0.5, dt=dt, gravity=gravity, contacts=[contact]
    )
    x = run.positions[..., 0].mean(axis=1)
    # Both in the mean of the last step.
    block = max(0.0, GRAVITY * (np.sin(angle) - FRICTION * np.cos(angle)) * (0.5 - 0.5 * dt))
    return {"share": share, "speed": float(x[-1] - x[-2]) / dt, "block": float(block)}


def strike(case: str) -> dict[str, Any]:
    """A free shell falls on a body by RSW and by discrete shells, both in steps of implicit Euler.

    Differences are those of positions in the next tenth of a second, over the shell's length.
    """
    body, width, cells, turns, young = STRIKES[case]
    mesh = ms.sheet(length=0.4, width=width, cells=cells)
    shell = ms.Shell(mesh, ms.Isotropic(young=young, poisson=0.3, thickness=3e-3, density=300.0))
    centre = shell.rest_positions.mean(axis=0)
    start = (shell.rest_positions - centre) @ Rotation.from_euler("xyz", turns).as_matrix().T + centre
    rung, truth = ms.RotationStrain(ms.solve_modes(shell, count=14)), ms.DiscreteShell(shell, integrator="implicit")

    def run(model: ms.Model, finer: int) -> ms.Trajectory:
        given: dict[str, Any] = {"gravity": (0, 0, -GRAVITY), "damping": (1.0, 0.0), "contacts": [ms.Contact(body)]}
        return ms.simulate(model, duration=0.325, dt=1 / (120 * finer), start=start, **given)

    ours, coarse, fine = run(rung, 1), run(truth, 1), run(truth, 4)
    first = int(coarse.in_contact.any(axis=1).argmax())

    def apart(one: Any, other: Any) -> float:
        off: Array = ((one - other)[first : first + 12] ** 2).sum(axis=2).mean(axis=1)
        return float(np.sqrt(off).max() / shell.size)

    return {
        "case": case,
        "apart": apart(ours.positions, coarse.positions),
        "by step": apart(coarse.positions, fine.positions[::4]),
        "stored": float(ours.energies[:, 1].max() / coarse.energies[:, 1].max()),
    }


def on_table(modes: int, quick: bool = False) -> list[dict[str, Any]]:
    """A cantilever at rest on a table by each rung, and what a frame of its motion there costs."""
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(40, 8))
    sheet = ms.Isotropic(young=1e8, poisson=0.3, thickness=5e-3, density=100.0)
    shell = ms.Shell(mesh, sheet, clamped="x < 1e-6")
    given: dict[str, Any] = {"gravity": (0, 0, -GRAVITY), "contacts": [ms.Contact(ms.Plane((0, 0, 1), -0.15))]}
    truth = ms.DiscreteShell(shell).equilibrium(**given)
    basis, rows, frames = ms.solve_modes(shell, count=modes), [], QUICK_FRAMES if quick else FRAMES
    for rung in (ms.LinearModal, ms.ModalWarping, ms.RotationStrain):
        model = rung(basis)
        state, seconds = model.equilibrium(**given), []
        for contacts in (None, given["contacts"], None, given["contacts"]):  # the first two compile
            loading = shell.loading(given["gravity"], None, None)
            motion = Motion(model, loading, dt=1 / 60, damping=(1.0, 0.0), contacts=contacts)
            for _ in range(frames):  # among them those that find what is kept of each vertex
                motion.advance()
            begin = time.process_time()
            for _ in range(frames):
                motion.advance()
                motion.positions()
            seconds.append((time.process_time() - begin) / frames)
        rows.append(
            {
                "model": model.name,
                "modes": modes,
                "converged": state.converged,
                "iterations": state.iterations,
                "error": ms.measure.displacement_error(state.positions, truth.positions, shell),
                "force": float(state.contact_forces[:, 2].sum() / truth.contact_forces[:, 2].sum()) - 1.0,
                "deepest": state.deepest,
                "free": 1e3 * seconds[2],
                "touching": 1e3 * seconds[3],
            }
        )
    return rows
