"""Cost of a frame of :func:`modalshell.simulate`, against the step, the positions and the storing alone.

On one thread, by the processor's clock.
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
from studies.benchmarks.timing import interleaved, one_blas_thread

GRAVITY = (0.0, 0.0, -4.0)
STEP = 1.0 / 30.0


def frames(
    cells: tuple[int, int] = (250, 52), modes: int = 4, count: int = 60, repeats: int = 9
) -> list[dict[str, Any]]:
    """Frames a second of the modal models on a V-beam, the best of ``repeats`` turns, and those of the parts alone.

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
    with one_blas_thread():
        times = interleaved(calls, repeats, statistic=min, clock=time.process_time)
    frame = times["simulate"] / (count + 1)
    parts = times["step"] + times["positions"] + times["store"]
    return {
        "vertices": len(state),
        "modes": model.basis.count,
        "model": model.name,
        "frames_per_second": 1.0 / frame,
        **{f"microseconds_{name}": 1e6 * times[name] for name in ("step", "positions", "store")},
        "microseconds_frame": 1e6 * frame,
        "ratio_parts": frame / parts,
    }
