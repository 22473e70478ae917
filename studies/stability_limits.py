"""Where the stability limits lie: what theory says, and what small motion about an equilibrium does, by bisection.

Part of the study ``stability_atlas``, which names the models; a limit is given as theory, measurement and their ratio.

* Explicit (symplectic) Euler of DS and springs: ``h^2 omega^2 + 2 h c < 4`` for the stiffest mode, ``c = xi + zeta
  omega^2``; Verlet takes xi at mid-step, which leaves it out. The classical grid takes omega of the endless sheet.
* Modal models: the spectral radius of the step's linearisation at the model's own equilibrium
  (:mod:`studies.modal_steps`); the force lags by a step, or half of one, which long steps do not forgive.
* Implicit Euler at a very long step is the iteration ``q <- Lambda^-1 p(q)``: spectral radius of ``Lambda^-1 dp/dq``.
* Implicit Euler's numerical damping and the midpoint rule's frequency, mode by mode; of full models in the stiffest.
* A rigid body that spins: one radian a step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.linalg import eigh

import modalshell as ms
from modalshell.integrators.modal import ImplicitEuler
from modalshell.integrators.state import MotionState
from modalshell.models.base.full import FullModel
from modalshell.models.base.modal import ModalModel
from modalshell.springs import GridVerlet, SheetGrid
from studies import modal_steps

PRECISION = 2e-3
"""Relative width at which bisection stops."""
_SMALL = 1e-6
"""Size of the disturbance, as a share of the equilibrium."""
_STILL = 1e-9
"""Size of the disturbance of a shell at rest [m]."""


def bisect(stable: Callable[[float], bool], low: float, high: float) -> float | None:
    """Where ``stable`` ends between ``low``, which must be stable, and ``high``, which must not; None otherwise."""
    if not stable(low) or stable(high):
        return None
    while high > low * (1.0 + PRECISION):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if stable(middle) else (low, middle)
    return float(np.sqrt(low * high))


def entry(row: str, what: str, unit: str, theory: float | None, measured: float | None) -> dict[str, Any]:
    """One limit, ready for JSON."""
    ratio = None if theory is None or measured is None else measured / theory
    model, _, rule = row.partition(", ")
    found = {"row": row, "model": model, "rule": rule, "what": what, "unit": unit}
    return found | {"theory": theory, "measured": measured, "ratio": ratio}


def dies_out(step: Callable[[np.ndarray], np.ndarray], start: np.ndarray, count: int, margin: float = 1.0) -> bool:
    """Whether a disturbance (N,) is no larger in the last third of ``count`` steps than ``margin`` times the second's.

    A thousand times the start is growth, too, even if it ends in a small cycle.
    """
    sizes, now = np.empty(count), start
    for place in range(count):
        now = step(now)
        sizes[place] = np.linalg.norm(now)
        if not sizes[place] < 1e3 * np.linalg.norm(start):
            return False
    third = count // 3
    last, before = sizes[-third:].max(), sizes[third : 2 * third].max()
    return bool(last < margin * before or last < 1e-2 * np.linalg.norm(start))


# ---- modal models


def at_rest(model: ModalModel, gravity: np.ndarray) -> np.ndarray | None:
    """Coordinates (m,) of the model's equilibrium, stable or not; None if there is none."""
    answer = model.equilibrium(gravity=gravity)
    return answer.coordinates if answer.residual < 1e-6 else None


def settles(model: ModalModel, gravity: np.ndarray, dt: float, damping: ms.Damping, count: int) -> bool:
    """Whether steps of the model bring a small disturbance of its equilibrium back."""
    q = at_rest(model, gravity)
    if q is None:
        return False
    load, root = model.shell.gravity_force(gravity), np.sqrt(model.basis.eigenvalues)
    size = float(np.linalg.norm(root * q))
    disturbed = _SMALL * size * np.random.default_rng(0).standard_normal(2 * q.size)

    def step(away: np.ndarray) -> np.ndarray:
        state = MotionState(q + away[: q.size] / root, away[q.size :])
        after, _ = model.step(state, dt, load, damping)
        return np.concatenate([root * (after.coordinates - q), after.rates])

    return dies_out(step, disturbed, count)


def grows(model: ModalModel, gravity: np.ndarray, dt: float, damping: ms.Damping) -> float:
    """Rate [1/s] at which theory has small motion about the equilibrium grow; infinite if there is none."""
    q = at_rest(model, gravity)
    if q is None:
        return np.inf
    return float(np.log(modal_steps.step_radius(model, q, model.shell.gravity_force(gravity), dt, damping)) / dt)


