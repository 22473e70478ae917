"""Cost of a frame of :func:`modalshell.simulate`, against the step, the positions and the storing alone.

And that of a step with its positions by the exponential rule, against implicit Euler. On one thread, by the processor's
clock.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

import modalshell as ms
from modalshell.models.base.modal import ModalModel
from modalshell.motion import Motion
from studies.benchmarks.timing import interleaved, one_blas_thread

GRAVITY = (0.0, 0.0, -4.0)
STEP = 1.0 / 30.0


def frames(
    cells: tuple[int, int] = (250, 52), modes: int = 4, count: int = 60, repeats: int = 9
) -> list[dict[str, Any]]:
    """Frames a second of the modal models on a V-beam, the best of ``repeats`` turns, and the parts alone and in turn.

    Reduced RSW is trained at rank 32 on loads about the one that it moves under.
    """
    mesh = ms.v_beam(length=1.0, width=0.2, fold=150.0, cells=cells, family="alternating")
    shell = ms.Shell(mesh, ms.Material(20.0, 20.0, 0.05, 0.2), clamped=mesh.vertices[:, 0] < 0.026)
    basis = ms.solve_modes(shell, modes)
    full = ms.RotationStrain(basis)
    reduced = ms.ReducedRotationStrain.trained(full, [(0.0, 0.0, -2.0), GRAVITY, (0.0, 1.0, -4.0)], mixtures=16)
    return [measured(model, count, repeats) for model in (ms.LinearModal(basis), ms.ModalWarping(basis), full, reduced)]


def measured(model: ModalModel, count: int, repeats: int) -> dict[str, Any]:
    """One model's frames a second in ``simulate`` over ``count`` steps, and by parts."""
    shell = model.shell
    load = shell.gravity_force(GRAVITY)
    state = ms.simulate(model, duration=0.5, dt=STEP, gravity=GRAVITY).positions[-1]
    moving = model.start_motion(state)
    stored = np.empty((count + 1, *shell.rest_positions.shape))
    numbers = itertools.cycle(range(count + 1))

    def store() -> None:
        stored[next(numbers)] = state

    calls: dict[str, Callable[[], object]] = {
        "simulate": partial(ms.simulate, model, duration=count * STEP, dt=STEP, gravity=GRAVITY),
        "step": partial(model.step, moving, STEP, load, ms.Damping()),
        "positions": partial(model.positions, moving),
        "store": store,
    }
    parts = calls["step"], calls["positions"], store

    def in_turn() -> None:
        """The parts as a motion asks for them: each finds what the others have left of the processor's caches."""
        for _ in range(count + 1):
            for part in parts:
                part()

    calls["parts"] = in_turn
    with one_blas_thread():
        times = interleaved(calls, repeats, statistic=min, clock=time.process_time)
    frame = times["simulate"] / (count + 1)
    return {
        "vertices": len(state),
        "modes": model.basis.count,
        "model": model.name,
        "frames_per_second": 1.0 / frame,
        **{f"microseconds_{name}": 1e6 * times[name] for name in ("step", "positions", "store")},
        "microseconds_parts": 1e6 * times["parts"] / (count + 1),
        "microseconds_frame": 1e6 * frame,
        "ratio_parts": times["simulate"] / times["parts"],
    }


STRIPS: dict[int, tuple[int, int]] = {315: (62, 4), 1377: (152, 8), 5313: (252, 20)}
"""Cells of strips by their number of vertices."""
MATERIALS: dict[str, ms.Material | ms.Isotropic] = {
    "hinges": ms.Material(200.0, 200.0, 0.05, 0.2),
    "Isotropic": ms.Isotropic(young=1e6, poisson=0.3, thickness=0.01, density=1000.0),
}
GAMMAS = (0.1, 5.0, 10.0, 20.0, 29.0)
SAMPLED = ((2, 3.1), (2, 3.6), (4, 3.5), (8, 3.5), (4, 8.0))
"""Modes and their steps a period: those of three to four are hardly followed, and take a second force."""


def rules(
    vertices: tuple[int, ...] = (315, 1377, 5313), modes: int = 8, count: int = 30, repeats: int = 11
) -> list[dict[str, Any]]:
    """Steps with their positions by the exponential rule over those by implicit Euler; median of interleaved ratios.

    A strip that is clamped at an end is let fall at each Gamma, with ``modes`` modes, one of which has the given number
    of steps a period.
    """
    rows = []
    for energy, material in MATERIALS.items():
        for number in vertices:
            cells = STRIPS[number]
            mesh = ms.flat_beam(length=1.0, width=0.2, cells=cells, family="alternating")
            held = mesh.vertices[:, 0] < (1.5 / cells[0] if energy == "hinges" else 1e-9)
            basis = ms.solve_modes(ms.Shell(mesh, material, clamped=held), modes)
            kinds: tuple[Any, ...] = (ms.ModalWarping, ms.RotationStrain)
            for kind, (mode, steps) in itertools.product(kinds, SAMPLED):
                dt = 1.0 / (steps * basis.frequencies[mode - 1])
                for gamma in GAMMAS:
                    named = {"energy": energy, "vertices": number, "model": kind.name, "gamma": gamma}
                    rows.append(
                        named | {"mode": mode, "steps": steps} | _over_euler(kind, basis, gamma, dt, count, repeats)
                    )
    return rows


def _over_euler(kind: Any, basis: ms.Basis, gamma: float, dt: float, count: int, repeats: int) -> dict[str, Any]:
    """Microseconds of a step with its positions by both rules, and the median of their ratios."""
    shell, models = basis.shell, [kind(basis, integrator=rule) for rule in ("exponential", "implicit_euler")]
    loading = shell.loading((0.0, 0.0, -gamma / ms.measure.gamma_per_gravity(shell)))
    motions = [Motion(model, loading, dt=dt) for model in models]
    spent = np.empty((repeats, 2))
    with one_blas_thread():
        for motion in motions:
            motion.advance()
        for turn in range(repeats):
            for number, motion in enumerate(motions):
                motion.positions()
                begin = time.process_time()
                for _ in range(count):
                    motion.advance()
                    motion.positions()
                spent[turn, number] = time.process_time() - begin
    each = 1e6 / count * np.median(spent, axis=0)
    return {
        "microseconds": float(each[0]),
        "microseconds_euler": float(each[1]),
        "ratio": float(np.median(spent[:, 0] / spent[:, 1])),
        "turn": models[0].largest_turn(motions[0].state.coordinates),
    }
