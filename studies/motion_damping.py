"""Damping that was asked for and obtained, and orders of convergence, of every rung and rule."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from scipy.linalg import expm

import modalshell as ms
from modalshell.core.typing import Progress
from studies.motion_rungs import LENGTH, REFERENCE, Rung, first_frequency, moved, rungs, sheet_in_plane, strip, weight
from studies.pages import counted

RATIOS = (0.01, 0.03, 0.1)
STEPS, QUICK_STEPS = (3, 5, 10, 20, 50, 75, 100, 200, 400), (3, 10, 20, 75)
"""Steps a period."""
FEWEST = 10
"""Steps a period at fewer of which full models are not asked."""
AMPLITUDE = 1e-3
"""Largest displacement of the mode at the start [L]: motion is linear."""
THIN = "Isotropic, thin"
"""A strip so stiff in its plane that the order shows at smaller steps only."""
GAMMA, ORDER_RATIO = 5.0, 0.03
"""Load and damping ratio of the motion that orders are read from."""
ORDER_STEPS = {"modal": (40, 80, 160), "full": (100, 200, 400)}


def least_ratio(samples: np.ndarray, expected: complex, terms: int = 6) -> float:
    """Damping ratio of the oscillation in equally spaced samples whose factor per step is nearest to ``expected``.

    By linear prediction: a sum of ``terms`` damped oscillations is a linear recurrence; its roots are the factors.
    """
    windows = np.lib.stride_tricks.sliding_window_view(samples / np.abs(samples).max(), terms + 1)
    recurrence = np.linalg.lstsq(windows[:, :-1], windows[:, -1], rcond=1e-7)[0]
    roots = np.roots(np.concatenate([[1.0], -recurrence[::-1]]))
    exponent = np.log(roots[np.abs(roots - expected).argmin()])
    return float(-exponent.real / abs(exponent))


def obtained(model: ms.Model, shape: np.ndarray, omega: float, ratio: float, steps: int) -> float:
    """Damping ratio of a mode (n, 3) of ``omega`` [rad/s] that is let go, at ``steps`` a period.

    Half of the ratio is asked by the mass and half by the stiffness.
    """
    shell, dt = model.shell, 2.0 * np.pi / (omega * steps)
    start = shell.rest_positions + AMPLITUDE * LENGTH * shape / np.abs(shape).max()
    damping = ms.Damping(ratio * omega, ratio / omega)
    run, _ = moved(model, max(steps + 8, 24), dt, start=start, damping=damping)
    samples = np.einsum("tnx,n,nx->t", run.positions - shell.rest_positions, shell.mass, shape)
    # Without the first steps, in which a rule finds its way.
    return least_ratio(samples[4:], np.exp((-ratio + 1j * np.sqrt(1.0 - ratio**2)) * omega * dt))


def damping_rungs(energy: str, quick: bool = False) -> list[tuple[Rung, ms.Shell]]:
    """Every rung, with the shell whose first mode it moves in; ``quick`` leaves out the one that is trained first."""
    shell = strip(energy)
    found = [(rung, shell) for rung in rungs(shell, GAMMA, with_hybrid=energy == "hinges" and not quick)]
    if energy == "hinges":
        flat = sheet_in_plane()
        springs = Rung(ms.SpringSheet.name, found[-1][0].rules, lambda rule: ms.SpringSheet(flat, integrator=rule))
        found.append((springs, springs.make("bdf2").shell))
    return found


def damping_rows(
    rung: Rung, shell: ms.Shell, ratios: tuple[float, ...], asked: tuple[int, ...]
) -> list[dict[str, Any]]:
    """What is obtained by each rule, for each ratio asked, at the ``asked`` steps a period."""
    basis = ms.solve_modes(shell, 1)
    omega, shape = float(2.0 * np.pi * basis.frequencies[0]), basis.modes[:, 0].reshape(-1, 3)
    rows = []
    steps = [count for count in asked if rung.modal or count >= FEWEST]
    for rule in rung.rules:
        model = rung.make(rule)
        for ratio in ratios:
            found = [obtained(model, shape, omega, ratio, count) for count in steps]
            rows.append({"rung": rung.name, "rule": rule, "asked": ratio, "steps": steps, "obtained": found})
    return rows


def order_of(
    rung: Rung, shell: ms.Shell, rule: str, counts: tuple[int, ...], *, viscous: bool = True
) -> dict[str, Any]:
    """Order of a rule, from the changes of a falling strip's motion when the step is halved twice.

    It is damped by its mass and, if ``viscous``, by its stiffness.
    """
    omega = first_frequency(shell)
    period, damping = 2.0 * np.pi / omega, ms.Damping(ORDER_RATIO * omega, viscous * ORDER_RATIO / omega)
    model, runs = rung.make(rule), []
    for count in counts:
        every = count // counts[0]
        run, took = moved(model, count, period / count, every, gravity=weight(shell, GAMMA), damping=damping)
        runs.append(run.positions)
    changes = [float(np.abs(fine - coarse).max() / LENGTH) for coarse, fine in pairwise(runs)]
    order = float(np.log2(changes[0] / changes[1]))
    return {
        "rung": rung.name,
        "rule": rule,
        "steps": counts,
        "changes": changes,
        "order": order,
        "status": took["status"],
    }


def exact_linear(basis: ms.Basis, damping: ms.Damping, forces: np.ndarray, dt: float) -> np.ndarray:
    """Modal coordinates (k + 1, m) under forces (k + 1, m) that go straight from one time to the next, from rest."""
    found = np.zeros_like(forces)
    for mode, stiffness in enumerate(basis.eigenvalues):
        system = np.zeros((4, 4))  # of q, v, the force and its slope
        system[0, 1] = system[1, 2] = system[2, 3] = 1.0
        system[1, :2] = -stiffness, -damping.of_modes(np.array([stiffness]))[0]
        flow, state = expm(dt * system), np.zeros(2)
        slopes = np.diff(forces[:, mode]) / dt
        for step, slope in enumerate(slopes):
            state = (flow @ [*state, forces[step, mode], slope])[:2]
            found[step + 1, mode] = state[0]
    return found


def linear_exactness(energy: str, steps_a_period: float, count: int = 24) -> float:
    """Largest error of LMA [of its largest displacement] under a load of straight pieces, one step each."""
    shell = strip(energy)
    basis, omega = ms.solve_modes(shell, 4), first_frequency(shell)
    dt = 2.0 * np.pi / (omega * steps_a_period)
    factors = np.random.default_rng(3).standard_normal(count + 1)
    damping = ms.Damping(0.03 * omega, 0.03 / omega)
    load = shell.gravity_force(weight(shell, 0.1))
    piecewise = ms.Scaled(ms.SelfWeight(tuple(weight(shell, 0.1).tolist())), (dt * np.arange(count + 1), factors))
    run, _ = moved(ms.LinearModal(basis), count, dt, loads=[piecewise], damping=damping)
    exact = exact_linear(basis, damping, np.outer(factors, load.ravel() @ basis.modes), dt) @ basis.modes.T
    found = (run.positions - shell.rest_positions).reshape(count + 1, -1)
    return float(np.abs(found - exact).max() / np.abs(exact).max())


def damping_findings(quick: bool, on_step: Progress | None) -> dict[str, Any]:
    """Damping, orders and the exactness of LMA, of both energies."""
    energies = ("hinges",) if quick else ("hinges", "Isotropic")
    cases = [(energy, *pair) for energy in energies for pair in damping_rungs(energy, quick)]
    found: dict[str, Any] = {"damping": [], "orders": [], "linear": []}
    for energy, rung, shell in counted(cases, on_step):
        rows = damping_rows(rung, shell, RATIOS[1:2] if quick else RATIOS, QUICK_STEPS if quick else STEPS)
        found["damping"] += [{"energy": energy} | row for row in rows]
        if rung.name not in (ms.LinearModal.name, ms.SpringSheet.name):
            counts = ORDER_STEPS["modal" if rung.modal or quick else "full"]
            for rule in rung.rules[:1] if rung.modal else rung.rules[:2]:
                found["orders"].append({"energy": energy} | order_of(rung, shell, rule, counts))
    if not quick:
        thin, shell = next(pair for pair in damping_rungs(THIN) if pair[0].name == REFERENCE)
        for rule in thin.rules[:2]:
            found["orders"].append({"energy": THIN} | order_of(thin, shell, rule, ORDER_STEPS["full"]))
    for energy in energies:
        for steps in (0.7, 3.0, 17.0):
            found["linear"].append({"energy": energy, "steps": steps, "error": linear_exactness(energy, steps)})
    return found
