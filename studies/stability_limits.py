"""Where the stability of the models of ``stability_atlas`` ends: by theory, and measured by bisection.

Limits are those of small motion about an equilibrium:

* Explicit (symplectic) Euler of DS and springs: ``h^2 omega^2 + 2 h c < 4`` for the stiffest mode, ``c = xi + zeta
  omega^2``; Verlet takes xi at mid-step, which leaves it out. The classical grid takes omega of the endless sheet.
* Modal models: the spectral radius of the step's linearisation at the model's own equilibrium. Modal forces that depend
  on q are taken late, from the step before by implicit Euler, from a predicted middle by the midpoint rule, from a
  predicted end by the exponential rule, which keeps it as a third part of its state: all can miss an equilibrium that
  the model has.
* Implicit Euler at a very long step is the iteration ``q <- Lambda^-1 p(q)``: spectral radius of ``Lambda^-1 dp/dq``.
* Numerical damping of implicit Euler, BDF2, SDIRK2 and the composite rule, and frequencies of the other rules, mode by
  mode; of full models in the stiffest. BDF2's are the roots of ``(3/2 - z) r^2 - 2 r + 1/2``, SDIRK2's
  ``(1 + (1 - 2 g) z) / (1 - g z)^2``, those of the composite rule of a cubic, z being h times a root of
  ``z^2 + c z + omega^2``.
* A rigid body that spins: one radian a step.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from scipy.linalg import eigh

import modalshell as ms
from modalshell.integrators.full import FullIntegrator
from modalshell.integrators.modal import ImplicitEuler
from modalshell.models.base.full import FullModel
from modalshell.models.base.modal import ModalModel
from modalshell.modes import largest_eigenvalue
from modalshell.springs import GridVerlet, SheetGrid
from studies.stability_models import BASE, ROWS, IntegratedModel, first_frequency, model_of

PRECISION = 2e-3
"""Relative width at which bisection stops."""
SMALL, STILL = 1e-6, 1e-9
"""Size of a disturbance, as a share of the equilibrium, and [m] of a shell at rest."""

Limit = tuple[str, str, float | None, float | None]
"""What ends, its unit, and where by theory and by measurement."""


def limits_of(name: str, quick: bool) -> list[dict[str, Any]]:
    """Limits of one row that have a theory, measured."""
    row = ROWS[name]
    if row.kind not in _LIMITS or row.coordinates:  # a limit is that of the coordinates
        return []
    model = model_of(name, BASE.ratio, BASE.aspect, BASE.fold)
    if isinstance(model, str):
        return []
    return [entry(name, *limit) for limit in _LIMITS[row.kind](row, model, quick)]


def entry(row: str, what: str, unit: str, theory: float | None, measured: float | None) -> dict[str, Any]:
    """One limit, ready for JSON."""
    ratio = None if theory is None or measured is None else measured / theory
    model, _, rule = row.partition(", ")
    found = {"row": row, "model": model, "rule": rule, "what": what, "unit": unit}
    return found | {"theory": theory, "measured": measured, "ratio": ratio}


def bisect(stable: Callable[[float], bool], low: float, high: float) -> float | None:
    """Where ``stable`` ends between ``low``, which must be stable, and ``high``, which must not; None otherwise."""
    if not stable(low) or stable(high):
        return None
    while high > low * (1.0 + PRECISION):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if stable(middle) else (low, middle)
    return float(np.sqrt(low * high))


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


def spin_limits(row: IntegratedModel, model: ms.RigidShell, quick: bool) -> Iterator[Limit]:  # noqa: ARG001
    """The longest step of a spin about a principal axis: one radian, and where the solver stops to converge."""

    def solved(dt: float) -> bool:
        state = model.start_motion()
        state.rates[3] = 2.0
        return model.step(state, dt, np.zeros_like(model.shell.rest_positions), ms.Damping())[1]

    yield "longest step of a spin of 2 rad/s", "s", 0.5, bisect(solved, 0.05, 5.0)


def linear_limits(row: IntegratedModel, model: ms.LinearModal, quick: bool) -> Iterator[Limit]:  # noqa: ARG001
    """What a rule does to one mode: its damping or its frequency."""
    omega = np.sqrt(model.basis.eigenvalues)
    mode = 0 if row.theory == "implicit" else 1
    shape = np.eye(model.basis.count)[mode]
    if row.theory == "implicit":
        damping = ms.Damping(0.2 * first_frequency(BASE.ratio, BASE.fold), 0.01)
        pair = shrinking(row.theory, model, float(omega[mode]), shape, shape, BASE.step, damping, 20)
        yield "shrinking of mode 1 stepped at 30 Hz", "1", *pair
        return
    state, load, values = model.start_motion(), np.zeros_like(model.shell.rest_positions), np.empty(1000)
    state.coordinates[mode] = 1.0
    for place in range(values.size):
        state, _ = model.step(state, BASE.step, load, ms.Damping())
        values[place] = state.coordinates[mode]
    before = np.flatnonzero(values[:-1] * values[1:] < 0.0)
    crossings = before + values[before] / (values[before] - values[before + 1])
    measured = np.pi * (len(crossings) - 1) / ((crossings[-1] - crossings[0]) * BASE.step)
    theory = float(model.integrator.frequency(omega[mode] ** 2, 0.0, BASE.step)[0])
    yield "frequency of mode 2 stepped at 30 Hz", "rad/s", theory, float(measured)


def multipliers(theory: str, omega: np.ndarray | float, damp: float, dt: np.ndarray | float) -> np.ndarray:
    """What a step of an implicit rule multiplies oscillations by, of frequencies ``omega`` [rad/s]."""
    stiffness = np.asarray(omega) ** 2
    z = dt * (-0.5 * damp + 1j * np.sqrt(stiffness - 0.25 * damp**2))
    rule = FullIntegrator.chosen(theory)
    return np.array([rule.growth(complex(one)) for one in np.ravel(z)]).reshape(np.shape(z))


def shrinking(
    theory: str,
    model: Any,
    omega: float,
    shape: np.ndarray,
    weight: np.ndarray,
    dt: float,
    damping: ms.Damping,
    count: int,
) -> tuple[float, float]:
    """Factor by which a step of a rule shrinks a mode of frequency ``omega`` [rad/s]: theory, and measured.

    Two motions begin with its ``shape`` as displacement and as velocity; ``weight`` takes its part of both. The root of
    the area that they span is free of the phase. The first third of the ``count`` steps is the rule's start.
    """
    states, load = [model.start_motion(), model.start_motion()], np.zeros_like(model.shell.rest_positions)
    rest, areas = np.array(states[0].coordinates), []
    states[0].coordinates = rest + shape
    states[1].rates = omega * shape
    for _ in range(count):
        (q, v), (r, w) = ((np.vdot(weight, one.coordinates - rest), np.vdot(weight, one.rates)) for one in states)
        areas.append(abs(q * w - r * v))
        states = [model.step(state, dt, load, damping)[0] for state in states]
    damp, first = damping.mass_factor + damping.stiffness_factor * omega**2, count // 3
    measured = float((areas[-1] / areas[first]) ** (0.5 / (count - 1 - first)))
    if theory == "implicit":
        return float(ImplicitEuler().amplification(omega**2, damp, dt)[0]), measured
    return float(np.abs(multipliers(theory, omega, damp, dt))), measured


def step_matrix(model: ModalModel, q: np.ndarray, load: np.ndarray, dt: float, damping: ms.Damping) -> np.ndarray:
    """Matrix that takes small deviations of q (m,), its rate and what is kept from an equilibrium over a step [s]."""
    eigenvalues, jacobian = model.basis.eigenvalues, model.modal_force_jacobian(q, load)
    return np.asarray(model.integrator.matrix(eigenvalues, damping.of_modes(eigenvalues), dt, jacobian))


def step_radius(model: ModalModel, q: np.ndarray, load: np.ndarray, dt: float, damping: ms.Damping) -> float:
    """Spectral radius of :func:`step_matrix`: small motion about the equilibrium q grows where it is above one."""
    return float(np.abs(np.linalg.eigvals(step_matrix(model, q, load, dt, damping))).max())


def iteration_radius(model: ModalModel, q: np.ndarray, load: np.ndarray) -> float:
    """Spectral radius of ``Lambda^-1 dp/dq``: below one the lagged iteration finds the equilibrium q of a held one."""
    jacobian = model.modal_force_jacobian(q, load)
    return float(np.abs(np.linalg.eigvals(jacobian / model.basis.eigenvalues[:, None])).max())


def at_rest(model: ModalModel, gravity: np.ndarray) -> np.ndarray | None:
    """Coordinates (m,) of the model's equilibrium, stable or not; None if there is none."""
    answer = model.equilibrium(gravity=gravity)
    return answer.coordinates if answer.residual < 1e-6 else None