def longest_step(model: ModalModel, gravity: np.ndarray, damping: ms.Damping, count: int) -> tuple[float | None, ...]:
    """Longest stable step [s] up to 10 s at one load, by theory and by measurement."""
    shortest = 1e-3
    theory = bisect(lambda dt: grows(model, gravity, dt, damping) <= 0.0, shortest, 10.0)
    return theory, bisect(lambda dt: settles(model, gravity, dt, damping, count), shortest, 10.0)


def largest_load(
    model: ModalModel, unit: np.ndarray, dt: float, damping: ms.Damping, count: int, bounds: tuple[float, float]
) -> tuple[float | None, ...]:
    """Largest multiple of the gravity ``unit`` (3,) whose equilibrium holds, by theory and by measurement."""
    theory = bisect(lambda factor: grows(model, factor * unit, dt, damping) <= 0.0, *bounds)
    return theory, bisect(lambda factor: settles(model, factor * unit, dt, damping, count), *bounds)


def iteration_load(model: ModalModel, unit: np.ndarray, bounds: tuple[float, float]) -> tuple[float | None, ...]:
    """Largest multiple of the gravity ``unit`` (3,) that the iteration ``q <- Lambda^-1 p(q)`` finds the answer to."""
    eigenvalues = model.basis.eigenvalues
    root = np.sqrt(eigenvalues)

    def theory(factor: float) -> bool:
        q = at_rest(model, factor * unit)
        return q is not None and modal_steps.iteration_radius(model, q, model.shell.gravity_force(factor * unit)) <= 1.0

    def measured(factor: float) -> bool:
        q, load = at_rest(model, factor * unit), model.shell.gravity_force(factor * unit)
        if q is None:
            return False
        disturbed = _SMALL * float(np.linalg.norm(root * q)) * np.random.default_rng(0).standard_normal(q.size)
        return dies_out(
            lambda away: root * (model.modal_force(q + away / root, load) / eigenvalues - q), disturbed, 600
        )

    return bisect(theory, *bounds), bisect(measured, *bounds)


def settles_from_rest(model: ModalModel, gravity: np.ndarray, dt: float, damping: ms.Damping) -> bool:
    """Whether damped motion from the rest shape ends at the static answer, and not in a cycle or wound up."""
    factors = (damping.mass_factor, damping.stiffness_factor)
    run = ms.simulate(model, duration=2000 * dt, dt=dt, gravity=gravity, damping=factors, store_every=4)
    return run.outcome.succeeded


def numerical_damping(model: ms.LinearModal, dt: float, mode: int, damping: ms.Damping) -> tuple[float, float]:
    """Factor by which one mode shrinks in a step of implicit Euler: theory, and the determinant's root of two steps."""
    stiffness = float(model.basis.eigenvalues[mode])
    damp = damping.mass_factor + damping.stiffness_factor * stiffness
    load = np.zeros_like(model.shell.rest_positions)
    states = [MotionState(np.zeros(model.basis.count), np.zeros(model.basis.count)) for _ in range(2)]
    states[0].coordinates[mode], states[1].rates[mode] = 1.0, np.sqrt(stiffness)
    measured = _shrinking(
        states,
        lambda state: model.step(state, dt, load, damping)[0],
        lambda state: (state.coordinates[mode], state.rates[mode]),
        20,
    )
    return float(model.integrator.amplification(stiffness, damp, dt)[0]), measured


def _shrinking(
    states: list[MotionState],
    step: Callable[[MotionState], MotionState],
    in_mode: Callable[[MotionState], tuple[float, float]],
    count: int,
) -> float:
    """Factor by which one mode shrinks in a step: root of that of the area two motions span, free of the phase."""
    areas = []
    for _ in range(count):
        (q, v), (r, w) = (in_mode(state) for state in states)
        areas.append(abs(q * w - r * v))
        states = [step(state) for state in states]
    return float((areas[-1] / areas[0]) ** (0.5 / (len(areas) - 1)))


def oscillation(model: ms.LinearModal, dt: float, mode: int, count: int) -> tuple[float, float]:
    """Angular frequency [rad/s] of one undamped mode by the midpoint rule: theory, and the crossings of zero."""
    frequency = float(np.sqrt(model.basis.eigenvalues[mode]))
    state, load = model.start_motion(), np.zeros_like(model.shell.rest_positions)
    state.coordinates[mode] = 1.0
    values = np.empty(count)
    for place in range(count):
        state, _ = model.step(state, dt, load, ms.Damping())
        values[place] = state.coordinates[mode]
    before = np.flatnonzero(values[:-1] * values[1:] < 0.0)
    crossings = before + values[before] / (values[before] - values[before + 1])
    measured = np.pi * (len(crossings) - 1) / ((crossings[-1] - crossings[0]) * dt)
    return float(model.integrator.frequency(frequency**2, 0.0, dt)[0]), float(measured)


