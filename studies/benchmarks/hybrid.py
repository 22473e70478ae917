"""Cost of a frame of the trained hybrid of shell theory through snaps, on loads that were not in training.

Its coarse shell is the shell itself. A frame is a step with its positions, on one thread, by the processor's clock.
"""

from __future__ import annotations

import time
import warnings
from typing import Any

import numpy as np

import modalshell as ms
from modalshell.models.hybrid.training import LOADED, RELEASED, random_damping, random_load
from studies.benchmarks.timing import one_blas_thread

SEED = 24
DT = 1.0 / 30.0
"""Frames [s]."""


def folded(fold: float) -> ms.Shell:
    """The stiff V-beam, or one of another fold [degrees]."""
    mesh = ms.v_beam(length=1.0, width=0.2, fold=fold, cells=(16, 4))
    sheet = ms.Isotropic(young=9e4, poisson=0.3, thickness=0.022, density=9.0)
    return ms.Shell(mesh, sheet, mesh.vertices[:, 0] < 1.5 / 16)


def panel() -> ms.Shell:
    """A cylindrical panel, held at both curved ends."""
    mesh = ms.cylinder_panel(length=1.0, radius=0.6, angle=60.0, cells=(6, 6), family="union-jack")
    ends = np.abs(mesh.vertices[:, 0] - 0.5) > 0.499
    return ms.Shell(mesh, ms.Isotropic(young=9e4, poisson=0.3, thickness=0.012, density=17.0), ends)


SHELLS = {"V": (lambda: folded(150.0), 70.0), "fold of 135°": (lambda: folded(135.0), 70.0), "panel": (panel, 15.0)}
"""Shells, and the gravity [m/s^2] about which the hybrid is trained."""


def frames(
    vectors: tuple[int, ...] = (44, 64), motions: int = 120, loads: int = 12, repeats: int = 9
) -> list[dict[str, Any]]:
    """Milliseconds of a frame of three shells, the least of ``repeats`` times each, on average over motions.

    ``without`` and ``with`` are motions without and with damping by the stiffness, those that the coarse shell takes in
    part left out; ``coarse`` are frames of the coarse shell.
    """
    return [measured(name, size, motions, loads, repeats) for name in SHELLS for size in vectors]


def measured(name: str, vectors: int, motions: int, loads: int, repeats: int) -> dict[str, Any]:
    """One shell with one basis."""
    make, gravity = SHELLS[name]
    shell, rng = make(), np.random.default_rng(SEED)
    weight = shell.gravity_force((0.0, 0.0, -gravity))
    with one_blas_thread():
        began = time.process_time()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ms.ModalShellWarning)  # the error stands in the table
            model = ms.HybridStress.trained(shell, gravity=(0.0, 0.0, -gravity), modes=vectors, motions=motions)
        training = time.process_time() - began
        times: dict[str, list[float]] = {"without": [], "with": [], "coarse": []}
        for _ in range(loads):
            load, damping = random_load(shell, weight, rng), random_damping(rng, DT)
            found = [timed(model, load, damping) for _ in range(repeats)]
            if not found[0][1]:
                least = float(np.mean(np.min([frame for frame, _ in found], axis=0)))
                times["with" if damping.stiffness_factor else "without"].append(least)
            times["coarse"].append(float(np.mean(timed(model.coarse, load, damping)[0])))
    return {
        "shell": name,
        "vertices": len(shell.rest_positions),
        "vectors": vectors,
        "held_out_error [%]": 100.0 * model.held_out_error,
        "training [s]": training,
        **{f"{kind} [ms]": 1e3 * float(np.mean(part)) for kind, part in times.items() if part},
    }


def timed(model: Any, load: np.ndarray, damping: ms.Damping) -> tuple[np.ndarray, bool]:
    """Seconds (f,) of the frames of one motion, and whether a coarse shell took some of them."""
    state, seconds, taken = model.start_motion(), np.empty(LOADED + RELEASED), False
    for frame in range(seconds.size):
        force = load if frame < LOADED else np.zeros_like(load)
        began = time.process_time()
        state, _ = model.step(state, DT, force, damping)
        model.positions(state)
        seconds[frame] = time.process_time() - began
        taken |= state.coordinates.ndim == 2
    return seconds, taken