def grows(model: ModalModel, gravity: np.ndarray, dt: float, damping: ms.Damping) -> bool:
    """Whether theory has small motion about the equilibrium grow, or there is none."""
    q = at_rest(model, gravity)
    return q is None or step_radius(model, q, model.shell.gravity_force(gravity), dt, damping) > 1.0


def settles(model: ModalModel, gravity: np.ndarray, dt: float, damping: ms.Damping, count: int) -> bool:
    """Whether steps of the model bring a small disturbance of its equilibrium back."""
    q = at_rest(model, gravity)
    if q is None:
        return False
    load, root = model.shell.gravity_force(gravity), np.sqrt(model.basis.eigenvalues)
    disturbed = SMALL * float(np.linalg.norm(root * q)) * np.random.default_rng(0).standard_normal(2 * q.size)

    state = model.start_motion()
    state.coordinates, state.rates = q + disturbed[: q.size] / root, disturbed[q.size :]

    def step(_: np.ndarray) -> np.ndarray:
        nonlocal state
        state = model.step(state, dt, load, damping)[0]
        return np.concatenate([root * (state.coordinates - q), state.rates])

    return dies_out(step, disturbed, count)


def iterates(model: ModalModel, gravity: np.ndarray) -> bool:
    """Whether the iteration ``q <- Lambda^-1 p(q)`` goes back to the equilibrium."""
    q, load, root = at_rest(model, gravity), model.shell.gravity_force(gravity), np.sqrt(model.basis.eigenvalues)
    if q is None:
        return False
    disturbed = SMALL * float(np.linalg.norm(root * q)) * np.random.default_rng(0).standard_normal(q.size)
    return dies_out(lambda away: root * (model.modal_force(q + away / root, load) / root**2 - q), disturbed, 600)