# ---- full models


def explicit_step(model: FullModel, damping: ms.Damping, count: int) -> tuple[float, float | None]:
    """Longest stable step [s] of explicit Euler or Verlet at rest: theory, and by disturbing the rest shape."""
    theory, shell = model.stable_step(damping), model.shell
    rest = shell.rest_positions
    start = _noise(rest.shape, shell.clamped)
    load = np.zeros_like(rest)

    def stable(dt: float) -> bool:
        state = model.start_motion(rest + start)

        def step(_: np.ndarray) -> np.ndarray:
            nonlocal state
            state = model.step(state, dt, load, damping)[0]
            return np.concatenate([(state.coordinates - rest).ravel(), dt * state.rates.ravel()])

        # Undamped motion beats; above its limit it grows by more than a tenth a step.
        return dies_out(step, start, count, margin=2.0)

    return theory, bisect(stable, 0.5 * theory, 2.0 * theory)


def stiffest_mode(model: FullModel, dt: float, damping: ms.Damping) -> tuple[float, float]:
    """Factor by which a step of implicit Euler shrinks small motion of the stiffest mode: theory, and measured."""
    shell = model.shell
    rest, free = shell.rest_positions, shell.free_unknowns
    mass = np.repeat(shell.mass, 3)[free]
    stiffness = shell.stiffness(rest).toarray()[np.ix_(free, free)]
    values, modes = eigh(stiffness / np.sqrt(np.outer(mass, mass)), subset_by_index=(mass.size - 1, mass.size - 1))
    squared, shape = float(values[0]), np.zeros(rest.size)
    shape[free] = _STILL * modes[:, 0] / np.sqrt(mass) / np.abs(modes[:, 0] / np.sqrt(mass)).max()
    weight = np.repeat(shell.mass, 3) * shape / (np.repeat(shell.mass, 3) @ shape**2)

    def in_mode(state: MotionState) -> tuple[float, float]:
        return float(weight @ (state.coordinates - rest).ravel()), float(weight @ state.rates.ravel())

    states = [model.start_motion(), model.start_motion()]
    states[0].coordinates = rest + shape.reshape(-1, 3)
    states[1].rates = np.sqrt(squared) * shape.reshape(-1, 3)
    damp = damping.mass_factor + damping.stiffness_factor * squared
    return float(ImplicitEuler().amplification(squared, damp, dt)[0]), _shrinking(
        states, lambda state: model.step(state, dt, np.zeros_like(rest), damping)[0], in_mode, 10
    )


def _noise(shape: tuple[int, ...], held: np.ndarray) -> np.ndarray:
    """Small displacements (n, 3) [m], none where held."""
    start = _STILL * np.random.default_rng(0).standard_normal(shape)
    start[held] = 0.0
    return start


def grid_of(shear: float, flexion: float, drag: float) -> SheetGrid:
    """A grid of 24 x 24 masses, some fixed: by stiffness over the structural one, and drag over frequency."""
    corners = np.zeros((24, 24), bool)
    corners[0, [0, -1]] = True
    grid = SheetGrid(
        shape=corners.shape,
        spacing=0.04,
        particle_mass=1e-3,
        structural=50.0,
        shear=50.0 * shear,
        flexion=50.0 * flexion,
        pinned=corners,
    )
    return replace(grid, drag=drag * 2.0 / grid.stable_step())


def grid_step(grid: SheetGrid, count: int) -> tuple[float, float | None]:
    """Longest stable step [s] of the classical grid's Verlet at rest: its own estimate, and by disturbing it."""
    rest = grid.rest_positions()
    start = _noise(rest.shape, grid.pinned.ravel())

    def stable(dt: float) -> bool:
        sheet = GridVerlet(grid, start=rest + start, threads=1, allow_unstable_step=True)

        def step(_: np.ndarray) -> np.ndarray:
            sheet.step(1, dt)
            return np.asarray(sheet.positions - rest)

        return dies_out(step, start, count, margin=2.0)

    theory = grid.stable_step()
    return theory, bisect(stable, 0.5 * theory, 2.0 * theory)


def spin_step(model: ms.RigidShell, spin: float) -> tuple[float, float | None]:
    """Longest step [s] of a spin [rad/s] about a principal axis: one radian, and where the solver stops to converge."""

    def solved(dt: float) -> bool:
        state = model.start_motion()
        state.rates[3] = spin
        return model.step(state, dt, np.zeros_like(model.shell.rest_positions), ms.Damping())[1]

    return 1.0 / spin, bisect(solved, 0.1 / spin, 10.0 / spin)
