"""What the truth costs: assembly of forces and Hessians, and implicit steps of a hanging sheet, part by part."""

from __future__ import annotations

import itertools
import time
from typing import Any

import numpy as np

import modalshell as ms
from modalshell.modes import BACKENDS
from modalshell.shell import EXACT, PROJECTED
from studies.benchmarks.timing import interleaved

GRAVITY = (0.0, 0.0, -9.81)
DAMPING = (0.1, 0.0)
STEP = 1.0 / 60.0
_PEERS = 100
"""Vertices along a side up to which steps are taken with SuperLU, too: beyond, a row of it takes minutes."""

ENERGIES = ("hinges", "split folds")
"""The paper's energy, and shell theory."""


def hanging_sheet(side: int, energy: str = "hinges") -> ms.Shell:
    """A square sheet of ``side`` x ``side`` vertices held at two corners, of about one stiffness and mass."""
    mesh = ms.sheet(cells=(side - 1, side - 1), family="right")
    corners = [0, 1, side * (side - 1), side * (side - 1) + 1]
    if energy == "split folds":
        return ms.Shell(mesh, ms.Isotropic(young=1e5, poisson=0.3, thickness=2e-3, density=100.0), clamped=corners)
    return ms.Shell(mesh, ms.Material(200.0, 200.0 / side, 1e-4, 0.2), clamped=corners)


def assembly(energy: str = "hinges", side: int = 100) -> dict[str, Any]:
    """Milliseconds of energy, force, and force with Hessian (exact, and projected) in the stored pattern."""
    shell = hanging_sheet(side, energy)
    x = shell.rest_positions + 1e-3 * np.random.default_rng(0).standard_normal(shell.rest_positions.shape)
    seconds = interleaved(
        {
            "energy": lambda: shell.elastic_energy.energy(x),
            "force": lambda: shell.energy_gradient(x),
            "force and Hessian": lambda: shell.energy_gradient_hessian(x, EXACT),
            "force and projected Hessian": lambda: shell.energy_gradient_hessian(x, PROJECTED),
        }
    )
    counts = {"energy of": energy, "vertices": len(x), "faces": len(shell.mesh.faces)}
    return counts | {f"{name} [ms]": 1e3 * value for name, value in seconds.items()}


def implicit_steps(sides: tuple[int, ...] = (50, 100, 150)) -> list[dict[str, Any]]:
    """Simulated seconds per CPU second, the share of each part, and the energy error that the tolerance leaves."""
    rows = []
    for side, energy in itertools.product(sides, ENERGIES):
        steps = max(3, round(10 * (50 / side)))
        shell = hanging_sheet(side, energy)
        backends = BACKENDS if side <= _PEERS else BACKENDS[:1]
        for backend, rule in itertools.product(backends, ("implicit", "composite", "linear_implicit")):
            model = ms.DiscreteShell(shell, backend=backend, integrator=rule)
            ms.simulate(model, duration=STEP, dt=STEP, gravity=GRAVITY, damping=DAMPING)  # compiles, orders
            model = ms.DiscreteShell(shell, backend=backend, integrator=rule)
            start = time.process_time()
            run = ms.simulate(model, duration=steps * STEP, dt=STEP, gravity=GRAVITY, damping=DAMPING)
            cpu = time.process_time() - start
            total = sum(model.costs.values())
            told = side == sides[0] and rule == "implicit"
            rows.append(
                {
                    "vertices": len(shell.rest_positions),
                    "energy": energy,
                    "backend": backend,
                    "rule": rule,
                    "steps": steps,
                    "status": run.status,
                    "simulated_per_cpu": steps * STEP / cpu,
                    "simulated_per_wall": steps * STEP / run.seconds,
                    "shares": {name: value / total for name, value in model.costs.items()},
                    "tolerance": model.step_tolerance,
                    "energy_error": energy_error(shell, backend, run) if told else None,
                }
            )
    return rows


def energy_error(shell: ms.Shell, backend: str, run: ms.Trajectory) -> float:
    """Error of the total energy after one more step at the default tolerance, over the step's change of it."""
    load = shell.gravity_force(GRAVITY)
    energies = []
    for tolerance in (1e-6, 1e-12):
        model = ms.DiscreteShell(shell, backend=backend, step_tolerance=tolerance)
        state = model.start_motion(run.positions[-1])
        state.rates = (run.positions[-1] - run.positions[-2]) / STEP
        energies.append([_energy(shell, load, state.coordinates, state.rates)])
        after, _ = model.step(state, STEP, load, ms.Damping(*DAMPING))
        energies[-1].append(_energy(shell, load, after.coordinates, after.rates))
    return float(abs(energies[0][1] - energies[1][1]) / abs(energies[1][1] - energies[1][0]))


def _energy(shell: ms.Shell, load: Any, x: Any, v: Any) -> float:
    kinetic = 0.5 * float(np.sum(shell.mass[:, None] * v**2))
    return shell.elastic_energy.energy(x) + kinetic - float(np.vdot(load, x))