def modal_limits(row: IntegratedModel, model: ModalModel, quick: bool) -> Iterator[Limit]:
    """Longest steps and largest loads of modes under a force that turns with them."""
    unit = BASE.gravity  # Gamma = 1

    def pair(low: float, high: float, damping: ms.Damping, count: int, at: Callable[[float], tuple[Any, float]]) -> Any:
        """Where motion stops to settle, by theory and measured; ``at`` gives the gravity and the step."""
        theory = bisect(lambda value: not grows(model, *at(value), damping), low, high)
        return theory, bisect(lambda value: settles(model, *at(value), damping, count), low, high)

    count = 300 if quick else 900
    yield "longest step at Γ = 30", "s", *pair(1e-3, 10.0, BASE.rayleigh, count, lambda dt: (30.0 * unit, dt))
    if row.theory == "implicit":

        def found(gamma: float) -> bool:
            q = at_rest(model, gamma * unit)
            return q is not None and iteration_radius(model, q, model.shell.gravity_force(gamma * unit)) <= 1.0

        measured = bisect(lambda gamma: iterates(model, gamma * unit), 1.0, 60.0)
        yield "largest Γ of the iteration q ← Λ⁻¹p(q)", "1", bisect(found, 1.0, 60.0), measured
    if model.conservative or (quick and row.theory != "implicit"):
        return
    for ratio in (0.7,) if quick else (0.05, 0.2, 0.7):  # it loses its equilibrium by flutter
        damping = replace(BASE, damping=ratio).rayleigh
        words = f"largest Γ stepped at 30 Hz (damping ratio {ratio:g})"
        count = 600 if quick else 4000
        yield words, "1", *pair(20.0, 400.0, damping, count, lambda gamma: (gamma * unit, BASE.step))
        if not quick:  # no theory of small motion holds from rest
            let_go = partial(settles_from_rest, model, unit, damping)
            yield f"{words} let go from rest", "1", None, bisect(let_go, 20.0, 400.0)


def settles_from_rest(model: ModalModel, unit: np.ndarray, damping: ms.Damping, gamma: float) -> bool:
    """Whether damped motion from the rest shape ends at the static answer, and not in a cycle or wound up."""
    factors = (damping.mass_factor, damping.stiffness_factor)
    options: dict[str, Any] = {"gravity": gamma * unit, "damping": factors, "store_every": 4}
    return ms.simulate(model, duration=2000 * BASE.step, dt=BASE.step, **options).outcome.succeeded


