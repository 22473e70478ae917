"""Where steps are at their limits: free panels, stiff sheets that are let go, and what an error costs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import modalshell as ms
from modalshell.core.typing import Progress
from modalshell.models.base.implicit import implicit_rule
from modalshell.motion import Motion
from studies.motion_rungs import FULL_RULES, first_frequency, moved, rungs, strip, weight
from studies.pages import counted

PANEL = ms.Isotropic(young=1e8, poisson=0.3, thickness=2e-3, density=1000.0)
PANEL_CELLS, PANEL_MODES = (6, 6), 10
ARC, STRETCH = np.radians(60.0), 1e-3
"""Angle [rad] of the arc that a free sheet is bent to, and by how much it is stretched."""
FREE_TIME, FREE_STEP = 0.5, 0.01
TURN = np.radians(80.0)
"""About what a couple turns the falling panel by [rad]."""
SHEET_STEPS, SHEET_TIME = (1.0 / 30.0, 0.01, 0.002), 0.2
STIFF_STRIPS, STRIP_TIME = ((1e5, 10.0, 0.02), (1e5, 100.0, 0.02), (1e6, 30.0, 0.0)), 4.0
"""Membrane over bending stiffness, Gamma and damping ratio of strips that fall at 30 steps a second, and time [s]."""
COST_STEPS = (10, 20, 40, 80, 160, 320)
COST_FINE = 1280


def panel(cells: tuple[int, int] = PANEL_CELLS) -> ms.Shell:
    """A free square sheet."""
    return ms.Shell(ms.sheet(length=1.0, width=1.0, cells=cells, family="union-jack"), PANEL)


def bent(shell: ms.Shell, stretch: float) -> np.ndarray:
    """The sheet bent to an arc along x, and stretched along it."""
    x = np.array(shell.rest_positions)
    radius = 1.0 / ARC
    angle = (x[:, 0] - 0.5 * (x[:, 0].min() + x[:, 0].max())) * (1.0 + stretch) / radius
    x[:, 0], x[:, 2] = radius * np.sin(angle), radius * (1.0 - np.cos(angle))
    return x


def free_rungs(shell: ms.Shell) -> dict[str, Callable[[], ms.Model]]:
    """Rungs that take a free shell."""
    basis, consistent = ms.solve_modes(shell, 6 + PANEL_MODES), ms.models()["mwts-consistent"]
    return {
        ms.LinearModal.name: lambda: ms.LinearModal(basis),
        ms.ModalWarping.name: lambda: ms.ModalWarping(basis),
        consistent.name: lambda: consistent.builder(basis),
        ms.RotationStrain.name: lambda: ms.RotationStrain(basis),
        ms.ModalDerivatives.name: lambda: ms.ModalDerivatives(shell, 6 + PANEL_MODES),
        ms.HybridStress.name: lambda: ms.HybridStress.trained(shell, modes=64, motions=32),
        ms.CoarseDiscreteShell.name: lambda: ms.CoarseDiscreteShell(shell, shell),
        ms.Auto.name: lambda: ms.Auto(shell, PANEL_MODES),
        ms.DiscreteShell.name: lambda: ms.DiscreteShell(shell),
    }


def invariants(model: ms.Model, **motion: Any) -> dict[str, float | None]:
    """Wander of the centre, energies, momentum and angular momentum beyond what the load has given, at their largest.

    The centre's is over its fall, or the shell's size; energies are over the start's; momenta over the sums of their
    parts' sizes. What a couple has given is summed by the trapezoidal rule.
    """
    shell, count = model.shell, round(FREE_TIME / FREE_STEP)
    start, gravity = motion.pop("start", None), np.array(motion.pop("gravity", (0.0, 0.0, 0.0)))
    force = motion.pop("force", np.zeros_like(shell.rest_positions))
    loading = shell.loading(gravity, force)
    run = Motion(model, loading, dt=FREE_STEP, start=start)
    mass, total = shell.mass, shell.mass.sum()
    first, energy = mass @ run.positions() / total, run.energies().sum()
    wander, momentum, spin, sizes, peak = 0.0, 0.0, 0.0, np.zeros(2), 0.0
    given, pull = np.zeros(3), np.cross(run.positions() - first, force).sum(axis=0)
    for _ in range(count):
        run.advance()
        x = run.positions()
        v = run.model.velocities(run.state, x, 1e-3 * FREE_STEP)
        centre, moving = mass @ x / total, mass @ v
        wander = max(wander, float(np.linalg.norm(centre - first - 0.5 * gravity * run.time**2)))
        momentum = max(momentum, float(np.linalg.norm(moving - total * gravity * run.time)))
        arm, own = x - centre, v - moving / total
        turning = np.cross(arm, own) * mass[:, None]
        before, pull = pull, np.cross(arm, force).sum(axis=0)
        given = given + 0.5 * FREE_STEP * (before + pull)
        spin = max(spin, float(np.linalg.norm(turning.sum(axis=0) - given)))
        # Of the motion about the centre, so that a fall does not hide it.
        sizes = np.maximum(
            sizes, [float(mass @ np.linalg.norm(v, axis=1)), float(np.linalg.norm(turning, axis=1).sum())]
        )
        peak = max(peak, float(run.energies().sum() / energy)) if energy else peak
    left = float(run.energies().sum() / energy) if energy else 0.0
    size = 0.5 * float(np.linalg.norm(gravity)) * FREE_TIME**2
    return {
        "wander": wander / (size or shell.size),
        "momentum": momentum / sizes[0],
        "angular_momentum": spin / sizes[1],
        "energy_left": left if energy else None,
        "largest_energy": peak if energy else None,
    }


def couple(shell: ms.Shell) -> np.ndarray:
    """Forces (n, 3) [N] on two edges that would turn a rigid panel by TURN in the time, were their arm to stay."""
    rest = shell.rest_positions
    arm = rest[:, 0] - shell.mass @ rest[:, 0] / shell.mass.sum()
    edge = np.abs(arm) > np.abs(arm).max() - 1e-9
    force = np.zeros_like(rest)
    wanted = float(shell.mass @ arm**2) * 2.0 * TURN / FREE_TIME**2
    force[edge, 2] = np.sign(arm[edge]) * wanted / float(np.abs(arm[edge]).sum())
    return force


def free_rows(quick: bool) -> list[dict[str, Any]]:
    """A bent panel that is let go without a load; and a flat one that falls while a couple turns it.

    ``quick`` leaves out those that have tests of their own and take long.
    """
    shell = panel()
    scenes: dict[str, dict[str, Any]] = {
        "bent, let go": {"start": bent(shell, 0.0)},
        "falls and turns": {"gravity": (0.0, 0.0, -9.81), "force": couple(shell)},
    }
    return [
        {"scene": scene, "rung": rung} | invariants(make(), **motion)
        for scene, motion in scenes.items()
        for rung, make in free_rungs(shell).items()
        if not (quick and rung in (ms.HybridStress.name, ms.ModalDerivatives.name, ms.Auto.name))
    ]


def stiff_rows(rules: tuple[str, ...] = FULL_RULES) -> list[dict[str, Any]]:
    """Six stiff scenes by every rule: largest energy over the start's, solves a step, and both over implicit Euler's.

    Of strips, which start without energy, the largest rise over the largest work of their weight is added to 1.
    """
    rows: list[dict[str, Any]] = []
    sheet = panel((8, 8))
    start = bent(sheet, STRETCH)
    for dt in SHEET_STEPS:
        for rule in rules:
            run, took = moved(ms.DiscreteShell(sheet, integrator=rule), round(SHEET_TIME / dt), dt, start=start)
            energy = run.energies[:, :2].sum(axis=1)
            own = {"energy": float(energy[1:].max() / energy[0]), "left": float(energy[-1] / energy[0])}
            rows.append(
                {"scene": f"free sheet, {1e3 * dt:.3g} ms", "rule": rule, "steps": len(energy) - 1} | own | took
            )
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(20, 4))
    for ratio, gamma, damped in STIFF_STRIPS:
        material = ms.Material(0.05 * ratio, 0.05 * ratio, 0.05, 0.2)
        shell = ms.Shell(mesh, material, clamped=mesh.vertices[:, 0] < 0.075)
        motion: dict[str, Any] = {
            "gravity": weight(shell, gamma),
            "damping": (2.0 * damped * first_frequency(shell), 0.0),
        }
        for rule in rules:
            run, took = moved(ms.DiscreteShell(shell, integrator=rule), round(30 * STRIP_TIME), 1.0 / 30.0, **motion)
            energy, work = run.energies.sum(axis=1), -float(run.energies[:, 2].min())
            own = {"energy": 1.0 + float(energy[1:].max() - energy[0]) / work}
            own["left"] = 1.0 + float(energy[-1] - energy[0]) / work
            name = f"strip, {ratio:.0e}, Γ {gamma:g}"
            rows.append({"scene": name, "rule": rule, "steps": len(energy) - 1} | own | took)
    for row in rows:
        euler = next(r for r in rows if r["scene"] == row["scene"] and r["rule"] == "implicit_euler")
        problems = implicit_rule(row["rule"]).stand_ins
        row["iterations"] = row["solves"] / row["steps"] / problems
        row["over_euler"] = row["iterations"] * euler["steps"] / euler["solves"]
    return rows


def cost_rows(quick: bool) -> list[dict[str, Any]]:
    """Error [L] of a strip that is let fall for a period at Gamma 5, damped by 0.03, over the work of each rule."""
    rows = []
    shell = strip("hinges")
    omega = first_frequency(shell)
    period, damping = 2.0 * np.pi / omega, ms.Damping(0.03 * omega, 0.03 / omega)
    steps, fine = (COST_STEPS[:2], COST_FINE // 8) if quick else (COST_STEPS, COST_FINE)
    for rung in rungs(shell, 5.0, with_hybrid=False):
        if rung.name not in (ms.ModalWarping.name, ms.CoarseDiscreteShell.name, ms.DiscreteShell.name):
            continue

        def motion(rule: str, count: int, *, rung=rung) -> tuple[np.ndarray, dict[str, Any]]:  # type: ignore[no-untyped-def]
            run, took = moved(
                rung.make(rule), count, period / count, count // 10, gravity=weight(shell, 5.0), damping=damping
            )
            return run.positions, took

        truth = motion(rung.default, fine)[0]
        for rule in rung.rules:
            for count in steps:
                found, took = motion(rule, count)
                error = float(np.linalg.norm(found - truth, axis=2).max())
                rows.append({"scene": "falling strip", "rung": rung.name, "rule": rule, "steps": count} | took)
                rows[-1]["error"] = error
    return rows


def limit_findings(quick: bool, on_step: Progress | None) -> dict[str, Any]:
    """Free panels, stiff scenes, and errors over work."""
    tasks: list[tuple[str, Callable[[], Any]]] = [("free", lambda: free_rows(quick)), ("stiff", stiff_rows)]
    tasks.append(("cost", lambda: cost_rows(quick)))
    return {name: task() for name, task in counted(tasks, on_step)}
