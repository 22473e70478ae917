"""What a frame of a modal model costs on a collider, against one in free motion, by the processor's clock.

A strip that is clamped at an end swings on a floor that few or most of its vertices lie on, and on a ball.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

import modalshell as ms
from modalshell.integrators.state import PUSHES
from modalshell.motion import Motion
from studies.benchmarks.timing import one_blas_thread

GRAVITY = (0.0, 0.0, -9.81)
BODIES: dict[str, list[ms.Contact]] = {
    "none": [],
    "floor": [ms.Contact(ms.Plane((0.0, 0.0, 1.0), -0.15))],
    "floor below": [ms.Contact(ms.Plane((0.0, 0.0, 1.0), -0.01))],
    "ball": [ms.Contact(ms.Sphere((0.7, 0.0, -0.6), 0.5))],
}
"""Colliders by what a row calls them."""
MANY = 1000
"""Vertices up to which a strip lies on the floor below: the shapes of more that are pushed take minutes to find."""
FALL = 40
"""Frames until all lie on their colliders."""
RUNGS = tuple(spec for spec in ms.models().values() if spec.quadratic and spec.needs == "basis")
"""Models whose frames are taken."""


def frames(sizes: tuple[tuple[int, int], ...], modes: int = 16, count: int = 8, repeats: int = 25) -> list[Any]:
    """Microseconds of a step with its positions on each collider, least and median of turns of ``count`` frames.

    ``sizes`` are cells of strips. Motions take turns, so that what else the machine does strikes all alike.
    """
    rows = []
    for cells in sizes:
        mesh = ms.flat_beam(length=1.0, width=0.2, cells=cells)
        sheet = ms.Isotropic(young=1e8, poisson=0.3, thickness=5e-3, density=100.0)
        basis = ms.solve_modes(ms.Shell(mesh, sheet, clamped="x < 1e-6"), modes)
        with one_blas_thread():
            for spec in RUNGS:
                rows += _of_model(spec.name, spec.builder(basis), count, repeats)
    return rows


def _of_model(name: str, model: Any, count: int, repeats: int) -> list[dict[str, Any]]:
    """Rows of one model, by its ``name``."""
    loading = model.shell.loading(GRAVITY, None, None)
    given: dict[str, Any] = {"dt": 1 / 60, "damping": (0.02, 0.0)}
    large = len(model.shell.rest_positions) > MANY
    bodies = {body: on for body, on in BODIES.items() if not (large and body == "floor below")}
    motions = {body: Motion(model, loading, contacts=on, **given) for body, on in bodies.items()}
    for motion in motions.values():
        for _ in range(FALL):  # and those that find what is kept of each vertex
            motion.advance()
    spent = np.empty((repeats, len(motions)))
    for turn in range(repeats):
        for which, motion in enumerate(motions.values()):
            begin = time.process_time()
            for _ in range(count):
                motion.advance()
                motion.positions()
            spent[turn, which] = 1e6 * (time.process_time() - begin) / count
    return [
        {
            "vertices": len(model.shell.rest_positions),
            "modes": model.basis.count,
            "model": name,
            "on": body,
            "pushed": int(np.count_nonzero(motion.state.memory.get(PUSHES, 0.0))),
            "microseconds_least": float(spent[:, which].min()),
            "microseconds_median": float(np.median(spent[:, which])),
            "more_than_free": float(spent[:, which].min() - spent[:, 0].min()),
        }
        for which, (body, motion) in enumerate(motions.items())
    ]