def full_limits(row: IntegratedModel, model: FullModel, quick: bool) -> Iterator[Limit]:
    """Limits of DS and of springs: the longest steps of explicit rules, what implicit ones do to the stiffest mode."""
    shell, omega = model.shell, float(np.sqrt(largest_eigenvalue(model.shell)))
    rest, free = shell.rest_positions, shell.free_unknowns
    if row.theory != "explicit":
        mass = np.repeat(shell.mass, 3)
        root = np.sqrt(mass[free])
        scaled = shell.stiffness(rest).toarray()[np.ix_(free, free)] / np.outer(root, root)
        values, modes = eigh(scaled, subset_by_index=(root.size - 1, root.size - 1))
        shape = np.zeros(rest.size)
        shape[free] = STILL * modes[:, 0] / root / np.abs(modes[:, 0] / root).max()
        weight = (mass * shape / (mass @ shape**2)).reshape(rest.shape)
        damping = ms.Damping(0.1 * omega, 0.2 / omega)
        stiffest = float(np.sqrt(values[0]))
        pair = shrinking(row.theory, model, stiffest, shape.reshape(rest.shape), weight, 1.0 / omega, damping, 15)
        yield "shrinking of the stiffest mode at h omega = 1", "1", *pair
        return
    load, start = np.zeros_like(rest), noise(rest.shape, shell.clamped)
    cases = {"undamped": ms.Damping(), "xi = omega_max": ms.Damping(omega, 0.0)}
    for words, damping in (cases | {"zeta omega_max = 1": ms.Damping(0.0, 1.0 / omega)}).items():

        def mover(dt: float, damping: ms.Damping = damping) -> Callable[[np.ndarray], np.ndarray]:
            state = model.start_motion(rest + start)

            def step(_: np.ndarray) -> np.ndarray:
                nonlocal state
                state = model.step(state, dt, load, damping)[0]
                return np.concatenate([(state.coordinates - rest).ravel(), dt * state.rates.ravel()])

            return step

        longest = explicit_pair(model.stable_step(damping), mover, start, quick)
        yield f"longest step at rest ({words})", "s", *longest


def noise(shape: tuple[int, ...], held: np.ndarray) -> np.ndarray:
    """Small displacements (n, 3) [m], none where held."""
    start = STILL * np.random.default_rng(0).standard_normal(shape)
    start[held] = 0.0
    return start


def explicit_pair(
    theory: float, mover: Callable[[float], Callable[[np.ndarray], np.ndarray]], start: np.ndarray, quick: bool
) -> tuple[float, float | None]:
    """Longest stable step [s] of an explicit rule at rest: theory, and by a disturbance that ``mover`` steps."""
    count = 300 if quick else 900
    # Undamped motion beats; above its limit it grows by more than a tenth a step.
    return theory, bisect(lambda dt: dies_out(mover(dt), start, count, margin=2.0), 0.5 * theory, 2.0 * theory)


_LIMITS: dict[str, Callable[[IntegratedModel, Any, bool], Iterator[Limit]]] = {
    "rigid": spin_limits,
    "linear": linear_limits,
    "modal": modal_limits,
    "full": full_limits,
}
"""How the limits of a row are measured, by its kind."""


def grid_limits(quick: bool) -> list[dict[str, Any]]:
    """Limits of the classical grid of springs, whose step is estimated without its supports and edges."""
    pinned = np.zeros((24, 24), bool)
    pinned[0, [0, -1]] = True
    found = []
    for name, (shear, flexion) in {"alike": (1.0, 1.0), "soft": (0.3, 0.1)}.items():
        stiffness: dict[str, Any] = {"structural": 50.0, "shear": 50.0 * shear, "flexion": 50.0 * flexion}
        plain = SheetGrid(shape=pinned.shape, spacing=0.04, particle_mass=1e-3, pinned=pinned, **stiffness)
        for ratio in (0.0, 0.5):
            grid = replace(plain, drag=ratio * 2.0 / plain.stable_step())
            rest = grid.rest_positions()
            start = noise(rest.shape, pinned.ravel())

            def mover(dt: float, grid: SheetGrid = grid, rest: np.ndarray = rest, start: np.ndarray = start) -> Any:
                sheet = GridVerlet(grid, start=rest + start, threads=1, allow_unstable_step=True)

                def step(_: np.ndarray) -> np.ndarray:
                    sheet.step(1, dt)
                    return np.asarray(sheet.positions - rest)

                return step

            words = f"longest step at rest (shear and flexion {name}; drag = {ratio:g} omega_max)"
            pair = explicit_pair(grid.stable_step(), mover, start, quick)
            found.append(entry("classical grid, Verlet", words, "s", *pair))
    return found
